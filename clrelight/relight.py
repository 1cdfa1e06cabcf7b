"""Images of a fitted view under any light."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.arrays import as_float64, check_directions
from clrelight.conventions import linear_to_srgb
from clrelight.dataset import CoefficientMap
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.matmul import multiply_columns
from clrelight.streaming import Buffer, reading_ahead

_TILE_BYTES = 1 << 25
"""Coefficients of one tile of rows, where they are read from a file."""


def relight(
    coefficients: CoefficientMap, directions_i3: ArrayLike, *, device: Device | None = None
) -> NDArray[np.float32]:
    """Return the view under distant lights of unit strength, ``image = sum_k c_k y_k(s)`` (paper, eq. 1).

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
    return combine_maps(device or open_device(), evaluate_basis(directions_i3, coefficients.degree), coefficients)


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
    tiles = [(first, min(first + step, height)) for first in range(0, height, step)]
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
    """Return 8-bit display values of linear radiance: clipped to [0, 1], encoded by the transfer, rounded."""
    clipped = np.clip(radiance, 0.0, 1.0)
    encoded = linear_to_srgb(clipped) if transfer == "srgb" else clipped
    return np.rint(encoded * 255.0).astype(np.uint8)
