"""Launch the kernels that change each column of the components alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray

LANES = 8
"""Columns that a work-item of the CPU's kernels takes, in the lanes of a vector."""
_GROUP = 128
_ROOM = 256
"""Components that kernels have private memory for, those of degree 15: one program for all such fits."""


def private_room(components: int) -> int:
    """Return for how many components to build a kernel that keeps a column in private memory: at least `components`."""
    return max(_ROOM, components)


def launch_columns(
    device: Device, file: str, kernel: str, z_rq: DeviceArray, *arguments: Any, defines: Mapping[str, object]
) -> None:
    """Queue a kernel of ``fit/`` over all columns of `z_rq`, its first argument; its size and type are defined here."""
    columns = z_rq.shape[1]
    defines = {"REAL_BITS": 8 * z_rq.dtype.itemsize, **defines}
    items, group = columns // LANES, 1
    if device.style == "gpu":
        items, group = -(-columns // _GROUP) * _GROUP, _GROUP
    device.launch(file, kernel, (items,), z_rq, *arguments, defines=defines, local_size=(group,))
