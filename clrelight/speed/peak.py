"""What the machine can do at most: multiply-adds of the device, and copies within the memory of the host."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray

_STEPS = 1 << 17
_CPU_CHAINS, _GPU_CHAINS, _GPU_GROUP = 12, 16, 128
_COPIED_BYTES = 1 << 27
_CPU_COPIES, _GPU_COPIES = 1 << 14, 4


def peak_run(device: Device) -> tuple[Callable[[], None], float]:
    """Return a run of the peak kernel, and its floating-point operations."""
    if device.style == "gpu":
        group, each, steps = _GPU_GROUP, _GPU_CHAINS, _STEPS // 4
        items, defines = device.info.compute_units * 16 * group, {}
    else:
        vector = device.info.lanes
        group, each, steps = 1, _CPU_CHAINS * vector, _STEPS
        items, defines = device.info.compute_units * 16, {"VECTOR": vector}
    sums_q = device.empty((items,), np.float32)

    def run() -> None:
        arguments = (sums_q, 0.999, 0.001, steps, items)
        device.launch("speed/peak.cl", "multiply_add_q", (items,), *arguments, defines=defines, local_size=(group,))

    return run, 2.0 * each * _STEPS * items


def device_copy_run(device: Device) -> tuple[Callable[[], None], float]:
    """Return a run of a copy within the device's memory that no cache holds, and the bytes it reads and writes."""
    source_p = device.upload(np.ones(_COPIED_BYTES // 4, np.float32))
    out_p = device.empty(source_p.shape, np.float32)
    return lambda: copy_values(device, out_p, source_p), 2.0 * _COPIED_BYTES


def copy_values(device: Device, out_p: DeviceArray, source_p: DeviceArray) -> None:
    """Queue a copy between float32 arrays of one axis."""
    count = source_p.shape[0]
    each, group = (_GPU_COPIES, _GPU_GROUP) if device.style == "gpu" else (_CPU_COPIES, 1)
    items = -(-count // (each * group)) * group
    defines = {"EACH": each, "STRIDE": group}
    device.launch("speed/copy.cl", "copy_p", (items,), out_p, source_p, count, defines=defines, local_size=(group,))


def copy_run() -> tuple[Callable[[], None], float]:
    """Return a run of a NumPy copy that no cache holds, and the bytes it reads and writes."""
    source = np.zeros(_COPIED_BYTES, np.uint8)
    target = np.ones_like(source)

    def run() -> None:
        np.copyto(target, source)

    return run, 2.0 * _COPIED_BYTES
