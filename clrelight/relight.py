"""Images of a fitted view under any light."""

from __future__ import annotations

import functools
import itertools
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.arrays import as_float64, check_directions
from clrelight.conventions import srgb_to_linear
from clrelight.dataset import CoefficientMap
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.matmul import multiply_columns
from clrelight.streaming import Buffer, reading_ahead
from clrelight.tiles import row_tiles

_TILE_BYTES = 1 << 25
"""Coefficients of one tile of rows, where they are read from a file."""
_SHOWN_AT_ONCE = 1 << 18
"""Values that become codes while they are in a cache."""
_BINS = 1 << 14
"""Of radiance from 0 to 1: at the foot of the sRGB curve there are 5 to a code."""


def relight(
    coefficients: CoefficientMap, directions_i3: ArrayLike, *, device: Device | None = None
) -> NDArray[np.float32]:
    """Return the view under distant lights, ``image = sum_k c_k y_k(s)`` (noise-resistant-fitting, eq. 1).

    Parameters
    ----------
    coefficients : CoefficientMap
        In memory, or in an open file; then they are read once, tile by tile. Those in float16 are read as they are.
    directions_i3 : array_like, shape (n_light, 3)
        Unit vectors from the surface to the lights. Below the horizon of a hemispherical fit the result means
        nothing; it is returned as it is.
    device : Device, optional

    Returns
    -------
    ndarray, shape (n_light, height, width, channel), float32
        Linear radiance in units of the peak, not clipped.
    """
    directions_i3 = as_float64(directions_i3, "directions")
    if not directions_i3.size:
        raise InputError("relighting needs at least 1 light, got none")
    check_directions(directions_i3, None)
    return combine_maps(device or open_device(), coefficients.functions_at(directions_i3), coefficients)


def combine_maps(device: Device, factor_ik: NDArray[np.float64], coefficients: CoefficientMap) -> NDArray[np.float32]:
    """Return ``sum_k factor_ik c_k`` for each i, (n, height, width, channel) float32; arguments as of `relight`."""
    if isinstance(coefficients.coeffs_khwc, np.ndarray):
        coeffs_kp = np.ascontiguousarray(coefficients.coeffs_khwc).reshape(coefficients.n_coeff, -1)
        images_ip = multiply_columns(device, factor_ik, coeffs_kp)
        return images_ip.reshape(len(factor_ik), *coefficients.image_shape)
    return _combine_tiles(device, factor_ik, coefficients)


def _combine_tiles(device: Device, factor_ik: NDArray[np.float64], coefficients: CoefficientMap) -> NDArray[np.float32]:
    """Combine coefficients that lie in a file: of them, two tiles of rows are held at a time."""
    height, width, channel = coefficients.image_shape
    dtype = np.dtype(coefficients.coeffs_khwc.dtype)
    step = max(1, _TILE_BYTES // (dtype.itemsize * coefficients.n_coeff * width * channel))
    tiles = row_tiles((0, height), step)
    buffers = itertools.cycle([Buffer(), Buffer()])
    images_ihwc = np.empty((len(factor_ik), height, width, channel), np.float32)

    def read(rows: tuple[int, int]) -> NDArray:
        shape = (coefficients.n_coeff, rows[1] - rows[0], width, channel)
        return coefficients.read_rows(*rows, next(buffers).lend(shape, dtype))

    with reading_ahead(read, tiles) as pieces:
        for (first, end), coeffs_khwc in zip(tiles, pieces, strict=True):
            images_ip = multiply_columns(device, factor_ik, coeffs_khwc.reshape(coefficients.n_coeff, -1))
            images_ihwc[:, first:end] = images_ip.reshape(-1, end - first, width, channel)
    return images_ihwc


def to_display(radiance: NDArray, transfer: str) -> NDArray[np.uint8]:
    """Return 8-bit display values of linear radiance: clipped to [0, 1], encoded by the transfer, rounded; NaN is 0."""
    values = np.ascontiguousarray(radiance).reshape(-1)
    shown = np.empty(values.shape, np.uint8)
    starts = range(0, values.size, _SHOWN_AT_ONCE)
    with ThreadPoolExecutor(min(os.cpu_count() or 1, max(len(starts), 1))) as pool:  # NumPy lets go of Python's lock
        pieces = [slice(start, start + _SHOWN_AT_ONCE) for start in starts]
        list(pool.map(lambda piece: _show(values[piece], transfer, shown[piece]), pieces))
    return shown.reshape(radiance.shape)


def _show(values: NDArray, transfer: str, out: NDArray[np.uint8]) -> None:
    below_b, next_b = _codes(transfer, np.result_type(values, np.float32))
    clipped = np.minimum(np.fmax(values, 0.0), 1.0)
    bin_v = (clipped * _BINS).astype(np.intp)
    np.add(below_b.take(bin_v), clipped >= next_b.take(bin_v), out=out)


@functools.cache
def _codes(transfer: str, dtype: np.dtype) -> tuple[NDArray[np.uint8], NDArray]:
    """Return for each of many bins of radiance the code at its beginning, and where in it the next code begins.

    No bin holds the beginnings of two codes; infinity where it holds none. The next begins at the first number of the
    type that is not below.
    """
    half_codes = (np.arange(1, 256) - 0.5) / 255.0
    first_b = srgb_to_linear(half_codes) if transfer == "srgb" else half_codes
    begins_b = np.arange(_BINS + 1) / _BINS
    below_b = np.searchsorted(first_b, begins_b, side="right").astype(np.uint8)
    following = np.append(first_b, np.inf)[below_b]
    next_b = np.where(following < begins_b + 1.0 / _BINS, following, np.inf)
    rounded_b = next_b.astype(dtype)
    return below_b, np.where(rounded_b < next_b, np.nextafter(rounded_b, dtype.type(np.inf)), rounded_b)
