"""One function under many rotations at once, as each vertex of a surface sees it in its own frame."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.index import band, coefficient_count, degree_of
from clrelight.harmonics.rotation import rotation_blocks

_QUARTER_ABOUT_X = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def rotate_many(coeffs_kc: NDArray[np.float64], matrices_n33: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of one function after each of many rotations, (n, n_coeff, channel) float64.

    Function j of the result says of ``matrices[j] @ d`` what the given one says of d (`rotation.rotation_blocks`).
    ``R = Z(alpha) X(-90) Z(beta) X(90) Z(gamma)`` (spherical-harmonic-lighting, section Rotating Spherical Harmonics):
    turns about z mix orders m and -m alone, and those about x are two matrices for all rotations.

    Parameters
    ----------
    coeffs_kc : ndarray, shape (n_coeff, channel), float64
    matrices_n33 : ndarray, shape (n, 3, 3), float64
        Orthogonal, of determinant 1.
    """
    degree = degree_of(len(coeffs_kc))
    turn = np.asarray(matrices_n33, np.float64)
    # Whatever alpha is where beta is 0 or 180 degrees, gamma makes good for it.
    alpha_n = np.arctan2(turn[:, 1, 2], turn[:, 0, 2])
    cosine_n, sine_n = np.cos(alpha_n), np.sin(alpha_n)
    beta_n = np.arctan2(cosine_n * turn[:, 0, 2] + sine_n * turn[:, 1, 2], turn[:, 2, 2])
    gamma_n = np.arctan2(
        cosine_n * turn[:, 1, 0] - sine_n * turn[:, 0, 0], cosine_n * turn[:, 1, 1] - sine_n * turn[:, 0, 1]
    )
    coeffs_nkc = np.broadcast_to(coeffs_kc, (len(turn), *coeffs_kc.shape))
    quarter = _quarter_turn(degree)
    coeffs_nkc = quarter @ _about_z(coeffs_nkc, gamma_n, degree)
    coeffs_nkc = quarter.T @ _about_z(coeffs_nkc, beta_n, degree)
    return _about_z(coeffs_nkc, alpha_n, degree)


@functools.lru_cache(maxsize=4)
def _quarter_turn(degree: int) -> NDArray[np.float64]:
    """Return the matrix (n_coeff, n_coeff) of the turn by 90 degrees about x."""
    matrix = np.zeros((coefficient_count(degree), coefficient_count(degree)))
    for l, block in enumerate(rotation_blocks(_QUARTER_ABOUT_X, degree)):
        matrix[band(l), band(l)] = block
    return matrix


def _about_z(coeffs_nkc: NDArray[np.float64], angle_n: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return functions turned about z, each by its own angle."""
    order_k = np.concatenate([np.arange(-l, l + 1) for l in range(degree + 1)])
    opposite_k = np.arange(len(order_k)) - 2 * order_k
    angle_nk1 = (angle_n[:, None] * order_k)[..., None]
    return np.cos(angle_nk1) * coeffs_nkc - np.sin(angle_nk1) * coeffs_nkc[:, opposite_k]
