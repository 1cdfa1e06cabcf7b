"""The transform between lat-long grids and coefficients: azimuths first, then rows."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import legendre_tables
from clrelight.harmonics.index import degree_of, degrees_of_coefficients, indices_of

_FFT_THREADS = 2
_FEW_ORDERS = 5
"""Orders up to which a product with their waves takes less time than an FFT."""


def project_latlong(
    radiance_hwc: NDArray[np.floating], degree: int, matrix: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Project a lat-long map with sums over azimuth first, then over rows (frequency-space-environment-maps, 6.1).

    ``L_m(theta) = integral L e^(-i m phi) dphi`` is one FFT per row, or of few orders m one matrix product, in the
    map's precision; ``L_lm`` then sums rows in float64 with Fejer's weights. Radiance band-limited to `degree` comes
    back exactly from 2 degree + 1 rows and columns on.

    Parameters
    ----------
    radiance_hwc : ndarray, shape (height, width, channel), float32 or float64
    degree : int
    matrix : ndarray, shape (3, 3), optional
        Axes of `lighting.layouts.parse_axes` with up as z or -z; default: right, forward, up.

    Returns
    -------
    ndarray, shape ((degree + 1)**2, channel), float64
    """
    width = radiance_hwc.shape[1]
    sums_hmc = _sum_azimuths(radiance_hwc, min(degree, width // 2) + 1)  # few columns have few orders
    return project_rows(sums_hmc, width, degree, matrix, first=longitude_azimuths(width)[0], side=-1)


def project_rows(
    sums_hmc: NDArray[np.complexfloating],
    width: int,
    degree: int,
    matrix: NDArray[np.float64] | None = None,
    *,
    first: float = 0.0,
    side: int = 1,
) -> NDArray[np.float64]:
    """Return the coefficients ((degree + 1)**2, channel) of sums of rows, in float64; see `project_latlong`.

    Parameters
    ----------
    sums_hmc : ndarray, shape (height, order m, channel), complex
        ``sum_w L e^(-i m a)``, where ``beta = first + side a`` are the azimuths of `longitude_azimuths`. Of fewer than
        degree + 1 orders the others are 0.
    width : int
        Columns that were summed.
    degree, matrix
        As of `project_latlong`.
    first : float
        Radians.
    side : int
        1 or -1.
    """
    axes = np.eye(3) if matrix is None else matrix
    height, n_order, channel = sums_hmc.shape
    plan = _latlong_plan(height, degree)
    parts_hmx = sums_hmc.view(sums_hmc.real.dtype)[:: 1 if axes[2, 2] > 0 else -1]
    parts_mhx = parts_hmx.transpose(1, 0, 2).astype(np.float64, order="C")
    made_mlx = np.zeros((degree + 1, degree + 1, 2 * channel))
    for m in range(n_order):
        np.matmul(plan.legendre_mlh[m], parts_mhx[m], out=made_mlx[m, m:])
    made_mlc = made_mlx.view(np.complex128)
    # Azimuths in our axes, which may be turned about z by quarters and mirrored: phi = start + turn beta.
    start = math.atan2(axes[1, 0], axes[0, 0])
    turn = 1.0 if axes[0, 0] * axes[1, 1] - axes[0, 1] * axes[1, 0] > 0 else -1.0
    phase_m11 = np.exp(1j * np.arange(degree + 1) * (start + turn * first))[:, None, None] * (2.0 * np.pi / width)
    made_mlc = phase_m11 * (made_mlc.conj() if turn * side > 0 else made_mlc)
    return made_mlc.view(np.float64).reshape(-1, channel, 2)[plan.place_k, :, plan.part_k]


def _sum_azimuths(radiance_hwc: NDArray[np.floating], orders: int) -> NDArray[np.complexfloating]:
    """Return ``sum_x L e^(-2 pi i m x / width)`` for m = 0 .. orders - 1, shape (height, orders, channel)."""
    if orders > _FEW_ORDERS:
        return scipy.fft.rfft(radiance_hwc, axis=1, workers=_FFT_THREADS)[:, :orders]
    height, width, channel = radiance_hwc.shape
    waves_xn = _waves(width, orders, channel, radiance_hwc.dtype)
    cosine, sine = np.moveaxis((radiance_hwc.reshape(height, -1) @ waves_xn).reshape(height, 2, orders, channel), 1, 0)
    return np.ascontiguousarray(cosine - 1j * sine)


@functools.lru_cache(maxsize=2)
def _waves(width: int, orders: int, channel: int, dtype: np.dtype) -> NDArray[np.floating]:
    """Return cosines and sines as a matrix that sums every channel of a row of texels by itself, in one product."""
    angle_xm = 2.0 * np.pi / width * np.outer(np.arange(width), np.arange(orders))
    waves_xm = np.concatenate([np.cos(angle_xm), np.sin(angle_xm)], axis=1)
    return np.kron(waves_xm, np.eye(channel)).astype(dtype)


@dataclass(frozen=True)
class _LatlongPlan:
    """For each order m its polynomials at the rows times the rows' weights, and where coefficients come from.

    ``place_k`` are places of sums by m, then l; ``part_k`` is 0 for their real parts, 1 for imaginary ones.
    """

    legendre_mlh: tuple[NDArray[np.float64], ...]
    place_k: NDArray[np.intp]
    part_k: NDArray[np.intp]


@functools.lru_cache(maxsize=2)
def _latlong_plan(height: int, degree: int) -> _LatlongPlan:
    weight_h = latitude_weights(height)
    tables = legendre_tables(np.pi * (np.arange(height) + 0.5) / height, degree)
    l = degrees_of_coefficients(degree)
    m = np.arange(len(l)) - l * (l + 1)
    legendre = tuple(np.ascontiguousarray(table * weight_h) for table in tables)
    return _LatlongPlan(legendre, np.abs(m) * (degree + 1) + l, (m < 0).astype(np.intp))


def synthesize_latlong(coeffs_kc: NDArray[np.float64], height: int, width: int) -> NDArray[np.float64]:
    """Return the light as a lat-long map (height, width, channel), float64: the inverse of `project_latlong`.

    The map needs more than twice as many columns as the light has degrees.
    """
    degree = degree_of(len(coeffs_kc))
    if width <= 2 * degree:
        raise InputError(f"degree {degree} needs a map of more than {2 * degree} columns, got {width}")
    tables = legendre_tables(np.pi * (np.arange(height) + 0.5) / height, degree)
    spectrum_hmc = np.zeros((height, width // 2 + 1, coeffs_kc.shape[1]), np.complex128)
    first = longitude_azimuths(width)[0]
    l = np.arange(degree + 1)
    for m in range(degree + 1):
        plus, minus = (tables[m].T @ coeffs_kc[indices_of(l[m:], order)] for order in (m, -m))
        spectrum_hmc[:, m] = plus * width if m == 0 else 0.5 * width * (plus + 1j * minus) * np.exp(-1j * m * first)
    return scipy.fft.irfft(spectrum_hmc, width, axis=1)


def longitude_azimuths(width: int) -> NDArray[np.float64]:
    """Return the azimuth, from right towards forward, of each column of a lat-long map; its middle is forward."""
    return 1.5 * np.pi - 2.0 * np.pi * (np.arange(width) + 0.5) / width


def fold_of(width: int) -> int:
    """Return how many columns of a row have waves that differ by signs alone: 4, 2 or 1."""
    return 4 if width % 4 == 0 else 2 if width % 2 == 0 else 1


@functools.lru_cache(maxsize=4)
def folded_waves(width: int, orders: int, multiple: int) -> NDArray[np.float32]:
    """Return ``cos(m beta)`` and ``-sin(m beta)`` for kernels, (orders, 2, columns) float32.

    At the first ``width / fold_of(width)`` columns: those at w, width - 1 - w, width / 2 - 1 - w and width / 2 + w
    have the same but for signs. Padded with zeros to a multiple of columns.
    """
    columns = width // fold_of(width)
    angle_mx = np.outer(np.arange(orders), longitude_azimuths(width)[:columns])
    waves_mjx = np.zeros((orders, 2, -(-columns // multiple) * multiple), np.float32)
    waves_mjx[:, 0, :columns], waves_mjx[:, 1, :columns] = np.cos(angle_mx), -np.sin(angle_mx)
    return waves_mjx


def latitude_weights(height: int) -> NDArray[np.float64]:
    """Return Fejer's first weights for rows at ``theta = pi (h + 1/2) / height``.

    ``sum_h w_h f(cos theta_h)`` is ``integral f(z) dz`` exactly for polynomials below degree `height` (Fejer 1933), so
    the projection to degree L of radiance band-limited to degree L is exact with 2 L + 1 rows. All are positive.
    """
    terms = np.zeros(height)
    terms[0] = 1.0
    k = np.arange(1, (height + 1) // 2)
    terms[2 * k] = -1.0 / (4.0 * k * k - 1.0)
    return 2.0 / height * scipy.fft.dct(terms, type=3)
