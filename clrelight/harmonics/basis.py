"""The real spherical-harmonic basis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.index import coefficient_count, coefficient_index, indices_of

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


def legendre_tables(theta_h: NDArray[np.float64], degree: int) -> list[NDArray[np.float64]]:
    """Return, for m = 0 .. degree, the rows l = m .. degree of ``y_lm(theta, phi = 0)``, each (degree + 1 - m, n)."""
    meridian_h3 = np.stack([np.sin(theta_h), np.zeros_like(theta_h), np.cos(theta_h)], axis=1)
    basis_hk = evaluate_basis(meridian_h3, degree)
    l = np.arange(degree + 1)
    return [np.ascontiguousarray(basis_hk[:, indices_of(l[m:], m)].T) for m in range(degree + 1)]
