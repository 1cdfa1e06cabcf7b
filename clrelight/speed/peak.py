"""What the machine can do at most: multiply-adds of the device, and copies within the memory of the host."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clrelight.device import Device
from clrelight.matmul import vector_width

_CHAINS = 12
_STEPS = 1 << 17
_COPIED_BYTES = 1 << 27


def peak_run(device: Device) -> tuple[Callable[[], None], float]:
    """Return a run of the peak kernel, and its floating-point operations."""
    on_cpu = device.style == "cpu"
    group = 1 if on_cpu else 128
    items = device.info.compute_units * (16 if on_cpu else 16 * group)
    vector = vector_width(device)
    sums_q = device.empty((items,), np.float32)

    def run() -> None:
        device.launch(
            "speed/peak.cl",
            "multiply_add_q",
            (items,),
            sums_q,
            0.999,
            0.001,
            _STEPS,
            items,
            defines={"VECTOR": vector},
            local_size=(group,),
        )

    return run, 2.0 * _CHAINS * vector * _STEPS * items


def copy_run() -> tuple[Callable[[], None], float]:
    """Return a run of a NumPy copy that no cache holds, and the bytes it reads and writes."""
    source = np.zeros(_COPIED_BYTES, np.uint8)
    target = np.ones_like(source)

    def run() -> None:
        np.copyto(target, source)

    return run, 2.0 * _COPIED_BYTES
