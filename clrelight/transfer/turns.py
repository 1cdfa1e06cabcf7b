"""Coefficients turned into the frames of many vertices at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import band, coefficient_count
from clrelight.harmonics.quadrature import product_rule


def frame_rotations(frames_v33: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return the matrices that take coefficients in common axes to each frame's.

    ``R_jk = integral y_j(s) y_k(F^T s) ds``, where F has the frame's axes as rows: each degree alone, and exact, since
    the rule integrates products of two functions of its degree.

    Parameters
    ----------
    frames_v33 : ndarray, shape (vertex, 3, 3), float64
        Orthonormal and right-handed; rows are x, y and z of the frame.
    degree : int

    Returns
    -------
    ndarray, shape (vertex, n_coeff, n_coeff), float64
    """
    nodes_q3, weights_q = product_rule(degree, sphere=True)
    here_qk = evaluate_basis(nodes_q3, degree) * weights_q[:, None]
    there_vq3 = np.asarray(nodes_q3 @ frames_v33)
    norm_vq = np.linalg.norm(there_vq3, axis=-1, keepdims=True)
    n_coeff = coefficient_count(degree)
    there_vqk = evaluate_basis((there_vq3 / norm_vq).reshape(-1, 3), degree).reshape(len(frames_v33), -1, n_coeff)
    turns_vkk = np.zeros((len(frames_v33), n_coeff, n_coeff))
    for l in range(degree + 1):
        own = band(l)
        turns_vkk[:, own, own] = here_qk[:, own].T @ there_vqk[:, :, own]
    return turns_vkk
