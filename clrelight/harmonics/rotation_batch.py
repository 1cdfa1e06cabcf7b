"""Functions under many rotations at once, as each vertex of a surface sees them in its own frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.index import band, degree_of
from clrelight.harmonics.rotations import quarter_turns, zyz_angles
from clrelight.threads import on_one_thread

_CACHED_BYTES = 1 << 19
"""Of coefficients that go through all turns together: they stay in the processor's cache."""


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
    return rotate_each(np.broadcast_to(coeffs_kc, (len(matrices_n33), *coeffs_kc.shape)), matrices_n33)


def rotate_each(coeffs_nkc: NDArray[np.floating], matrices_n33: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of many functions, each after a rotation of its own, (n, n_coeff, channel) float64.

    As `rotate_many`, but `coeffs_nkc` are of as many functions as there are rotations.
    """
    made_nkc = np.empty(coeffs_nkc.shape)
    step = max(1, _CACHED_BYTES // max(8 * coeffs_nkc[:1].size, 1))
    with on_one_thread():  # many small products, for whose threads BLAS would wait
        for at in range(0, len(made_nkc), step):
            part = slice(at, at + step)
            made_nkc[part] = _rotate(coeffs_nkc[part], np.asarray(matrices_n33[part], np.float64))
    return made_nkc


def _rotate(coeffs_nkc: NDArray[np.floating], turn: NDArray[np.float64]) -> NDArray[np.float64]:
    degree = degree_of(coeffs_nkc.shape[1])
    alpha_n, beta_n, gamma_n = zyz_angles(turn)
    turned_kcn = _about_z(np.moveaxis(coeffs_nkc, 0, 2), gamma_n, degree)
    turned_kcn = _about_z(_about_x(turned_kcn, degree, back=False), beta_n, degree)
    return np.moveaxis(_about_z(_about_x(turned_kcn, degree, back=True), alpha_n, degree), 2, 0)


def _about_x(coeffs_kcn: NDArray[np.float64], degree: int, *, back: bool) -> NDArray[np.float64]:
    """Return functions turned by 90 degrees about x, or back."""
    turned_kcn = np.empty_like(coeffs_kcn)
    for l, block in enumerate(quarter_turns(degree)):
        own = coeffs_kcn[band(l)]
        turn = block.T if back else block
        turned_kcn[band(l)] = (turn @ own.reshape(len(own), -1)).reshape(own.shape)
    return turned_kcn


def _about_z(coeffs_kcn: NDArray[np.floating], angle_n: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return functions turned about z, each by its own angle."""
    order_k = np.concatenate([np.arange(-l, l + 1) for l in range(degree + 1)])
    opposite_k = np.arange(len(order_k)) - 2 * order_k
    angle_mn = np.arange(degree + 1)[:, None] * angle_n
    cosine_k1n = np.cos(angle_mn)[np.abs(order_k), None]
    sine_k1n = (np.sign(order_k)[:, None] * np.sin(angle_mn)[np.abs(order_k)])[:, None]
    return cosine_k1n * coeffs_kcn - sine_k1n * coeffs_kcn[opposite_k]
