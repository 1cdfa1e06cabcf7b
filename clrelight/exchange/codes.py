"""Display values of a fit under many lights, a few rows at a time: what other formats hold."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import linear_to_srgb, srgb_to_linear
from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.memory import TILE_BYTES
from clrelight.surface import surface_facts
from clrelight.tiles import row_tiles


def check_picture(coefficients: CoefficientMap, what: str) -> None:
    """Raise InputError unless a fit is of a picture of 1 or 3 channels."""
    if surface_facts(coefficients.surface, coefficients.config) is not None:
        raise InputError(f"{what} holds pictures, and this is a function at the vertices of a surface")
    if coefficients.image_shape[2] not in (1, 3):
        raise InputError(f"{what} holds 3 channels, the fit has {coefficients.image_shape[2]}")


def row_pieces(coefficients: CoefficientMap, n_light: int) -> Iterator[tuple[int, int]]:
    """Yield rows, from the first to before the end, whose display values under so many lights fit a piece."""
    height, width, _ = coefficients.image_shape
    step = max(TILE_BYTES // (4 * 3 * max(n_light, coefficients.n_coeff) * width), 1)
    yield from row_tiles((0, height), step)


def display_values(
    coefficients: CoefficientMap,
    basis_ik: NDArray[np.float64],
    first: int,
    end: int,
    span: tuple[float, float] = (0.0, 1.0),
) -> NDArray[np.float32]:
    """Return display values of rows under lights, (n_light, pixel, 3), float32, by the stack's curve.

    A gray view has three equal channels. Radiance is cut to the span; beyond 0 .. 1 the curve goes on.
    """
    n_coeff, (_, width, channel) = coefficients.n_coeff, coefficients.image_shape
    coeffs_khwc = coefficients.read_rows(first, end, np.empty((n_coeff, end - first, width, channel), np.float32))
    return shown_of(coeffs_khwc.reshape(n_coeff, -1, channel), coefficients.transfer, basis_ik, span)


def shown_of(
    coeffs_kpc: NDArray[np.float32], transfer: str, basis_ik: NDArray[np.float64], span: tuple[float, float]
) -> NDArray[np.float32]:
    """Return display values of some pixels as `display_values` does, (n_light, pixel, 3)."""
    n_coeff, _, channel = coeffs_kpc.shape
    radiance_ip = basis_ik.astype(np.float32) @ coeffs_kpc.reshape(n_coeff, -1)
    clipped_ipc = np.clip(radiance_ip, *span).reshape(len(basis_ik), -1, channel)
    shown = clipped_ipc if transfer == "linear" else linear_to_srgb(clipped_ipc, np.float32)
    return np.repeat(shown, 3, axis=2) if channel == 1 else shown


def radiance_of(shown: NDArray[np.float32], transfer: str) -> NDArray[np.float32]:
    """Return linear radiance of display values."""
    return shown if transfer == "linear" else srgb_to_linear(shown, np.float32)
