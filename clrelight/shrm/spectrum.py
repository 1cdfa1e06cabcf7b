"""Reflection maps as sums over orders m: made of light and reflectance by sums over degrees, and turned row by row."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.brdf.coefficients import BrdfCoefficients
from clrelight.harmonics.index import coefficient_count, coefficient_index
from clrelight.harmonics.rotations import turns_about_y
from clrelight.harmonics.wigner import turn_tables

_ORDERS_AT_ONCE = 16
"""Orders m of one batch of products: degrees below the least of them are left out."""
_KEPT_TABLES = 1 << 26
"""Bytes of the functions of one q and -q beyond which they are made anew for each map."""


def sum_degrees(
    light_kc: NDArray[np.float64], brdf: BrdfCoefficients, height: int, dtype: DTypeLike = np.float64
) -> NDArray[np.complexfloating]:
    """Return A with ``map_k = Re sum_m A_km e^(i m beta)``, (height, (P + 1)**2, F + 1, channel) complex.

    As the light is real, the orders m and -m add up to ``Re (L_lm e^(i m beta)) (d_mq + d_-mq)`` in the real part of
    ``B_pq``, and to ``Im (L_lm e^(i m beta)) (d_mq - d_-mq)`` in the imaginary one: for each q one matrix product an
    order m, for all p and channels at once.

    Parameters
    ----------
    light_kc : ndarray, shape (n_coeff, channel), float64
        What lies beyond the reflectance's degree does not count.
    brdf : BrdfCoefficients
    height : int
        Rows of the map.
    dtype : float64 or float32
        Of the sums.
    """
    degree, order = brdf.degree, brdf.order
    light_mlc = _light_by_order(light_kc, degree)
    real, complexes = np.dtype(dtype), np.result_type(dtype, np.complex64)
    count, channel = coefficient_count(order), max(light_kc.shape[1], brdf.channels)
    sums_hmkx = np.zeros((height, degree + 1, count, 2 * channel), real)
    sums_mhy = sums_hmkx.reshape(height, degree + 1, -1).transpose(1, 0, 2)
    placed: list[int] = []
    for q in range((min(order, degree) if brdf.has_azimuth else 0) + 1):
        product_mlpc = light_mlc[:, :, None] * brdf.rho_lpqc[:, q:, q]
        for side in range(2 if q else 1):  # q, then -q, where -Im z = Re (i z)
            part = slice(2 * channel * len(placed), 2 * channel * (len(placed) + order + 1 - q))
            placed += [coefficient_index(p, -q if side else q) for p in range(q, order + 1)]
            side_mlpc = product_mlpc * (np.sqrt(2.0) * (1j if side else 1.0) if q else 1.0)
            side_mly = side_mlpc.astype(complexes, copy=False).view(real).reshape(degree + 1, degree + 1, -1)
            for block in _row_blocks(height, degree, q, real):
                product_mly = np.ascontiguousarray(side_mly[block.orders, block.first :])
                np.matmul(block.tables_mhl[side], product_mly, out=sums_mhy[block.orders, :, part])
    place_k = np.empty(count, np.intp)
    place_k[placed + sorted(set(range(count)) - set(placed))] = np.arange(count)
    made_hkmx = np.empty((height, count, degree + 1, 2 * channel), real)
    # All channels of an order are one value of so many bytes.
    value = np.dtype((np.void, 2 * channel * real.itemsize))
    made_hkm, sums_hmk = made_hkmx.view(value)[..., 0], sums_hmkx.view(value)[..., 0]
    for k, place in enumerate(place_k):
        made_hkm[:, k] = sums_hmk[:, :, place]
    return made_hkmx.view(complexes)


def _light_by_order(light_kc: NDArray[np.float64], degree: int) -> NDArray[np.complex128]:
    """Return ``L_lm`` of complex harmonics of m >= 0 (`harmonics.wigner`), (m, l, channel), 0 where l < m."""
    m, l = np.ogrid[: degree + 1, : degree + 1]
    held = l >= m
    plus_mlc, minus_mlc = (light_kc[np.where(held, l * (l + 1) + side * m, 0)] for side in (1, -1))
    scale_ml = held * np.where(m > 0, np.sqrt(0.5), 1.0)
    return np.asarray(scale_ml[:, :, None] * (plus_mlc - 1j * minus_mlc * (m > 0)[:, :, None]), np.complex128)


@dataclass(frozen=True)
class _RowBlock:
    """Functions of some orders m at all rows: at a row and its mirror about the equator the same but for signs.

    Attributes
    ----------
    orders : slice
        Which m.
    first : int
        Least degree of any of them.
    tables_mhl : tuple of ndarray, shape (m, row, l)
        ``d_mq + d_-mq`` (for m = 0 ``d_0q``), then ``d_mq - d_-mq``.
    """

    orders: slice
    first: int
    tables_mhl: tuple[NDArray[np.floating], NDArray[np.floating]]


def _row_blocks(height: int, degree: int, q: int, real: np.dtype) -> list[_RowBlock]:
    size = 2 * height * (degree + 1) ** 2 * real.itemsize
    return (_kept_blocks if size <= _KEPT_TABLES else _make_blocks)(height, degree, q, real)


def _make_blocks(height: int, degree: int, q: int, real: np.dtype) -> list[_RowBlock]:
    upper = (height + 1) // 2
    alpha_h = np.pi * (np.arange(upper) + 0.5) / height
    l = np.arange(degree + 1)
    blocks = []
    for start in range(0, degree + 1, _ORDERS_AT_ONCE):
        orders, first = slice(start, min(start + _ORDERS_AT_ONCE, degree + 1)), max(start, q)
        plus_mhl, minus_mhl = turn_tables(alpha_h, degree, l[orders], q)
        sums_mhl, differences_mhl = plus_mhl + minus_mhl, plus_mhl - minus_mhl
        if start == 0:
            sums_mhl[0] = plus_mhl[0]
        sign_m1l = (-1.0) ** ((l[orders, None, None] + l + q) % 2)  # of sums at the mirrored row
        sums, differences = (
            np.ascontiguousarray(
                np.concatenate([table, sign * sign_m1l * table[:, : height - upper][:, ::-1]], axis=1)[:, :, first:],
                real,
            )
            for table, sign in ((sums_mhl, 1.0), (differences_mhl, -1.0))
        )
        blocks.append(_RowBlock(orders, first, (sums, differences)))
    return blocks


_kept_blocks = functools.lru_cache(maxsize=16)(_make_blocks)


def turn_rows(values_hkx: NDArray, order: int, alpha_h: NDArray[np.float64]) -> NDArray:
    """Return coefficients (row, k, ...) turned about y by the angle of their row; values may be complex sums."""
    return turns_about_y(tuple(alpha_h.tolist()), order, values_hkx.real.dtype.name).apply_each(values_hkx)


def turn_orders(sums_hkmc: NDArray[np.complexfloating], order: int) -> NDArray[np.complexfloating]:
    """Return sums of maps turned about z by the azimuth of their column, of orders up to ``F + P``.

    ``Z = map_q + i map_-q`` becomes ``e^(i q beta) Z``: its orders move up by q.
    """
    height, count, n_order, channel = sums_hkmc.shape
    made_hkmc = np.zeros((height, count, n_order + order, channel), sums_hkmc.dtype)
    zonal = [coefficient_index(p, 0) for p in range(order + 1)]
    made_hkmc[:, zonal, :n_order] = sums_hkmc[:, zonal]
    for q in range(1, order + 1):
        plus, minus = ([coefficient_index(p, side * q) for p in range(q, order + 1)] for side in (1, -1))
        real, imaginary = sums_hkmc[:, plus], sums_hkmc[:, minus]
        imaginary *= 1j
        up, down = 0.5 * (real + imaginary), 0.5 * (real - imaginary)  # orders m of Z, and conjugates of -m
        up[:, :, 0] = real[:, :, 0].real + 1j * imaginary[:, :, 0].imag
        moved = np.zeros((height, len(plus), n_order + q, channel), sums_hkmc.dtype)
        moved[:, :, q:] = up
        few = min(q, n_order - 1)
        moved[:, :, q - few : q] = down[:, :, few:0:-1].conj()
        back = np.zeros_like(moved)  # conjugates of orders -m
        back[:, :, 1 : max(n_order - q, 1)] = down[:, :, 1 + q :]
        made_hkmc[:, plus, : n_order + q] = moved + back
        made_hkmc[:, minus, : n_order + q] = -1j * (moved - back)
    return made_hkmc
