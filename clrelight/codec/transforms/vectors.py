"""Coefficients as one vector for each pixel, and the power of two that keeps their squares within float32."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.slabs import slabs

FLOAT32_MAX = float(np.finfo(np.float32).max)


def pixel_vectors(coeffs_khwc: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (pixel, k channel + c) vectors."""
    k, h, w, c = coeffs_khwc.shape
    return np.ascontiguousarray(coeffs_khwc.transpose(1, 2, 0, 3)).reshape(h * w, k * c)


def from_pixel_vectors(vectors_pd: NDArray[np.float32], shape: tuple[int, int, int, int]) -> NDArray[np.float32]:
    """Return the coefficients whose pixel vectors these are."""
    k, h, w, c = shape
    return np.ascontiguousarray(vectors_pd.reshape(h, w, k, c).transpose(2, 0, 1, 3))


def exponent_of(values: NDArray[np.float32]) -> int:
    """Return e such that ``values * 2**-e`` lie within -1..1; 0 where all are zero."""
    return int(np.frexp(max(float(values.max()), -float(values.min())))[1])


def scaled(values: NDArray, exponent: int) -> NDArray[np.float32]:
    """Return ``values * 2**exponent`` in float32, clipped to its range."""
    result = np.empty(values.shape, np.float32)
    for part in slabs(len(values), 8 * max(values[0].size, 1)):  # float64 of everything at once would be twice as much
        exact = np.ldexp(values[part].astype(np.float64), exponent)
        result[part] = np.clip(exact, -FLOAT32_MAX, FLOAT32_MAX, out=exact)
    return result


def spread_sample(count: int, size: int) -> NDArray[np.intp]:
    """Return min(count, size) distinct indices below `count` in order, spread evenly but along no row or column."""
    if count <= size:
        return np.arange(count)
    return np.unique(golden_indices(count, size))  # what rounds to one index twice is taken once


def golden_indices(count: int, size: int) -> NDArray[np.int64]:
    """Return `size` indices below `count`, all of them spread evenly and so are the first few; some may come twice."""
    # Multiples of the golden ratio follow no row, column or channel.
    return (np.arange(size) * 0.6180339887498949 % 1.0 * count).astype(np.int64)
