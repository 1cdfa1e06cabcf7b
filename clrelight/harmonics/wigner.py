"""Turns about y by many angles, as functions of the angle: what spins harmonics of one order into another.

Complex harmonics here are ``(y_lm + i y_l-m) / sqrt(2)`` of the real ones for m > 0, the conjugate of that for -m, and
y_l0: without the sign of Condon and Shortley, which would multiply ``d^l_mq`` by (-1) for each of m and q above 0.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.index import degree_of


def complex_coefficients(coeffs_kc: NDArray[np.float64], m: int) -> NDArray[np.complex128]:
    """Return the coefficients of the complex harmonics of one order m >= 0, (degree + 1 - m, channel): l = m .. degree.

    ``L_lm = (c_lm - i c_l-m) / sqrt(2)``; those of -m are their conjugates, as the function is real.
    """
    l = np.arange(m, degree_of(len(coeffs_kc)) + 1)
    plus_lc = coeffs_kc[l * (l + 1) + m]
    return plus_lc.astype(np.complex128) if m == 0 else (plus_lc - 1j * coeffs_kc[l * (l + 1) - m]) * math.sqrt(0.5)


def turn_functions(alpha_h: NDArray[np.float64], degree: int, m: int, q: int) -> NDArray[np.float64]:
    """Return ``d^l_mq(alpha)`` for l = max(|m|, |q|) .. degree, (degree + 1 - max(|m|, |q|), n) float64.

    ``Y_lm(Rz(beta) Ry(alpha) Rz(gamma) s) = sum_q d^l_mq(alpha) e^(i m beta) e^(i q gamma) Y_lq(s)``. Upwards in l by
    ``l sqrt(((l + 1)^2 - m^2) ((l + 1)^2 - q^2)) d^(l + 1) = (2 l + 1) (l (l + 1) cos(alpha) - m q) d^l -
    (l + 1) sqrt((l^2 - m^2) (l^2 - q^2)) d^(l - 1)`` (Varshalovich et al. 1988, chapter 4), which is stable.
    """
    first = max(abs(m), abs(q))
    rows_lh = np.zeros((max(degree + 1 - first, 0), len(alpha_h)))
    if first > degree:
        return rows_lh
    rows_lh[0] = _first_turn(alpha_h, m, q)
    x_h, before_h = np.cos(alpha_h), np.zeros(len(alpha_h))
    for l in range(first, degree):
        here_h = rows_lh[l - first]
        if l == 0:  # where the recurrence reads 0 = 0
            rows_lh[1] = x_h
        else:
            down = (l + 1.0) * math.sqrt((l * l - m * m) * (l * l - q * q))
            up = l * math.sqrt(((l + 1.0) ** 2 - m * m) * ((l + 1.0) ** 2 - q * q))
            now_h = (2 * l + 1) * (l * (l + 1.0) * x_h - m * q) * here_h
            rows_lh[l + 1 - first] = (now_h - down * before_h) / up
        before_h = here_h
    return rows_lh


def turn_tables(alpha_h: NDArray[np.float64], degree: int, orders_m: NDArray[np.intp], q: int) -> NDArray[np.float64]:
    """Return ``d^l_mq(alpha)`` of many orders m >= 0 and of their opposites, (2, m, n, degree + 1) float64.

    First those of m, then those of -m; 0 where l is below m or q. As `turn_functions`, all m in one recurrence.

    Parameters
    ----------
    alpha_h : ndarray, shape (n,), float64
        Radians.
    degree : int
    orders_m : ndarray, shape (m,), int
        From 0 to `degree`, rising.
    q : int
        0 or more.
    """
    m_m = np.concatenate([orders_m, -orders_m])
    table_mlh = np.zeros((len(m_m), degree + 1, len(alpha_h)))
    first_m = np.maximum(np.abs(m_m), q)
    for row, (m, first) in enumerate(zip(m_m.tolist(), first_m.tolist(), strict=True)):
        if first <= degree:
            table_mlh[row, first] = _first_turn(alpha_h, m, q)
    x_h, m_m1 = np.cos(alpha_h), m_m[:, None].astype(np.float64)
    for l in range(int(first_m.min()), degree):
        begun = np.abs(m_m) <= l
        if l == 0:  # where the recurrence reads 0 = 0
            table_mlh[begun, 1] = x_h
            continue
        m = m_m1[begun]
        down = (l + 1.0) * np.sqrt((l * l - m * m) * (l * l - q * q))
        up = l * np.sqrt(((l + 1.0) ** 2 - m * m) * ((l + 1.0) ** 2 - q * q))
        now = (2 * l + 1) * (l * (l + 1.0) * x_h - m * q) * table_mlh[begun, l]
        table_mlh[begun, l + 1] = (now - down * table_mlh[begun, l - 1]) / up
    return np.moveaxis(table_mlh.reshape(2, len(orders_m), degree + 1, -1), 2, 3)


def _first_turn(alpha_h: NDArray[np.float64], m: int, q: int) -> NDArray[np.float64]:
    """Return d of the least l that m and q have: one term, the root of a binomial times powers of the half angle's."""
    powers = abs(m - q), abs(m + q)
    size = math.sqrt(math.comb(2 * max(abs(m), abs(q)), powers[0]))
    sign = -1.0 if (powers[0] % 2 and m > q) != bool((max(m, 0) + max(q, 0)) % 2) else 1.0
    return np.asarray(sign * size * np.sin(0.5 * alpha_h) ** powers[0] * np.cos(0.5 * alpha_h) ** powers[1])
