"""Products of functions on the sphere, from their coefficients: on a grid, and by the tensor of triple integrals."""

from __future__ import annotations

import functools

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import legendre_tables
from clrelight.harmonics.index import coefficient_count, degree_of, indices_of
from clrelight.harmonics.latlong import project_latlong, synthesize_latlong

MAX_TENSOR_ENTRIES = 1 << 23
"""Most triple integrals that are kept, 130 MB of them; degree 20 with itself has 1.8 million."""

_ROUNDING = 1e-14


def multiply_functions(
    first_kc: NDArray[np.float64], second_kc: NDArray[np.float64], degree: int | None = None
) -> NDArray[np.float64]:
    """Return the coefficients of the product of two functions up to `degree`, exact but for rounding.

    Both are evaluated on a lat-long grid fine enough for the product with every basis function, multiplied there and
    projected: O(d^3) for degrees of d, where the tensor takes O(d^5).

    Parameters
    ----------
    first_kc, second_kc : ndarray, shape (n_coeff, channel), float64
        Of any degrees; one channel goes with all channels of the other.
    degree : int, optional
        Of the result; by default the first function's. The whole product has the sum of both degrees.

    Returns
    -------
    ndarray, shape ((degree + 1)**2, channel), float64
    """
    one, two = degree_of(len(first_kc)), degree_of(len(second_kc))
    wanted = one if degree is None else degree
    height = one + two + wanted + 1
    grid_hwc = synthesize_latlong(first_kc, height, 2 * height) * synthesize_latlong(second_kc, height, 2 * height)
    return project_latlong(grid_hwc, wanted)


def transfer_matrix(function_k: NDArray[np.float64], degree: int, result: int | None = None) -> NDArray[np.float64]:
    """Return the matrix that multiplies by a fixed function (spherical-harmonic-lighting, eq. 8 and 9).

    ``M_ij = integral f y_i y_j ds``, symmetric where `result` is `degree`.

    Parameters
    ----------
    function_k : ndarray, shape (n_coeff,), float64
        The fixed function. What of it lies beyond ``degree + result`` has no effect.
    degree : int
        Of the functions it is applied to.
    result : int, optional
        Of the products; `degree` by default.

    Returns
    -------
    ndarray, shape ((result + 1)**2, (degree + 1)**2), float64
    """
    rows = degree if result is None else result
    fixed = min(degree_of(len(function_k)), degree + rows)
    tensor = gaunt_tensor(rows, degree, fixed)
    return (tensor @ function_k[: coefficient_count(fixed)]).reshape(coefficient_count(rows), coefficient_count(degree))


def integrate_triple(
    first_k: NDArray[np.float64], second_k: NDArray[np.float64], third_k: NDArray[np.float64]
) -> float:
    """Return ``integral f g h ds`` of three functions from their coefficients, each of its own degree."""
    matrix = transfer_matrix(first_k, degree_of(len(third_k)), degree_of(len(second_k)))
    return float(second_k @ matrix @ third_k)


@functools.lru_cache(maxsize=4)
def gaunt_tensor(first: int, second: int, third: int) -> scipy.sparse.csr_array:
    """Return all ``integral y_i y_j y_k ds`` up to three degrees, as a sparse matrix of rows ``i n_j + j``, columns k.

    The integrals over azimuth leave orders with ``|m_k| = |m_i| + |m_j|`` or their difference; in what is left,
    Gauss's rule is exact for the polynomial of degree ``l_i + l_j + l_k``. Degrees that make no triangle, or have an
    odd sum, give 0 and are left out.

    Raises
    ------
    InputError
        If more than `MAX_TENSOR_ENTRIES` integrals would have to be kept.
    """
    degrees = (first, second, third)
    node_q, weight_q = np.polynomial.legendre.leggauss(sum(degrees) // 2 + 1)
    tables = legendre_tables(np.arccos(node_q), max(degrees))
    counts = [coefficient_count(degree) for degree in degrees]
    rows: list[NDArray[np.intp]] = []
    columns: list[NDArray[np.intp]] = []
    values: list[NDArray[np.float64]] = []
    kept = 0
    for m in range(first + 1):
        for n in range(second + 1):
            for o in {m + n, abs(m - n)}:
                if o > third:
                    continue
                integrals, l, lj, lk = _polar_integrals(tables, weight_q, degrees, (m, n, o))
                for signs in _signs(m, n, o):
                    azimuth = _azimuth_integral(*signs)
                    if azimuth == 0.0:
                        continue
                    i, j, k = (indices_of(d, sign) for d, sign in zip((l, lj, lk), signs, strict=True))
                    rows.append(i * counts[1] + j)
                    columns.append(k)
                    values.append(azimuth * integrals)
                    kept += len(integrals)
                if kept > MAX_TENSOR_ENTRIES:
                    raise InputError(
                        f"degrees {first}, {second} and {third} have more than {MAX_TENSOR_ENTRIES} triple integrals: "
                        "multiply on a grid instead (multiply_functions)"
                    )
    shape = (counts[0] * counts[1], counts[2])
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return scipy.sparse.csr_array(entries, shape=shape)


def _polar_integrals(
    tables: list[NDArray[np.float64]], weight_q: NDArray[np.float64], degrees: tuple[int, ...], orders: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the integrals over z of all products of three orders that are not 0, and the degrees of each."""
    a_lq, b_lq, c_lq = (tables[m][: d + 1 - m] for d, m in zip(degrees, orders, strict=True))
    pairs = (a_lq * weight_q)[:, None] * b_lq
    block = pairs @ c_lq.T
    la, lb, lc = (np.indices(block.shape)[axis] + m for axis, m in enumerate(orders))
    # Some are 0 although their degrees and orders allow more.
    there = ((la + lb + lc) % 2 == 0) & (lc >= abs(la - lb)) & (lc <= la + lb) & (abs(block) > _ROUNDING)
    return block[there], la[there], lb[there], lc[there]


def _signs(m: int, n: int, o: int) -> list[tuple[int, int, int]]:
    return [(a, b, c) for a in {m, -m} for b in {n, -n} for c in {o, -o}]


def _azimuth_integral(m: int, n: int, o: int) -> float:
    """Return the integral over azimuth of three functions cos (order >= 0) or sin (order < 0), by equal steps."""
    steps = abs(m) + abs(n) + abs(o) + 1
    phi = 2.0 * np.pi * np.arange(steps) / steps
    product = np.ones(steps)
    for order in (m, n, o):
        product *= np.cos(order * phi) if order >= 0 else np.sin(-order * phi)
    # The integral is a multiple of pi / 2.
    return float(np.round(4.0 * product.mean()) * 0.5 * np.pi)
