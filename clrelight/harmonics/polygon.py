"""Spherical polygons, whose edges are great circles, projected on the basis exactly."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count, coefficient_index, degrees_of_coefficients
from clrelight.harmonics.rotation_batch import rotate_many

_MORE_NODES = 8
"""Gauss's rule over an arc, which is shorter than half a circle, has so many nodes more than the degree."""
_POLYGONS_AT_ONCE = 1 << 13


def polygon_coefficients(corners_nj3: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return ``integral y_lm(s) ds`` over many spherical polygons, (n, n_coeff) float64.

    Positive where corners go round counterclockwise seen from outside the sphere, which is clockwise seen from its
    middle. As the Laplacian of y_lm is ``-l (l + 1) y_lm``, the integral over an area is one along its edge (Gauss):
    ``-1 / (l (l + 1)) sum_edges integral nu . grad y_lm dt``, nu the outward normal of the edge's plane, which is
    constant along it. What is integrated is a trigonometric polynomial of degree l - 1 in the arc: Gauss's rule is
    exact to rounding.

    Parameters
    ----------
    corners_nj3 : ndarray, shape (n, 3 or more, 3), float64
        Vectors towards the corners, of any length but 0.
    degree : int
    """
    starts = range(0, len(corners_nj3), _POLYGONS_AT_ONCE)
    parts = [_project(corners_nj3[at : at + _POLYGONS_AT_ONCE], degree) for at in starts]
    return np.concatenate(parts) if parts else np.zeros((0, coefficient_count(degree)))


def _project(corners_nj3: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    unit_nj3 = corners_nj3 / np.linalg.norm(corners_nj3, axis=2, keepdims=True)
    next_nj3 = np.roll(unit_nj3, -1, axis=1)
    coeffs_nk = np.zeros((len(unit_nj3), coefficient_count(degree)))
    coeffs_nk[:, 0] = np.sqrt(0.25 / np.pi) * solid_angles(unit_nj3)
    if degree == 0:
        return coeffs_nk
    node_q, weight_q = np.polynomial.legendre.leggauss(degree + _MORE_NODES)
    factors_k = np.zeros(coefficient_count(degree))
    l_k = degrees_of_coefficients(degree)[1:]
    factors_k[1:] = -1.0 / (l_k * (l_k + 1.0))
    gradient_akk = solid_gradients(degree)
    for start_n3, end_n3 in zip(unit_nj3.swapaxes(0, 1), next_nj3.swapaxes(0, 1), strict=True):
        cross_n3 = np.cross(start_n3, end_n3)
        sine_n = np.linalg.norm(cross_n3, axis=1)
        arc_n = np.arctan2(sine_n, np.einsum("na,na->n", start_n3, end_n3))
        normal_n3 = cross_n3 / np.where(sine_n > 0.0, sine_n, 1.0)[:, None]
        ahead_n3 = np.cross(normal_n3, start_n3)
        angle_nq = 0.5 * arc_n[:, None] * (node_q + 1.0)
        along_nq3 = (
            np.cos(angle_nq)[..., None] * start_n3[:, None] + np.sin(angle_nq)[..., None] * ahead_n3[:, None]
        ).reshape(-1, 3)
        basis_nqk = evaluate_basis(along_nq3, degree - 1).reshape(*angle_nq.shape, -1)
        line_nk = np.einsum("nqk,q->nk", basis_nqk, weight_q) * (0.5 * arc_n[:, None])
        for axis in range(3):
            # Counterclockwise from outside, the area lies on the side of the normal: outward is against it.
            coeffs_nk -= factors_k * ((normal_n3[:, axis : axis + 1] * line_nk) @ gradient_akk[axis])
    return coeffs_nk


def solid_angles(unit_nj3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the solid angles of spherical polygons, signed as `polygon_coefficients` says (van Oosterom, Strackee)."""
    total_n = np.zeros(len(unit_nj3))
    first_n3 = unit_nj3[:, 0]
    for j in range(1, unit_nj3.shape[1] - 1):
        second_n3, third_n3 = unit_nj3[:, j], unit_nj3[:, j + 1]
        volume_n = np.einsum("na,na->n", first_n3, np.cross(second_n3, third_n3))
        cosines_n = (
            1.0
            + np.einsum("na,na->n", first_n3, second_n3)
            + np.einsum("na,na->n", second_n3, third_n3)
            + np.einsum("na,na->n", third_n3, first_n3)
        )
        total_n += 2.0 * np.arctan2(volume_n, cosines_n)
    return total_n


@functools.lru_cache(maxsize=4)
def solid_gradients(degree: int) -> NDArray[np.float64]:
    """Return G, (3, degree**2, (degree + 1)**2) float64: ``d/dx_a (r^l y_k) = sum_j r^(l-1) y_j G[a, j, k]``.

    Along z, ``d/dz (r^l y_lm) = sqrt((2 l + 1) / (2 l - 1) (l^2 - m^2)) r^(l-1) y_(l-1)m``; the other axes by turns
    that take them there.
    """
    along_z = np.zeros((coefficient_count(degree - 1), coefficient_count(degree)))
    for l in range(1, degree + 1):
        for m in range(1 - l, l):
            factor = np.sqrt((2.0 * l + 1.0) / (2.0 * l - 1.0) * (l * l - m * m))
            along_z[coefficient_index(l - 1, m), coefficient_index(l, m)] = factor
    # Axes in a circle: x, y and z of the first turn go to z.
    turns_a33 = np.array([[[0, 1, 0], [0, 0, 1], [1, 0, 0]], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], np.eye(3)], np.float64)
    gradients = []
    for turn_33 in turns_a33:
        to_z_kk = _turn_matrix(turn_33, degree)
        back_jj = _turn_matrix(turn_33, degree - 1).T
        gradients.append(back_jj @ along_z @ to_z_kk)
    return np.stack(gradients)


def _turn_matrix(turn_33: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    return rotate_many(np.eye(coefficient_count(degree)), turn_33[None])[0]
