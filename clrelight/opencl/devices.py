"""The OpenCL devices of this machine: what they are, whether they compute soundly, and which is taken."""

from __future__ import annotations

import functools
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from clrelight.errors import DeviceError
from clrelight.opencl.child import check_addresses, check_descriptors
from clrelight.opencl.drivers import is_packaged, leave_out_drivers, packaged_version
from clrelight.opencl.kernel_cache import no_pyopencl_cache, own_folder
from clrelight.opencl.probe import WIDTHS, Verdict, judge_device
from clrelight.opencl.processor import name_processor

DEVICE_VARIABLE = "CLRELIGHT_DEVICE"
STYLE_VARIABLE = "CLRELIGHT_KERNELS"
STYLES = ("cpu", "gpu")
"""Two ways to write a kernel: long vectors in few work-items for CPUs; for GPUs one column or block in each of many
work-items, whose groups share local memory. Either runs on every device, but slowly on the other kind."""

_INSTALL_HINT = "install one with: pip install 'pyopencl[pocl]' (no root needed)"
_OTHER_HINT = "a newer PoCL: conda install -c conda-forge pocl, or apt install pocl-opencl-icd"


@dataclass(frozen=True)
class DeviceInfo:
    """What `clrelight devices` lists of one OpenCL device.

    Attributes
    ----------
    index : int
        Position in the list of all devices; a legal ``--device``.
    name, platform, version, driver : str
        As the driver reports them.
    kind : str
        ``"gpu"``, ``"cpu"`` or ``"other"``.
    float64 : bool
        Whether kernels may use double precision.
    memory_bytes : int
        Global memory as the driver reports it.
    compute_units : int
        Number of compute units (hardware threads on a CPU).
    local_memory_bytes : int
        Local memory of one work-group.
    vector_width : int
        Native float vector width, as the driver reports it.
    packaged : bool
        Whether this is the PoCL that came from the Python package index.
    processor : str
        The processor that it was told to compile for; empty where it knows this one, or was not told.
    default : bool
        Whether it is taken when none is asked for; known of devices that `list_devices` gives.
    style : str
        Which kernels it gets, one of `STYLES`: by its kind, unless forced.
    lanes : int
        Floats in a vector of its kernels, one of `WIDTHS`: what a test found sound and fastest, unless forced; 0 where
        nothing is sound, or nobody has looked yet.
    fault : str
        Why it is not used; empty for a sound device.
    """

    index: int
    name: str
    platform: str
    version: str
    driver: str
    kind: str
    float64: bool
    memory_bytes: int
    compute_units: int
    local_memory_bytes: int
    vector_width: int
    packaged: bool
    processor: str = ""
    default: bool = False
    style: str = "cpu"
    lanes: int = 0
    fault: str = ""

    @property
    def identity(self) -> str:
        """What tells one build of a driver and its device from another."""
        packaged = packaged_version() if self.packaged else ""
        return "\0".join([self.platform, self.version, self.driver, self.name, packaged, self.processor])

    @property
    def label(self) -> str:
        """Name and driver in one string, as tables and files record it; its kernels too where forced."""
        # PoCL appends its build options to the version.
        forced = "" if self.style == style_of(self.kind) else f", {self.style} kernels"
        lanes = f", {self.lanes} lanes" if self.style == "cpu" and self.lanes else ""
        told = f", compiled for {self.processor}" if self.processor else ""
        return f"{self.name} ({self.version.split('  ')[0]}, driver {self.driver}{told}{lanes}{forced})"


def style_of(kind: str) -> str:
    """Return the style of the kernels that are written for a kind of device."""
    return "gpu" if kind == "gpu" else "cpu"


def list_devices(*, again: bool = False) -> list[DeviceInfo]:
    """Return every OpenCL device, each tested; empty where there is no driver. The default one has ``default=True``.

    Parameters
    ----------
    again : bool
        Test them anew, whatever is known of them.

    Raises
    ------
    DeviceError
        If ``CLRELIGHT_KERNELS`` holds an unknown style.
    """
    infos = [_judged(_in_style(info, None), again=again) for info, _ in loaded_devices()]
    first = next((index for index in _preference(infos) if not infos[index].fault), None)
    return [replace(info, default=info.index == first) for info in infos]


def choose_device(spec: str | None, style: str | None) -> DeviceInfo:
    """Return the device that `device.open_device` opens; the same errors."""
    asked = spec if spec is not None else os.environ.get(DEVICE_VARIABLE)
    source = "" if spec is not None else f" ({DEVICE_VARIABLE})"
    wanted, lanes = _split_lanes(asked or "", source)
    check_process()
    infos = [_in_style(info, style) for info, _ in loaded_devices()]
    if not infos:
        left_out = "".join(f"; {file}: {fault}" for file, fault in leave_out_drivers().items())
        raise DeviceError(f"no OpenCL device found; {_INSTALL_HINT}{left_out}")
    if lanes:
        return replace(infos[_match(wanted, infos, source)], lanes=lanes)
    if wanted:
        info = _judged(infos[_match(wanted, infos, source)])
        if info.fault:
            others = f"; choose another with --device or {DEVICE_VARIABLE}: see clrelight devices"
            raise DeviceError(f"{info.name} ({info.driver}) is not sound: it {info.fault}{others}")
        return info
    judged = []
    for index in _preference(infos):
        judged.append(_judged(infos[index]))
        if not judged[-1].fault:
            return judged[-1]
    faults = "; ".join(f"{info.index}: {info.name} ({info.driver}) {info.fault}" for info in judged)
    hint = _OTHER_HINT if any(info.packaged for info in infos) else _INSTALL_HINT
    raise DeviceError(f"no OpenCL device computes soundly: {faults}; another driver may: {hint}")


def _split_lanes(asked: str, source: str) -> tuple[str, int]:
    """Return the words before an ``@`` and the lanes behind it, 0 where there is none."""
    wanted, at, lanes = asked.strip().rpartition("@")
    if not at:
        return lanes, 0
    if lanes not in map(str, WIDTHS):
        raise DeviceError(f"lanes of a device{source} must be one of {', '.join(map(str, WIDTHS))}, got {asked!r}")
    return wanted, int(lanes)


def _preference(infos: list[DeviceInfo]) -> list[int]:
    """Return the indices of devices, the one to take first in front: GPUs, then the PoCL that we test, then others."""
    return [info.index for info in sorted(infos, key=lambda i: (i.kind != "gpu", not i.packaged, i.index))]


def _judged(info: DeviceInfo, *, again: bool = False) -> DeviceInfo:
    """Return what is known of a device with its lanes or its fault, by a test where nothing is known."""
    key = (info.index, info.style)
    if again or key not in _verdicts:
        with _judging:
            if again or key not in _verdicts:
                _verdicts[key] = judge_device(
                    info.name, info.identity, info.index, info.vector_width, info.style, again=again
                )
    return replace(info, lanes=_verdicts[key].lanes, fault=_verdicts[key].fault)


_verdicts: dict[tuple[int, str], Verdict] = {}
_judging = threading.Lock()


def _in_style(info: DeviceInfo, style: str | None) -> DeviceInfo:
    asked = style or os.environ.get(STYLE_VARIABLE) or style_of(info.kind)
    if asked not in STYLES:
        raise DeviceError(f"kernels ({STYLE_VARIABLE}) must be {' or '.join(STYLES)}, got {asked!r}")
    return replace(info, style=asked)


def _match(asked: str | None, infos: list[DeviceInfo], source: str = "") -> int:
    """Return the index of the device asked for; `source` tells the user where an unknown name came from."""
    if asked is None or asked == "":
        return _preference(infos)[0]
    wanted = asked.strip().lower()
    if wanted.isdigit():
        found = [info.index for info in infos if info.index == int(wanted)]
    elif wanted in ("cpu", "gpu"):
        # Of several CPU drivers the packaged one is the one we test.
        found = [i.index for i in sorted(infos, key=lambda i: not i.packaged) if i.kind == wanted]
    elif wanted == "pocl":
        found = [i.index for i in sorted(infos, key=lambda i: not i.packaged) if "pocl" in i.version.lower()]
    else:
        found = [info.index for info in infos if wanted in f"{info.name} {info.platform}".lower()]
    if not found:
        names = "; ".join(f"{info.index}: {info.name}" for info in infos)
        raise DeviceError(f"no OpenCL device matches {asked!r}{source}; there are {names}")
    return found[0]


@functools.cache
def loaded_devices() -> list[tuple[DeviceInfo, Any]]:
    """Return every device of every driver, untested, with pyopencl's object; drivers are loaded once."""
    check_descriptors()
    check_addresses()
    leave_out_drivers()
    global _first_process
    _first_process = os.getpid()
    found: list[tuple[DeviceInfo, Any]] = []
    with own_folder(), no_pyopencl_cache(), interrupts_wait():
        import pyopencl as cl

        try:
            platforms = cl.get_platforms()
        except cl.Error:
            return []
        for platform in platforms:
            try:
                devices = platform.get_devices()
            except cl.Error:
                continue
            for device in devices:
                found.append((_describe(cl, len(found), platform, device), device))
    return found


_first_process = 0
"""The process that loaded the drivers, 0 before."""


def check_process() -> None:
    """Refuse to use OpenCL where it would wait for ever: threads of drivers do not survive a fork."""
    if _first_process and _first_process != os.getpid():
        raise DeviceError(
            "OpenCL was used before this process was forked, and its drivers do not survive that: start workers with "
            "multiprocessing.get_context('spawn') or 'forkserver', or open devices only in the child"
        )


def _describe(cl: Any, index: int, platform: Any, device: Any) -> DeviceInfo:
    kind = "other"
    if device.type & cl.device_type.GPU:
        kind = "gpu"
    elif device.type & cl.device_type.CPU:
        kind = "cpu"
    packaged = is_packaged(platform.version, platform.int_ptr)
    return DeviceInfo(
        index=index,
        name=device.name.strip(),
        platform=platform.name.strip(),
        version=platform.version.strip(),
        driver=device.driver_version.strip(),
        kind=kind,
        float64="cl_khr_fp64" in device.extensions,
        memory_bytes=int(device.global_mem_size),
        compute_units=int(device.max_compute_units),
        local_memory_bytes=int(device.local_mem_size),
        vector_width=int(device.native_vector_width_float),
        packaged=packaged,
        processor=name_processor(device, platform.version, packaged=packaged) if kind == "cpu" else "",
    )


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Keep Ctrl-C until the block ends: a compiler that it strikes prints a complaint of its own."""
    if not hasattr(signal, "pthread_sigmask"):  # not on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
