"""Open an OpenCL device, hold arrays on it, and launch kernels with checked arguments."""

from __future__ import annotations

import os
import threading
import warnings
import weakref
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight import recycling
from clrelight.errors import DeviceError, KernelBuildError, telling_line
from clrelight.kernel_source import kernel_for, read_kernel_source
from clrelight.opencl.arguments import DeviceArray, check_arguments
from clrelight.opencl.child import circumstances
from clrelight.opencl.declarations import GUARD, declare_called
from clrelight.opencl.devices import DeviceInfo, check_process, choose_device, interrupts_wait, loaded_devices
from clrelight.opencl.kernel_cache import KernelCache
from clrelight.opencl.probe import machine_identity


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
    info = choose_device(spec, style)
    opened = _local_cache("opened")
    key = (info.index, info.style, info.lanes)
    if key not in opened:
        opened[key] = Device(info, loaded_devices()[info.index][1])
    return opened[key]


def make_device(spec: str, *, style: str) -> Device:
    """Return an object of its own for a device, of which `open_device` knows nothing; the same errors.

    For those who let one thread at a time use it: that costs less than an object for each of many short threads.
    """
    info = choose_device(spec, style)
    return Device(info, loaded_devices()[info.index][1])


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
        with interrupts_wait():  # for the driver's threads that begin here, for ever: Ctrl-C is for the main one
            self._context = cl.Context([device])
            self._queue = cl.CommandQueue(self._context)
        # A driver that is still compiling when the program ends complains on stderr, or worse.
        weakref.finalize(self, _finish_queue, self._queue, os.getpid())
        identity = "\0".join([info.identity, machine_identity()])
        self._cache = KernelCache(identity, by_bitcode=info.packaged)
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
    def _options(self) -> tuple[str, ...]:
        return "-cl-kernel-arg-info", "-cl-std=CL1.2"

    @property
    def shares_memory(self) -> bool:
        """Whether arrays stay in host memory (CPU devices, unless they are to be used like a GPU)."""
        return self.info.kind == self.info.style == "cpu"

    def upload(self, array: NDArray) -> DeviceArray:
        """Return `array` for kernels to read; on a CPU its memory is used in place and must not change."""
        check_process()
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
        check_process()
        dtype = np.dtype(dtype)
        size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        if size == 0:
            raise ValueError(f"an array on a device cannot be empty, got shape {shape}")
        flags = self._cl.mem_flags
        if not self.shares_memory:
            return DeviceArray(self._cl.Buffer(self._context, flags.READ_WRITE, size), tuple(shape), dtype)
        if host is None:
            host = recycling.empty(shape, dtype)
        elif host.shape != tuple(shape) or host.dtype != dtype or not host.flags.c_contiguous:
            raise ValueError(
                f"expected a C-contiguous {dtype} host array of shape {shape}, got {host.dtype} {host.shape}"
            )
        buffer = self._cl.Buffer(self._context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=host)
        return DeviceArray(buffer, tuple(shape), dtype, host)

    def hold(self, array: NDArray) -> DeviceArray:
        """Return an array that kernels may write, and that begins as `array`; a CPU device writes into that."""
        if self.shares_memory:
            return self.empty(array.shape, array.dtype, array)
        check_process()
        flags = self._cl.mem_flags
        buffer = self._cl.Buffer(self._context, flags.READ_WRITE | flags.COPY_HOST_PTR, hostbuf=array)
        return DeviceArray(buffer, array.shape, array.dtype)

    def download(self, array: DeviceArray) -> NDArray:
        """Wait for the queue and return the array's values as NumPy (the same memory on a CPU)."""
        self.finish()
        if array.host is not None:
            return array.host
        values = np.empty(array.shape, array.dtype)
        self._cl.enqueue_copy(self._queue, values, array.buffer)
        return values

    def fetch(self, array: DeviceArray, out: NDArray) -> None:
        """Wait for the queue and have the array's values in `out`, where they are if that is its memory on a CPU."""
        values = self.download(array)
        if not np.may_share_memory(values, out):
            out[...] = values

    def finish(self) -> None:
        """Wait until everything launched has ended."""
        check_process()
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
            Kernel file relative to the kernel folder, and the kernel's name in it. Of a file with a twin for this
            device's style (``fit/cls.gpu.cl`` beside ``fit/cls.cl``), the twin is taken.
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
        check_process()
        file, defines = kernel_for(file, self.style), dict(defines or {})
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
        with interrupts_wait():
            self._cl.enqueue_nd_range_kernel(self._queue, compiled, global_size, local_size)

    def _kernel(self, file: str, name: str, defines: dict[str, object]) -> tuple[Any, list[tuple[str, str]]]:
        key = (file, name, tuple(sorted(defines.items())))
        if key not in self._kernels:
            program, built = self._program(file, defines)
            compiled = self._cl.Kernel(program, self._cache.own_name(name, built))
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
            options = [*self._options, *(f"-D{k}={v}" for k, v in sorted(defines.items()))]
            source = read_kernel_source(file)
            try:
                with self._cache.building(source, options) as name, interrupts_wait(), warnings.catch_warnings():
                    warnings.simplefilter("ignore", self._cl.CompilerWarning)  # of any word that a compiler says
                    self._programs[key] = self._build(source, options, name), name
            except self._cl.RuntimeError as error:  # not the builtin RuntimeError
                if found := circumstances():  # which may be why, or not: so both are told
                    raise DeviceError(
                        f"{file} does not build ({'; '.join(found)}): {telling_line(str(error))}"
                    ) from None
                raise KernelBuildError(file, defines, str(error)) from None
        return self._programs[key]

    def _build(self, source: str, options: list[str], name: str) -> Any:
        """Return a program of the bitcode that the cache has of it, or gets now; else of its source."""
        kept = self._cache.bitcode(name)
        if kept is not None:
            with suppress(self._cl.Error):  # the driver may have changed since
                return self._build_bitcode(kept, options)
            self._cache.forget(name)
        with self._cache.compiling(source, name) as more:
            program = self._compile(source, [*options, *more])
        made = self._cache.bitcode(name)
        return program if made is None else self._build_bitcode(made, options)

    def _compile(self, source: str, options: list[str]) -> Any:
        """Return a program of its source: with what it calls declared, where that can be known, else with all."""
        declared = declare_called(source) if self.info.packaged else None
        if declared is not None:
            with suppress(self._cl.RuntimeError):  # what is wrong the driver tells of the source alone
                program = self._cl.Program(self._context, declared + source)
                return program.build([*options, f"-D{GUARD}"], cache_dir=False)
        return self._compile_whole(source, options)

    def _compile_whole(self, source: str, options: list[str]) -> Any:
        return self._cl.Program(self._context, source).build(options, cache_dir=False)

    def _build_bitcode(self, bitcode: bytes, options: list[str]) -> Any:
        program = self._cl.Program(self._context, self._context.devices, [bitcode])
        return program.build(options, cache_dir=False)


def _finish_queue(queue: Any, process: int) -> None:
    if process == os.getpid():
        queue.finish()
