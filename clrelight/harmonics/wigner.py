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
    # Where |m| or |q| is l, d is one term: the root of a binomial times powers of the half angle's sine and cosine.
    powers = abs(m - q), abs(m + q)
    size = math.sqrt(math.comb(2 * first, powers[0]))
    sign = -1.0 if (powers[0] % 2 and m > q) != bool((max(m, 0) + max(q, 0)) % 2) else 1.0
    sine_h, cosine_h = np.sin(0.5 * alpha_h), np.cos(0.5 * alpha_h)
    rows_lh[0] = sign * size * sine_h ** powers[0] * cosine_h ** powers[1]
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
