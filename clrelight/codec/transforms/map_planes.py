"""Planes of a map that lies in memory, in one kernel: see ``map_planes.cl``."""

from __future__ import annotations

import math

from clrelight.device import Device
from clrelight.matmul import DEPTH, PackedOperator
from clrelight.opencl.arguments import DeviceArray
from clrelight.tiles import Span

_TILES = 128, 64, 32
"""Pixels that a work-item makes: pieces of a map are 128 wide."""
_LEAST_ROOM = 64


def has_tile(device: Device, n_value: int) -> bool:
    """Return whether a device's local memory holds the values of enough pixels."""
    return _room(n_value) <= _most_values(device, _TILES[-1])


def _room(n_value: int) -> int:
    """Return the values that there is room for: one program for many sizes."""
    return max(_LEAST_ROOM, 1 << (n_value - 1).bit_length())


def _most_values(device: Device, tile: int) -> int:
    return device.info.local_memory_bytes // (2 * 4 * tile) - 8 if tile >= 2 * device.info.lanes else 0


def planes_of_map(
    made: DeviceArray,
    coeffs: DeviceArray,
    last: PackedOperator,
    offset: DeviceArray,
    rows: Span,
    columns: Span,
    at: int,
    device: Device,
) -> None:
    """Queue planes of a part of a map, into rows of `made`.

    Parameters
    ----------
    made : DeviceArray, shape (n_plane, height, pitch), float32
        Written from row `at` on.
    coeffs : DeviceArray, shape (n_coeff, height, width, channel), float32
    last : PackedOperator, shape (n_plane, n_coeff * channel)
        In row blocks; see `has_tile`.
    offset : DeviceArray, shape (n_plane,), float32
        What is taken off.
    rows, columns : tuple of int
        The part, the first and the one behind the last.
    at : int
    device : Device
        A CPU.
    """
    heights, room = last.heights_b, _room(math.prod(coeffs.shape[::3]))
    if heights is None:
        raise ValueError("planes of a map need an operator in row blocks")
    tile = next(tile for tile in _TILES if room <= _most_values(device, tile))
    width = columns[1] - columns[0]
    device.launch(
        "codec/map_planes.cl",
        "planes_of_map_jyx",
        (-(-width // tile), rows[1] - rows[0]),
        *(made, coeffs, last.packed_o, heights, offset, at, rows[0], columns[0], width),
        *(*made.shape, *coeffs.shape, heights.shape[0]),
        defines={
            "VECTOR": device.info.lanes,
            "REAL_BITS": 32,
            "TILE": tile,
            "CHUNK": DEPTH,
            "DEPTH": DEPTH,
            "ROOM": room,
        },
    )
