"""Hemispherical bases in polar form: polynomials of z that are orthogonal on 0 .. 1, times sines and cosines.

All families are ``f_lm(s) = c_m p(z) Re or Im (g(z) (x + i y))^|m|`` with a polynomial p of degree ``l - |m|`` that is
orthonormal under ``(g^2 (1 - z^2))^|m|``, times z where the basis is orthonormal under the cosine.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.harmonics.index import coefficient_count, coefficient_index

BELOW = -1e-6
"""A direction with a smaller z is below the horizon: as of `clrelight.fit.plan.HORIZON`."""


@dataclass(frozen=True)
class Family:
    """What tells one family from another.

    Attributes
    ----------
    powers : tuple of int
        a and b of ``g^2 = z^a (1 + z)^b``.
    cosine : bool
        Whether functions are orthonormal under the cosine of the angle to the zenith.
    alternates : bool
        Whether function (l, m) has the sign ``(-1)^(l - |m|)`` beside that of a polynomial with a positive first
        coefficient: so Zernike's are 1 at the rim.
    """

    powers: tuple[int, int]
    cosine: bool = False
    alternates: bool = False

    def stretch(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return g^2."""
        a, b = self.powers
        return z**a * (1.0 + z) ** b


def evaluate_family(family: Family, directions_i3: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Evaluate all functions up to a degree at unit directions; 0 below the horizon.

    Parameters
    ----------
    family : Family
    directions_i3 : ndarray, shape (n, 3)
    degree : int
        0 to `MAX_DEGREE`.

    Returns
    -------
    ndarray, shape (n, (degree + 1)**2), float64
    """
    if not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    directions = np.asarray(directions_i3, np.float64)
    if directions.ndim != 2 or directions.shape[1] != 3:
        raise ValueError(f"directions must have shape (n_light, 3), got {directions.shape}")
    z = np.clip(directions[:, 2], 0.0, 1.0)
    azimuth = (directions[:, 0] + 1j * directions[:, 1]) * np.sqrt(family.stretch(z))
    basis_ik = np.empty((len(directions), coefficient_count(degree)))
    turn = np.ones_like(azimuth)
    for m in range(degree + 1):
        if m > 0:
            turn = turn * azimuth
        scale = np.sqrt(0.5 / np.pi) if m == 0 else np.sqrt(1.0 / np.pi)
        for l, polynomial in enumerate(_polynomials(family, m, degree, z), m):
            sign = -1.0 if family.alternates and (l - m) % 2 else 1.0
            basis_ik[:, coefficient_index(l, m)] = sign * scale * polynomial * turn.real
            if m > 0:
                basis_ik[:, coefficient_index(l, -m)] = sign * scale * polynomial * turn.imag
    basis_ik[directions[:, 2] < BELOW] = 0.0
    return basis_ik


def _polynomials(family: Family, m: int, degree: int, z: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the orthonormal polynomials of degrees 0 .. degree - m at z, by their recurrence."""
    first, along, beside = _recurrence(family, m, degree)
    before, polynomial = np.zeros_like(z), np.full_like(z, first)
    found = [polynomial]
    for j in range(degree - m):
        step = (z - along[j]) * polynomial - (beside[j] * before if j else 0.0)
        before, polynomial = polynomial, step / beside[j + 1]
        found.append(polynomial)
    return found


@functools.lru_cache(maxsize=512)
def _recurrence(family: Family, m: int, degree: int) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Return p_0, and a_j, b_j of ``b_(j+1) p_(j+1) = (z - a_j) p_j - b_j p_(j-1)``, by Stieltjes' procedure.

    The weight is a polynomial of z of degree 2 m + 1 at most, for which Gauss's rule is exact (Gautschi 2004,
    Orthogonal polynomials: computation and approximation, section 2.2).
    """
    node, share = np.polynomial.legendre.leggauss(2 * degree + 4)
    z = 0.5 * (node + 1.0)
    weight = 0.5 * share * (family.stretch(z) * (1.0 - z * z)) ** m * (z if family.cosine else 1.0)
    count = degree - m
    along, beside = np.zeros(count + 1), np.zeros(count + 1)
    first = 1.0 / np.sqrt(weight.sum())
    before, polynomial = np.zeros_like(z), np.full_like(z, first)
    for j in range(count):
        along[j] = (weight * z * polynomial**2).sum()
        step = (z - along[j]) * polynomial - beside[j] * before
        beside[j + 1] = np.sqrt((weight * step**2).sum())
        before, polynomial = polynomial, step / beside[j + 1]
    return float(first), along, beside


def polar_rule(degree: int, other: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return directions and solid angles, see `Basis.rule`.

    Between two families half powers of z and 1 + z are left; with ``z = t^2`` the former are none, and the latter have
    their branch points far from 0 .. 1: Gauss's rule in t then converges like ``4.6^(-2 n)``.
    """
    wide = max(degree, other)
    node, share = np.polynomial.legendre.leggauss(2 * wide + 20)
    t = 0.5 * (node + 1.0)
    n_azimuth = degree + wide + 1
    z, azimuth = np.meshgrid(t * t, 2.0 * np.pi * np.arange(n_azimuth) / n_azimuth, indexing="ij")
    radius = np.sqrt(1.0 - z * z)
    directions_i3 = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1).reshape(-1, 3)
    return directions_i3, np.repeat(share * t * (2.0 * np.pi / n_azimuth), n_azimuth)
