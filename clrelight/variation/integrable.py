"""Which of the surfaces that photographs allow is one: what integrability leaves of the ambiguities of `unknown`.

With ``s_k = a_k . q`` for the components q of a pixel, ``d/dy (s_1 / s_3) = d/dx (s_2 / s_3)`` is
``(a_1 ^ a_3) . (q_y ^ q) = (a_2 ^ a_3) . (q_x ^ q)``, linear in two bivectors, which follow as the singular vector of
the smallest singular value over all pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

_LEAST_PIXELS = 50
_TINY = 1e-30


@dataclass(frozen=True)
class Integrated:
    """Rows that make albedo and scaled normals of what is known up to an ambiguity.

    Attributes
    ----------
    rows_44 : ndarray, shape (4, 4), float64
        For ``rho (1, n)``, or its root, as what is known is of either.
    gap : float
        Smallest singular value of the equations over the next: near 0 the surface is told, near 1 it is not.
    """

    rows_44: NDArray[np.float64]
    gap: float


def curl_equations(scaled_4hw: NDArray[np.floating], inside_hw: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return products of the equations of integrability in two bivectors of four components, (12, 12).

    Parameters
    ----------
    scaled_4hw : ndarray, shape (4, height, width)
    inside_hw : ndarray, shape (height, width), bool

    Raises
    ------
    InputError
        If fewer than 50 pixels have all four neighbours.
    """
    middle_hw = inside_hw[1:-1, 1:-1] & inside_hw[1:-1, :-2] & inside_hw[1:-1, 2:]
    middle_hw &= inside_hw[:-2, 1:-1] & inside_hw[2:, 1:-1]
    if np.count_nonzero(middle_hw) < _LEAST_PIXELS:
        raise InputError(
            f"{np.count_nonzero(middle_hw)} pixels have all four neighbours, expected at least {_LEAST_PIXELS}: "
            "the surface cannot be told"
        )
    first_e, second_e = np.triu_indices(4, 1)
    total = np.zeros((2 * len(first_e), 2 * len(first_e)))
    for row in range(middle_hw.shape[0]):
        at_w = np.flatnonzero(middle_hw[row]) + 1
        band_khw = np.asarray(scaled_4hw[:, row : row + 3], np.float64)
        # Ratios alone matter: without the albedo, its edges are none of slopes.
        band_khw = band_khw / np.maximum(np.linalg.norm(band_khw, axis=0), _TINY)
        value_kp = band_khw[:, 1, at_w]
        right_kp = 0.5 * (band_khw[:, 1, at_w + 1] - band_khw[:, 1, at_w - 1])
        up_kp = 0.5 * (band_khw[:, 0, at_w] - band_khw[:, 2, at_w])
        sides = []
        for slope_kp, sign in ((up_kp, 1.0), (right_kp, -1.0)):
            wedge_ep = slope_kp[first_e] * value_kp[second_e] - slope_kp[second_e] * value_kp[first_e]
            sides.append(sign * wedge_ep)
        equations = np.concatenate(sides)
        total += equations @ equations.T
    return total


def resolve_lorentz(scaled_4hw: NDArray[np.floating], inside_hw: NDArray[np.bool_]) -> Integrated:
    """Return the rows of the Lorentz transformation, up to scale, that makes a surface; z towards the camera."""
    total = curl_equations(scaled_4hw, inside_hw)
    value_e, vector_ee = np.linalg.eigh(total)
    by_x_44, by_y_44 = (_bivector(half) for half in np.split(vector_ee[:, 0], 2))
    # a_1 ^ a_3 and a_2 ^ a_3 are of rank 2: their planes share a_3.
    first_42, second_42 = (np.linalg.svd(each)[0][:, :2] for each in (by_x_44, by_y_44))
    left_22, _, right_22 = np.linalg.svd(first_42.T @ second_42)
    shared_4 = first_42 @ left_22[:, 0] + second_42 @ right_22[0]
    metric_4 = np.array([1.0, -1.0, -1.0, -1.0])
    length = float(-np.sum(metric_4 * shared_4**2))
    if not length > 0.0:
        raise InputError("integrability does not tell this surface: the photographs are not those of degree 1")
    third_4 = shared_4 / np.sqrt(length)
    # Rows are at right angles in the metric: (a_k ^ a_3) with a_3's dual gives a_k back.
    first_4 = by_x_44 @ (metric_4 * third_4)
    second_4 = by_y_44 @ (metric_4 * third_4)
    spatial_43 = _orthonormal(np.stack([first_4, second_4, third_4], axis=1), metric_4)
    # The row of the albedo is at right angles to the others.
    zero_4 = metric_4 * np.linalg.svd(spatial_43.T)[2][-1]
    zero_4 = zero_4 / np.sqrt(max(float(np.sum(metric_4 * zero_4**2)), _TINY))
    rows_44 = np.concatenate([zero_4[None], spatial_43.T])
    return Integrated(_oriented(rows_44, scaled_4hw, inside_hw), _gap(value_e))


def _gap(value_e: NDArray[np.float64]) -> float:
    return float(np.sqrt(max(value_e[0], 0.0) / max(value_e[1], _TINY)))


def _bivector(half_e: NDArray[np.float64]) -> NDArray[np.float64]:
    found_44 = np.zeros((4, 4))
    found_44[np.triu_indices(4, 1)] = half_e
    return found_44 - found_44.T


def _orthonormal(spatial_43: NDArray[np.float64], metric_4: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the nearest three vectors of length -1 at right angles in the metric."""
    scale = np.sqrt(np.prod([np.sqrt(max(float(-np.sum(metric_4 * spatial_43[:, k] ** 2)), _TINY)) for k in (0, 1)]))
    spatial_43 = spatial_43 / np.array([scale, scale, 1.0])
    for _ in range(20):
        gram_33 = -(spatial_43.T * metric_4) @ spatial_43
        value_r, axes_3r = np.linalg.eigh(gram_33)
        if value_r[0] <= 0.0:
            raise InputError("integrability does not tell this surface: the photographs are not those of degree 1")
        spatial_43 = spatial_43 @ (axes_3r / np.sqrt(value_r)) @ axes_3r.T
    return spatial_43


def _oriented(
    rows_44: NDArray[np.float64], scaled_4hw: NDArray[np.floating], inside_hw: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return rows with albedo above 0, normals towards the camera, and the convex one of the two surfaces."""
    row_p, column_p = np.nonzero(inside_hw)
    stride = max(1, len(row_p) // 200_000)
    row_p, column_p = row_p[::stride], column_p[::stride]
    made_4p = rows_44 @ np.asarray(scaled_4hw[:, row_p, column_p], np.float64)
    signs_4 = np.ones(4)
    signs_4[0] = -1.0 if np.median(made_4p[0]) < 0.0 else 1.0
    signs_4[3] = -1.0 if np.median(made_4p[3]) < 0.0 else 1.0
    # What is known up to a factor below 0 of all rows has slopes the other way round, as signs of z have.
    x_p, y_p = column_p - column_p.mean(), row_p.mean() - row_p
    outwards = float(np.sum(made_4p[1] * x_p + made_4p[2] * y_p))
    signs_4[1:3] = -1.0 if outwards < 0.0 else 1.0
    return rows_44 * signs_4[:, None]
