"""Coefficient maps as groups of three components, for codecs of 4 x 4 RGB blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.slabs import slabs


def as_maps(coeffs_khwc: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return RGB maps as they are, anything else as planes (k·c, h, w, 1), three of which make a group."""
    k, h, w, c = coeffs_khwc.shape
    if c == 3:
        return coeffs_khwc
    return np.ascontiguousarray(coeffs_khwc.transpose(0, 3, 1, 2)).reshape(k * c, h, w, 1)


def from_maps(maps_khwc: NDArray[np.float32], shape: tuple[int, int, int, int]) -> NDArray[np.float32]:
    """Return the coefficients that `as_maps` turned into maps."""
    k, h, w, c = shape
    if c == 3:
        return maps_khwc
    return np.ascontiguousarray(maps_khwc.reshape(k, c, h, w).transpose(0, 2, 3, 1))


def maps_shape(shape: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """Return the shape of what `as_maps` makes of coefficients of `shape`."""
    k, h, w, c = shape
    return shape if c == 3 else (k * c, h, w, 1)


def block_counts(shape: tuple[int, int, int, int]) -> tuple[int, int]:
    """Return the groups, and the blocks of each, of coefficients of `shape`."""
    k, h, w, c = maps_shape(shape)
    return (k if c == 3 else -(-k // 3), -(-h // 4) * -(-w // 4))


def blocks_above(row: int, width: int) -> int:
    """Return the blocks of a group above a row, a multiple of 4."""
    return row // 4 * -(-width // 4)


def group_slabs(shape: tuple[int, int, int, int]) -> list[tuple[slice, slice]]:
    """Return slices of the groups and of the maps in them, one pair for each launch."""
    k, h, w, c = maps_shape(shape)
    per_group = 1 if c == 3 else 3
    parts = slabs(block_counts(shape)[0], 12 * h * w)
    return [(g, slice(g.start * per_group, min(g.stop * per_group, k))) for g in parts]
