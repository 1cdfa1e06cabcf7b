"""The four cosets in which a subband's samples are coded, and what each knows of the samples before it."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.transforms.lifting import Subband

COSETS = ((0, 0), (1, 1), (0, 1), (1, 0))
"""First row and column of each coset; the others follow in steps of two."""

BATCHES = ((0,), (1,), (2, 3))
"""Cosets that are coded together: the last two know the first two only."""


def relatives_of(band: Subband) -> list[tuple[str, int]]:
    """Return name and level of the parent and of the siblings that are coded before a subband."""
    if band.name == "LL":
        return []
    siblings = {"HL": [], "LH": ["HL"], "HH": ["HL", "LH"]}[band.name]
    return [(band.name, band.level + 1), *((name, band.level) for name in siblings)]


def gather(bordered: NDArray, coset: int) -> NDArray:
    """Return the sum of the four neighbours at each sample of a coset; the array has a border of one."""
    height, width = bordered.shape[-2:]
    row, column = COSETS[coset]
    parts = [
        bordered[..., 1 + row + y : height - 1 + y : 2, 1 + column + x : width - 1 + x : 2]
        for y, x in _neighbours_of(coset)
    ]
    return parts[0] + parts[1] + parts[2] + parts[3]


@functools.lru_cache(maxsize=256)
def neighbour_count(coset: int, height: int, width: int) -> NDArray[np.int32]:
    """Return how many of the neighbours lie inside the subband, at least 1."""
    return np.maximum(gather(np.pad(np.ones((height, width), np.int32), 1), coset), 1)


def _neighbours_of(coset: int) -> list[tuple[int, int]]:
    """Return the (row, column) offsets of the four nearest samples that are known in a coset."""
    return [(-1, -1), (-1, 1), (1, -1), (1, 1)] if coset == 1 else [(0, -1), (0, 1), (-1, 0), (1, 0)]


def crop(values: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Return the top left of an array, with zeros where it is too small (subbands of odd sides differ by one)."""
    values = values[:, : shape[1], : shape[2]]
    if values.shape == shape:
        return values
    return np.pad(values, [(0, wanted - there) for wanted, there in zip(shape, values.shape, strict=True)])


def differentiate(values: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return each sample less the one to its left; in the first column, less the one above."""
    result = values.astype(np.int64)
    result[..., 1:] -= values[..., :-1]
    result[..., 1:, 0] -= values[..., :-1, 0]
    return result


def integrate(values: NDArray[np.integer]) -> NDArray[np.int64]:
    """Undo `differentiate`."""
    result = values.astype(np.int64)
    result[..., 0] = np.cumsum(values[..., 0], axis=-1, dtype=np.int64)
    return np.cumsum(result, axis=-1)
