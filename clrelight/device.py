"""Choose an OpenCL device, hold arrays on it, and launch kernels with checked arguments."""

from __future__ import annotations

import functools
import importlib.metadata
import os
import signal
import threading
import warnings
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.errors import DeviceError, KernelBuildError
from clrelight.kernel_source import read_kernel_source
from clrelight.opencl.child import check_descriptors
from clrelight.opencl.drivers import leave_out_drivers
from clrelight.opencl.kernel_cache import KernelCache, own_folder
from clrelight.opencl.probe import WIDTHS, Verdict, judge_device, machine_identity

DEVICE_VARIABLE = "CLRELIGHT_DEVICE"
STYLE_VARIABLE = "CLRELIGHT_KERNELS"
STYLES = ("cpu", "gpu")
"""Two ways to write a kernel: long vectors in few work-items for CPUs; for GPUs one column or block in each of many
work-items, whose groups share local memory. Either runs on every device, but slowly on the other kind."""

_INSTALL_HINT = "install one with: pip install 'pyopencl[pocl]' (no root needed)"

# OpenCL scalar and element types and the NumPy types that have the same bits.
_DTYPES: dict[str, tuple[str, ...]] = {
    "char": ("int8",),
    "uchar": ("uint8",),
    "short": ("int16",),
    "ushort": ("uint16", "float16"),
    "half": ("float16",),
    "int": ("int32",),
    "uint": ("uint32",),
    "long": ("int64",),
    "ulong": ("uint64",),
    "float": ("float32",),
    "double": ("float64",),
}


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
    default: bool = False
    style: str = "cpu"
    lanes: int = 0
    fault: str = ""

    @property
    def identity(self) -> str:
        """What tells one build of a driver and its device from another."""
        packaged = _packaged_version() if self.packaged else ""
        return "\0".join([self.platform, self.version, self.driver, self.name, packaged])

    @property
    def label(self) -> str:
        """Name and driver in one string, as tables and files record it; its kernels too where forced."""
        # PoCL appends its build options to the version.
        forced = "" if self.style == style_of(self.kind) else f", {self.style} kernels"
        lanes = f", {self.lanes} lanes" if self.style == "cpu" and self.lanes else ""
        return f"{self.name} ({self.version.split('  ')[0]}, driver {self.driver}{lanes}{forced})"


@dataclass(frozen=True)
class DeviceArray:
    """An array in device memory; on a CPU it shares the memory of `host`."""

    buffer: Any
    shape: tuple[int, ...]
    dtype: np.dtype
    host: NDArray | None = None


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
    infos = [_judged(_in_style(info, None), again=again) for info, _ in _devices()]
    first = next((index for index in _preference(infos) if not infos[index].fault), None)
    return [replace(info, default=info.index == first) for info in infos]


def open_device(spec: str | None = None, *, style: str | None = None) -> Device:
    """Return the device that `spec`, else ``CLRELIGHT_DEVICE``, names; one object per device, style, width and thread.

    Parameters
    ----------
    spec : str, optional
        An index of `list_devices`, ``"gpu"``, ``"cpu"``, ``"pocl"``, or a part of a device's name; default: the first
        that computes soundly of the GPUs, the packaged PoCL, and the others. With ``@4``, ``@8`` or ``@16`` behind it,
        or these alone, its kernels get so many lanes, and nobody asks whether that is sound.
    style : str, optional
        One of `STYLES`. Default: ``CLRELIGHT_KERNELS`` where it is set, else by the kind of the device.

    Raises
    ------
    DeviceError
        If there is no device, or none fits, or it is not sound, or the style is unknown; in a process forked from
        one that used OpenCL, whose drivers' threads are not there.
    """
    info = _choose(spec, style)
    opened = _local_cache("opened")
    key = (info.index, info.style, info.lanes)
    if key not in opened:
        opened[key] = Device(info, _devices()[info.index][1])
    return opened[key]


def make_device(spec: str, *, style: str) -> Device:
    """Return an object of its own for a device, of which `open_device` knows nothing; the same errors.

    For those who let one thread at a time use it: that costs less than an object for each of many short threads.
    """
    info = _choose(spec, style)
    return Device(info, _devices()[info.index][1])


def _choose(spec: str | None, style: str | None) -> DeviceInfo:
    asked = spec if spec is not None else os.environ.get(DEVICE_VARIABLE)
    source = "" if spec is not None else f" ({DEVICE_VARIABLE})"
    wanted, lanes = _split_lanes(asked or "", source)
    _check_process()
    infos = [_in_style(info, style) for info, _ in _devices()]
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
    raise DeviceError(f"no OpenCL device computes soundly: {faults}; another driver may: {_INSTALL_HINT}")


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
def _devices() -> list[tuple[DeviceInfo, Any]]:
    check_descriptors()
    leave_out_drivers()
    global _first_process
    _first_process = os.getpid()
    found: list[tuple[DeviceInfo, Any]] = []
    with own_folder(), _interrupts_wait():
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


def _check_process() -> None:
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
        packaged=_is_packaged_pocl(platform.version),
    )


def _is_packaged_pocl(platform_version: str) -> bool:
    # The wheel's own libpocl is named to the loader by pyopencl; a system PoCL has another version.
    version = _packaged_version()
    return bool(version) and f"PoCL {version}" in platform_version


@functools.cache
def _packaged_version() -> str:
    """Return the version of the PoCL that came from the Python package index, empty where there is none."""
    for package in ("pocl-binary-distribution", "pocl_binary_distribution"):
        try:
            return importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return ""


_threads = threading.local()


def _local_cache(name: str) -> dict:
    # Kernel objects hold their arguments, so two threads may never share one.
    if not hasattr(_threads, name):
        setattr(_threads, name, {})
    return getattr(_threads, name)


class Device:
    """An OpenCL context and queue, with arrays and checked launches. Get one from `open_device`."""

    def __init__(self, info: DeviceInfo, device: Any) -> None:
        import pyopencl as cl

        self.info = info
        self._cl = cl
        with _interrupts_wait():  # for the driver's threads that begin here, for ever: Ctrl-C is for the main one
            self._context = cl.Context([device])
            self._queue = cl.CommandQueue(self._context)
        # A driver that is still compiling when the program ends complains on stderr, or worse.
        weakref.finalize(self, _finish_queue, self._queue, os.getpid())
        self._cache = KernelCache("\0".join([info.identity, machine_identity()]))
        self._kernels: dict[tuple, tuple[Any, list[tuple[str, str]]]] = {}
        self._programs: dict[tuple, tuple[Any, str]] = {}
        self._launched: set[tuple] = set()
        self._unsealed: set[str] = set()
        # A queued kernel may use host memory that nothing else refers to: keep it until the queue is empty.
        self._in_flight: list[Any] = []

    @property
    def style(self) -> str:
        """Which kernels this device gets, one of `STYLES`."""
        return self.info.style

    @property
    def shares_memory(self) -> bool:
        """Whether arrays stay in host memory (CPU devices, unless they are to be used like a GPU)."""
        return self.info.kind == self.info.style == "cpu"

    def upload(self, array: NDArray) -> DeviceArray:
        """Return `array` for kernels to read; on a CPU its memory is used in place and must not change."""
        _check_process()
        if not array.flags.c_contiguous:
            raise ValueError(f"expected a C-contiguous array, got strides {array.strides} for shape {array.shape}")
        if array.size == 0:
            raise ValueError(f"an array on a device cannot be empty, got shape {array.shape}")
        flags = self._cl.mem_flags
        where = flags.USE_HOST_PTR if self.shares_memory else flags.COPY_HOST_PTR
        buffer = self._cl.Buffer(self._context, flags.READ_ONLY | where, hostbuf=array)
        return DeviceArray(buffer, array.shape, array.dtype, array if self.shares_memory else None)

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike, host: NDArray | None = None) -> DeviceArray:
        """Return an uninitialised array that kernels may write.

        `host`, when given, is a C-contiguous array of that shape and type; a CPU device writes straight into it.
        """
        _check_process()
        dtype = np.dtype(dtype)
        size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        if size == 0:
            raise ValueError(f"an array on a device cannot be empty, got shape {shape}")
        flags = self._cl.mem_flags
        if not self.shares_memory:
            return DeviceArray(self._cl.Buffer(self._context, flags.READ_WRITE, size), tuple(shape), dtype)
        if host is None:
            host = np.empty(shape, dtype)
        elif host.shape != tuple(shape) or host.dtype != dtype or not host.flags.c_contiguous:
            raise ValueError(
                f"expected a C-contiguous {dtype} host array of shape {shape}, got {host.dtype} {host.shape}"
            )
        buffer = self._cl.Buffer(self._context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=host)
        return DeviceArray(buffer, tuple(shape), dtype, host)

    def download(self, array: DeviceArray) -> NDArray:
        """Wait for the queue and return the array's values as NumPy (the same memory on a CPU)."""
        self.finish()
        if array.host is not None:
            return array.host
        values = np.empty(array.shape, array.dtype)
        self._cl.enqueue_copy(self._queue, values, array.buffer)
        return values

    def finish(self) -> None:
        """Wait until everything launched has ended."""
        _check_process()
        self._queue.finish()
        self._in_flight.clear()
        if self._unsealed:
            self._cache.seal(self._unsealed)
            self._unsealed = set()

    def launch(
        self,
        file: str,
        kernel: str,
        global_size: tuple[int, ...],
        *arguments: Any,
        defines: Mapping[str, object] | None = None,
        local_size: tuple[int, ...] | None = None,
    ) -> None:
        """Queue one kernel after checking each argument against the kernel's own signature.

        An array argument must have the element type of the pointer, and one axis per letter behind the last
        underscore of the parameter's name (``coeffs_kp``: k by p); a letter has one extent in all arguments. A
        scalar named ``size_x`` must be the extent of letter x where an array has that letter.

        Parameters
        ----------
        file, kernel : str
            Kernel file relative to the kernel folder, and the kernel's name in it.
        global_size : tuple of int
            Work-items along each axis.
        *arguments : DeviceArray or number
            In the kernel's order.
        defines : mapping, optional
            ``-D`` definitions of the build.
        local_size : tuple of int, optional
            Work-items of a group; default ``(1, ...)``.

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit the signature.
        KernelBuildError
            If the program does not build.
        """
        _check_process()
        defines = dict(defines or {})
        compiled, parameters = self._kernel(file, kernel, defines)
        values = check_arguments(f"{file}:{kernel}", parameters, arguments)
        for index, value in enumerate(values):
            # Not set_args, which keeps generated Python code in a database on disk.
            compiled.set_arg(index, value.buffer if isinstance(value, DeviceArray) else value)
        if any(size < 1 for size in global_size):
            raise ValueError(f"{file}:{kernel}: the global size must be positive, got {global_size}")
        local_size = local_size or (1,) * len(global_size)
        # PoCL compiles a kernel anew for each local size, and for grids beyond 16 bits.
        variant = (file, kernel, tuple(sorted(defines.items())), local_size, max(global_size) >= 1 << 16)
        if variant not in self._launched:
            self._launched.add(variant)
            self._unsealed.add(self._program(file, defines)[1])
        self._in_flight.append(values)
        with _interrupts_wait():
            self._cl.enqueue_nd_range_kernel(self._queue, compiled, global_size, local_size)

    def _kernel(self, file: str, name: str, defines: dict[str, object]) -> tuple[Any, list[tuple[str, str]]]:
        key = (file, name, tuple(sorted(defines.items())))
        if key not in self._kernels:
            compiled = self._cl.Kernel(self._program(file, defines)[0], name)
            what = self._cl.kernel_arg_info
            parameters = [
                (compiled.get_arg_info(i, what.TYPE_NAME), compiled.get_arg_info(i, what.NAME))
                for i in range(compiled.num_args)
            ]
            self._kernels[key] = (compiled, parameters)
        return self._kernels[key]

    def _program(self, file: str, defines: dict[str, object]) -> tuple[Any, str]:
        """Return a built program and its name in the cache."""
        key = (file, tuple(sorted(defines.items())))
        if key not in self._programs:
            options = [
                "-cl-kernel-arg-info",
                "-cl-std=CL1.2",
                *(f"-D{k}={v}" for k, v in sorted(defines.items())),
            ]
            source = read_kernel_source(file)
            program = self._cl.Program(self._context, source)
            try:
                with self._cache.building(source, options) as name, _interrupts_wait(), warnings.catch_warnings():
                    warnings.simplefilter("ignore", self._cl.CompilerWarning)  # of any word that a compiler says
                    self._programs[key] = program.build(options, cache_dir=False), name
            except self._cl.RuntimeError as error:  # not the builtin RuntimeError
                raise KernelBuildError(file, defines, str(error)) from None
        return self._programs[key]


def _finish_queue(queue: Any, process: int) -> None:
    if process == os.getpid():
        queue.finish()


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Keep Ctrl-C until the block ends: a compiler that it strikes prints a complaint of its own."""
    if not hasattr(signal, "pthread_sigmask"):  # not on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def check_arguments(where: str, parameters: list[tuple[str, str]], arguments: tuple) -> list[Any]:
    """Return the arguments ready for a kernel, or say which one does not fit (see `Device.launch`)."""
    if len(arguments) != len(parameters):
        names = ", ".join(name for _, name in parameters)
        raise TypeError(f"{where} takes {len(parameters)} arguments ({names}), got {len(arguments)}")
    extents: dict[str, tuple[int, str]] = {}
    for (type_name, name), value in zip(parameters, arguments, strict=True):
        if type_name.endswith("*"):
            _check_array(where, type_name, name, value, extents)
    return [
        value if type_name.endswith("*") else _check_scalar(where, type_name, name, value, extents)
        for (type_name, name), value in zip(parameters, arguments, strict=True)
    ]


def _check_array(where: str, type_name: str, name: str, value: Any, extents: dict[str, tuple[int, str]]) -> None:
    element = type_name.rstrip("* ").rstrip("0123456789")
    if not isinstance(value, DeviceArray):
        raise TypeError(f"{where}: {name} must be an array on the device, got {type(value).__name__}")
    if value.dtype.name not in _DTYPES[element]:
        raise TypeError(f"{where}: {name} is {type_name}, which takes {_DTYPES[element][0]}, got {value.dtype.name}")
    letters = name.rsplit("_", 1)[-1]
    if len(value.shape) != len(letters):
        raise ValueError(f"{where}: {name} has {len(letters)} axes by its name, got shape {value.shape}")
    for letter, extent in zip(letters, value.shape, strict=True):
        known, owner = extents.setdefault(letter, (extent, name))
        if known != extent:
            raise ValueError(f"{where}: {name} has {extent} along {letter}, but {owner} has {known}")


def _check_scalar(where: str, type_name: str, name: str, value: Any, extents: dict[str, tuple[int, str]]) -> Any:
    if isinstance(value, DeviceArray) or np.ndim(value) != 0:
        raise TypeError(f"{where}: {name} must be one {type_name}, got {type(value).__name__}")
    dtype = np.dtype(_DTYPES[type_name][0])
    if dtype.kind in "iu" and not isinstance(value, int | np.integer):
        raise TypeError(f"{where}: {name} must be a whole number, got {value!r}")
    scalar = dtype.type(value)
    if name.startswith("size_") and name[5:] in extents and extents[name[5:]][0] != int(scalar):
        extent, owner = extents[name[5:]]
        raise ValueError(f"{where}: {name} is {int(scalar)}, but {owner} has {extent} along {name[5:]}")
    return scalar
