"""Where and on what a table was measured."""

from __future__ import annotations

import os
import platform
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from clrelight.device import Device
from clrelight.experiment.provenance import software_versions, source_commit

THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "POCL_MAX_PTHREAD_COUNT")


def describe_environment(device: Device) -> dict[str, str]:
    """Return machine, device, driver, versions, commit and thread counts, as facts to print."""
    info = device.info
    limits = [f"{name}={os.environ[name]}" for name in THREAD_VARIABLES if name in os.environ]
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "measured": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": source_commit() or "not a checkout",
        "machine": f"{_processor()}, {platform.system()} {platform.machine()}",
        "threads": f"{cpus} usable CPUs, {info.compute_units} compute units; {', '.join(limits) or 'no limits set'}",
        "load": _load(),
        "device": f"{info.kind}: {info.name}",
        "kernels": f"those for a {info.style.upper()}",
        "driver": f"{info.version}, driver {info.driver}",
        "BLAS": _blas(),
        "versions": f"Python {platform.python_version()}, {software_versions()}",
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown processor"
    facts = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    model = facts.get("model name") or platform.processor() or "unknown processor"
    # Clouds hide the model's name; family and model tell it.
    return f"{model} (family {facts['cpu family']}, model {facts['model']})" if "cpu family" in facts else model


def _load() -> str:
    if not hasattr(os, "getloadavg"):
        return "unknown"
    return f"{os.getloadavg()[0]:.1f} processes in the minute before"


def _blas() -> str:
    blas = np.show_config(mode="dicts").get("Build Dependencies", {}).get("blas", {})  # type: ignore[union-attr]
    return f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip()
