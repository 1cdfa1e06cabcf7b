"""How pictures of one view vary with light: principal components from normals alone, and from photographs.

illumination-variation, section 0.3.3, and Ramamoorthi 2002: under all distant lights a convex matte surface shows
``B_p = sum_lm A^_l L_lm Y_lm(n_p)``. Where every L_lm is as likely, the components of the pictures are the left
singular vectors of ``diag(sqrt w) Y diag(A^)``, and their variances the squares of its singular values.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degrees_of_coefficients
from clrelight.lighting.irradiance import cosine_coefficients

DEGREE = 2
"""Of the half-cosine: the nine terms, which hold 99.2% of its energy."""
_BLOCK = 1 << 16


@dataclass(frozen=True)
class Subspace:
    """Principal components of pictures.

    Attributes
    ----------
    variance_r : ndarray, shape (R,), float64
        Share of each component, descending; the sum is 1.
    components_rd : ndarray, shape (R, D), float64
        The components in what they were found from: harmonics (analytic), or pictures (empirical).
    """

    variance_r: NDArray[np.float64]
    components_rd: NDArray[np.float64]

    def cumulative(self, count: int) -> float:
        """Return the share of the first components together."""
        return float(self.variance_r[:count].sum())


def kernel_energy(degree: int) -> NDArray[np.float64]:
    """Return the share of the half-cosine's energy in each degree 0 to `degree`, (degree + 1,).

    ``A_l^2 / integral_0^(pi/2) 2 pi cos^2 sin = A_l^2 / (2 pi / 3)`` by Parseval (illumination-variation, eq. 28).
    """
    degrees_l = np.arange(degree + 1)
    zonal_l = cosine_coefficients(degree) * np.sqrt((2.0 * degrees_l + 1.0) / (4.0 * np.pi))
    return zonal_l**2 / (2.0 * np.pi / 3.0)


def energy_bound(degree: int) -> float:
    """Return the least share of irradiance's energy in degrees 0 to `degree`, under light that is nowhere negative.

    Of such light no degree has more energy a function than degree 0 has. So at worst all degrees in between are empty,
    and those beyond as full as degree 0: ``e_0 / (e_0 + e_beyond)`` (Basri and Jacobs 2003, 3.2).
    """
    energy_l = kernel_energy(degree)
    return float(energy_l[0] / (energy_l[0] + 1.0 - energy_l.sum()))


def analytic_subspace(
    normals_p3: NDArray[np.floating],
    weights_p: NDArray[np.floating] | None = None,
    *,
    degree: int = DEGREE,
    centred: bool = True,
) -> Subspace:
    """Return the principal components of all pictures of a convex matte surface under all distant lights.

    Parameters
    ----------
    normals_p3 : ndarray, shape (P, 3)
        Unit normals of the pixels, in the axes of the lights.
    weights_p : ndarray, shape (P,), optional
        Weight of each pixel's squared error, such as its squared albedo, or the area that a vertex shows; default 1.
    degree : int
        Of the harmonics.
    centred : bool
        Whether the mean over all lights is taken off, which is degree 0: then it is left out.
    """
    factor_k = half_cosine_factors(degree)
    basis_energy = np.zeros((len(factor_k), len(factor_k)))
    for start in range(0, len(normals_p3), _BLOCK):
        part = slice(start, start + _BLOCK)
        basis_pk = evaluate_basis(np.asarray(normals_p3[part], np.float64), degree) * factor_k
        weighted_pk = basis_pk if weights_p is None else basis_pk * np.asarray(weights_p[part], np.float64)[:, None]
        basis_energy += weighted_pk.T @ basis_pk
    if centred:
        basis_energy[0] = 0.0
        basis_energy[:, 0] = 0.0
    return _subspace(basis_energy, "the normals")


def half_cosine_factors(degree: int) -> NDArray[np.float64]:
    """Return ``A^_l = sqrt(4 pi / (2 l + 1)) A_l`` of every coefficient: pi, 2 pi / 3, pi / 4, 0, ...

    By illumination-variation, eq. 24, 28.
    """
    return cosine_coefficients(degree)[degrees_of_coefficients(degree)]


def empirical_subspace(blocks: Iterable[NDArray[np.floating]], *, centred: bool = True) -> Subspace:
    """Return the principal components of pictures, from the moments of their pixels.

    Parameters
    ----------
    blocks : iterable of ndarray, shape (n_light, P)
        The pictures' pixels, block after block; pixels that do not count are left out. The (n_light, n_light) matrix of
        products is all that is kept of them.
    centred : bool
        Whether the mean picture is taken off.
    """
    moments_ij: NDArray[np.float64] | None = None
    for block_ip in blocks:
        products_ij = np.asarray(block_ip, np.float64) @ np.asarray(block_ip, np.float64).T
        moments_ij = products_ij if moments_ij is None else moments_ij + products_ij
    if moments_ij is None:
        raise InputError("there are no pictures to find components of")
    if centred:
        moments_ij = moments_ij - moments_ij.mean(axis=0) - moments_ij.mean(axis=1)[:, None] + moments_ij.mean()
    return _subspace(moments_ij, "the pictures")


def _subspace(moments_dd: NDArray[np.float64], what: str) -> Subspace:
    variance_r, components_dr = np.linalg.eigh(moments_dd)
    variance_r = np.maximum(variance_r[::-1], 0.0)
    if not variance_r.sum() > 0.0:
        raise InputError(f"{what} do not vary: there are no components")
    return Subspace(variance_r / variance_r.sum(), np.ascontiguousarray(components_dr[:, ::-1].T))
