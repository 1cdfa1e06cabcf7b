"""The device's multiply-add peak, measured beside the stages whose share of it is told."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clrelight.device import Device
from clrelight.matmul import vector_width

_CHAINS = 12
_STEPS = 1 << 17


def peak_run(device: Device) -> tuple[Callable[[], None], float]:
    """Return a run of the peak kernel, and its floating-point operations."""
    on_cpu = device.style == "cpu"
    group = 1 if on_cpu else 128
    items = device.info.compute_units * (16 if on_cpu else 16 * group)
    vector = vector_width(device)
    sums_q = device.empty((items,), np.float32)

    def run() -> None:
        device.launch(
            "benchmark/peak.cl",
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
