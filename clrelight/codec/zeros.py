"""Zeros on a device, written by all of its processors: what decoders add to."""

from __future__ import annotations

import math

import numpy as np

from clrelight import recycling
from clrelight.codec.transforms.whitening import reshaped
from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray

_ITEM = 1 << 16
"""Values that a work-item of a CPU writes; of a GPU one."""


def zeros(shape: tuple[int, ...], device: Device) -> DeviceArray:
    """Return float32 zeros, queued; new memory of the system's, which holds them, is not touched."""
    size = math.prod(shape)
    if device.shares_memory and not recycling.is_kept(4 * size):
        return device.hold(np.zeros(shape, np.float32))
    made = device.empty(shape, np.float32)
    item = _ITEM if device.style == "cpu" else 1
    device.launch("codec/zeros.cl", "write_zeros_v", (-(-size // item),), reshaped(made, (size,)), item, size)
    return made
