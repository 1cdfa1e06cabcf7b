"""The whole job, from a stack file to PSNR, as our commands do it and as plain NumPy does, stage by stage."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clrelight.fit.plan import make_lighting
from clrelight.fit.registry import method_class
from clrelight.jobs.memory import peak_memory
from clrelight.metrics import summarize_errors
from clrelight.speed.peers import NewtonFit, squared_errors
from clrelight.speed.timing import interleave, quartiles

STAGES = ("fit", "encode", "decode", "psnr")
TOTAL = "total"
OURS, NUMPY = "ours", "numpy"

FIT_OPTIONS: Mapping[str, Any] = {"solver": "newton", "iterations": 16}
CODEC = "half"
POINT_SECONDS = 20.0
"""Rounds of one point that would take longer than this are fewer; where the first run does, it is the only one."""

Job = Mapping[str, Callable[[], Any]]
"""Stages in order; the last returns the pooled PSNR."""


def our_job(stack: Path, folder: Path, degree: int, memory: int, device: str | None) -> Job:
    """Return the verbs fit, encode, decode and measure, each from file to file."""
    # With HDF5 and all codecs, which plans of what to measure do without.
    from clrelight.jobs import decode, encode, fit, measure
    from clrelight.jobs.report import Report

    fitted, encoded, decoded = (folder / f"{name}.h5" for name in ("fit", "encoded", "decoded"))

    def run(verb: Callable[..., Any], *words: Any, **options: Any) -> Report:
        verb(*words, device=device, report=(report := Report()), **options)
        return report

    return {
        "fit": lambda: run(fit.fit, stack, "cls", degree, out=fitted, memory=memory, measure=False, **FIT_OPTIONS),
        "encode": lambda: run(encode.encode, fitted, CODEC, out=encoded),
        "decode": lambda: run(decode.decode, encoded, out=decoded),
        "psnr": lambda: run(measure.measure, decoded, stack).psnr["pooled_fitted"],
    }


def numpy_job(stack: Path, folder: Path, degree: int) -> Job:
    """Return the same mathematics in NumPy: all in memory, float32 products by BLAS, one plain file between stages."""
    import h5py

    from clrelight.dataset import LightStack
    from clrelight.harmonics.basis import evaluate_basis

    fit, encoded, decoded = (folder / f"{name}.npy" for name in ("fit", "encoded", "decoded"))

    def read() -> tuple[np.ndarray, np.ndarray]:
        with h5py.File(stack) as file:
            images_ip = file["images"][...]
            return images_ip.reshape(len(images_ip), -1).astype(np.float32), file["directions"][...]

    def fit_stack() -> None:
        images_ip, directions_i3 = read()
        lighting = make_lighting(LightStack(images_ip[:, None, :1, None], directions_i3, 1.0), "uniform", "hemisphere")
        plan = method_class("cls").from_config(FIT_OPTIONS).plan(lighting, degree)
        np.save(fit, NewtonFit(plan, FIT_OPTIONS["iterations"])(images_ip))

    def measure() -> float:
        images_ip, directions_i3 = read()
        errors_i = squared_errors(evaluate_basis(directions_i3, degree), np.load(decoded), images_ip, 1.0)
        return summarize_errors(errors_i).psnr_pooled

    return {
        "fit": fit_stack,
        "encode": lambda: np.save(encoded, np.load(fit).astype(np.float16)),
        "decode": lambda: np.save(decoded, np.load(encoded).astype(np.float32)),
        "psnr": measure,
    }


def measure_point(
    stack: Path,
    folder: Path,
    *,
    degree: int,
    ways: tuple[str, ...],
    rounds: int,
    settle_seconds: float,
    memory: int,
    device: str | None,
) -> dict[str, Any]:
    """Time one stack's job in turns with the same in NumPy.

    Parameters
    ----------
    stack, folder : Path
        The stack file, and where the jobs write theirs.
    degree : int
    ways : tuple of str
        `OURS`, `NUMPY`, or both in this order.
    rounds : int
        Runs of each way that count; the first one, which may build kernels, does not (but see `POINT_SECONDS`).
    settle_seconds : float
        Pause before each run.
    memory : int
        Bytes that a tile of our fit may take.
    device : str, optional

    Returns
    -------
    dict
        ``seconds`` by way and stage as quartiles; ``speed`` by stage, quartiles of the rounds' own ratios of NumPy's
        time to ours; ``psnr`` by way; ``memory``, the most resident bytes of the first way until its first run had
        ended; ``bytes`` of our files.
    """
    jobs: dict[str, Job] = {}
    for way in ways:
        own = folder / way
        own.mkdir(exist_ok=True)
        jobs[way] = our_job(stack, own, degree, memory, device) if way == OURS else numpy_job(stack, own, degree)
    seconds: dict[str, list[dict[str, float]]] = {way: [] for way in ways}
    quality: dict[str, float] = {}

    def run(way: str) -> None:
        taken: dict[str, float] = {}
        for stage, work in jobs[way].items():
            start = time.perf_counter()
            quality[way] = work()
            taken[stage] = time.perf_counter() - start
        seconds[way].append({**taken, TOTAL: sum(taken.values())})

    first: dict[str, float] = {}
    most_resident = 0
    for way in ways:
        run(way)
        most_resident = most_resident or peak_memory() or 0
        first[way] = seconds[way][0][TOTAL]
    if sum(first.values()) < POINT_SECONDS:
        for taken in seconds.values():
            taken.clear()
        interleave(
            {way: lambda way=way: run(way) for way in ways},  # type: ignore[misc]
            finish=lambda: None,
            rounds=rounds,
            least_seconds=0.0,
            most_seconds=POINT_SECONDS,
            settle_seconds=settle_seconds,
            first=first,
            fewest_rounds=1,
        )
    result: dict[str, Any] = {
        "rounds": len(seconds[ways[0]]),
        "first_seconds": first,
        **_compare(seconds),
        "psnr": quality,
        "memory": most_resident,
        "bytes": {"stack": stack.stat().st_size},
    }
    if OURS in ways:
        for name in ("fit", "encoded"):
            result["bytes"][name] = (folder / OURS / f"{name}.h5").stat().st_size
    return result


def _compare(seconds: Mapping[str, list[dict[str, float]]]) -> dict[str, Any]:
    """Return quartiles of the seconds by way and stage, and of the rounds' own ratios where there are two ways."""
    stages = (*STAGES, TOTAL)
    samples = {
        way: {stage: np.array([one[stage] for one in runs]) for stage in stages} for way, runs in seconds.items()
    }
    found: dict[str, Any] = {
        "seconds": {way: {stage: quartiles(each[stage]) for stage in stages} for way, each in samples.items()}
    }
    if len(samples) > 1:
        found["speed"] = {stage: quartiles(samples[NUMPY][stage] / samples[OURS][stage]) for stage in stages}
    return found
