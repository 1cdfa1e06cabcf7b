"""Light on the upper hemisphere only, where fits of image stacks know something."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.basis import legendre_tables
from clrelight.harmonics.index import coefficient_count, degree_of, indices_of


@functools.lru_cache(maxsize=4)
def _blocks(degree: int, other: int) -> tuple[NDArray[np.float64], ...]:
    """Return, for each m, ``integral_(z > 0) y_lm y_l'm`` over l = m .. degree and l' = m .. other.

    Products of different orders integrate to 0 over azimuth, and the order -m has the integrals of m. What is left is
    a polynomial in z of degree l + l', for which Gauss's rule on 0 .. 1 is exact.
    """
    highest = max(degree, other)
    node_q, weight_q = np.polynomial.legendre.leggauss(highest + 1)
    tables = legendre_tables(np.arccos(0.5 * (node_q + 1.0)), highest)
    blocks = []
    for m in range(min(degree, other) + 1):
        azimuth = 2.0 * np.pi if m == 0 else np.pi  # of cos^2; the tables hold y_lm at azimuth 0
        rows, columns = tables[m][: degree + 1 - m], tables[m][: other + 1 - m]
        blocks.append((azimuth * 0.5) * (rows * weight_q) @ columns.T)
    return tuple(blocks)


def hemisphere_autocorrelation(degree: int, other: int | None = None) -> NDArray[np.float64]:
    """Return A = ``integral_(z > 0) y y^T ds`` (noise-resistant-fitting, eq. 4), (n_coeff, n_coeff of `other`) float64.

    ``c^T A l`` is then the integral over the hemisphere of the product of two functions with coefficients c and l. The
    diagonal is 1/2; different degrees of the same parity do not mix.

    Parameters
    ----------
    degree : int
        Of the rows.
    other : int, optional
        Of the columns; the same by default.
    """
    wide = degree if other is None else other
    matrix = np.zeros((coefficient_count(degree), coefficient_count(wide)))
    for m, block in enumerate(_blocks(degree, wide)):
        row, column = np.arange(m, degree + 1), np.arange(m, wide + 1)
        for order in {m, -m}:
            matrix[np.ix_(indices_of(row, order), indices_of(column, order))] = block
    return matrix


def project_onto_hemisphere(light_kc: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return ``A l`` for coefficients up to `degree`, ((degree + 1)**2, channel) float64.

    By noise-resistant-fitting, eq. 5.

    The light may be of any degree: what of it lies beyond `degree` still counts where the hemisphere mixes degrees.
    """
    wide = degree_of(len(light_kc))
    seen_kc = np.zeros((coefficient_count(degree), light_kc.shape[1]))
    for m, block in enumerate(_blocks(degree, wide)):
        row, column = np.arange(m, degree + 1), np.arange(m, wide + 1)
        for order in {m, -m}:
            seen_kc[indices_of(row, order)] = block @ light_kc[indices_of(column, order)]
    return seen_kc
