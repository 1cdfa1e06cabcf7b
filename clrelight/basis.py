"""The real spherical-harmonic basis, and the singular value decomposition that every fit shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import coefficient_count, coefficient_index

MAX_DEGREE = 100
"""Largest degree whose accuracy is tested."""


def evaluate_basis(directions_i3: NDArray, degree: int) -> NDArray[np.float64]:
    """Evaluate all basis functions up to a degree at unit directions, in float64.

    With ``Y_lm = Q_l|m|(z) Re or Im (x + i y)^|m|`` no angle is ever formed, so the pole is no special case. The
    polynomials Q are the fully normalised associated Legendre functions without their ``sin^m``, by the recurrence
    of Holmes and Featherstone (2002), eq. 11, which is stable upwards in l.

    Parameters
    ----------
    directions_i3 : ndarray, shape (n_light, 3)
        Unit vectors.
    degree : int
        Largest degree, 0 to `MAX_DEGREE`.

    Returns
    -------
    ndarray, shape (n_light, (degree + 1)**2), float64
        Orthonormal on the full sphere, no Condon-Shortley sign, column ``k = l (l + 1) + m``.
    """
    if not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    directions = np.asarray(directions_i3, dtype=np.float64)
    if directions.ndim != 2 or directions.shape[1] != 3:
        raise ValueError(f"directions must have shape (n_light, 3), got {directions.shape}")
    z = directions[:, 2]
    azimuth = directions[:, 0] + 1j * directions[:, 1]
    basis_ik = np.empty((len(directions), coefficient_count(degree)))
    sectoral = np.full(len(directions), np.sqrt(0.25 / np.pi))
    turn = np.ones_like(azimuth)
    for m in range(degree + 1):
        if m > 0:
            sectoral = sectoral * np.sqrt((2 * m + 1) / (2 * m))
            turn = turn * azimuth
        before, polynomial = np.zeros_like(z), sectoral
        for l in range(m, degree + 1):
            if l > m:
                a = np.sqrt((4.0 * l * l - 1.0) / (l * l - m * m))
                b = np.sqrt(((l - 1.0) ** 2 - m * m) / (4.0 * (l - 1.0) ** 2 - 1.0))
                before, polynomial = polynomial, a * (z * polynomial - b * before)
            if m == 0:
                basis_ik[:, coefficient_index(l, 0)] = polynomial
            else:
                basis_ik[:, coefficient_index(l, m)] = np.sqrt(2.0) * polynomial * turn.real
                basis_ik[:, coefficient_index(l, -m)] = np.sqrt(2.0) * polynomial * turn.imag
    return basis_ik


@dataclass(frozen=True)
class Decomposition:
    """Thin singular value decomposition ``basis = left diag(singular) right.T``, float64.

    Attributes
    ----------
    left_ir : ndarray, shape (n_light, rank)
    singular_r : ndarray, shape (rank,)
        Descending, all positive.
    right_kr : ndarray, shape (n_coeff, rank)
    """

    left_ir: NDArray[np.float64]
    singular_r: NDArray[np.float64]
    right_kr: NDArray[np.float64]

    @property
    def condition(self) -> float:
        """Largest over smallest singular value."""
        return float(self.singular_r[0] / self.singular_r[-1])


def decompose(basis_ik: NDArray[np.float64]) -> Decomposition:
    """Return the thin SVD of the basis matrix, without the components that float64 cannot tell from zero.

    The paper decomposes ``A = Y^T Y`` (eq. 12); its condition is the square of this one's, which float64 cannot
    hold from degree 10 on a hemisphere, so A is never formed.
    """
    left, singular, right = np.linalg.svd(basis_ik, full_matrices=False)
    # Fix the signs, which LAPACK leaves open, so that files do not depend on its version.
    signs = np.where(right[np.arange(len(right)), np.argmax(np.abs(right), axis=1)] < 0, -1.0, 1.0)
    held = singular > singular[0] * max(basis_ik.shape) * np.finfo(np.float64).eps
    return Decomposition((left * signs)[:, held], singular[held], (right * signs[:, None]).T[:, held])
