"""The bases that fits and codecs take, in the order of tables."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from clrelight.bases.haar import evaluate_haar, level_of, level_roughness
from clrelight.bases.octahedral import cell_nodes
from clrelight.bases.polar import Family, evaluate_family, polar_rule
from clrelight.bases.registry import SH, Basis, Rule, register
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degrees_of_coefficients
from clrelight.harmonics.quadrature import product_rule

EPSILON = 1e-2
"""Penalty of the mean, which the Laplace-Beltrami operator does not see; at 1e-4 or 1 no figure changes."""

HSH = Family((1, -1))
GRAM_SCHMIDT = Family((0, 0))
ZERNIKE = Family((0, -1), alternates=True)
MAKHOTKIN = Family((1, -1), cosine=True)

_CELL_PARTS = 64
"""Parts along a side of the square at least, by which means of harmonics over Haar's cells are taken."""


def polar_roughness(degree: int) -> NDArray[np.float64]:
    """Return ``EPSILON + (l (l + 1))^2``, (n_coeff,): of harmonics the energy of the Laplacian over the sphere."""
    l_k = degrees_of_coefficients(degree)
    return EPSILON + (l_k * (l_k + 1.0)) ** 2


def gram_schmidt_to_sh(degree: int) -> NDArray[np.float64]:
    """Return the matrix (n_coeff, n_coeff) that makes spherical-harmonic coefficients of Gram-Schmidt ones.

    Both span the same functions: ``(x + i y)^m`` times polynomials of z of degree ``l - m``. Its condition is that of
    harmonics on a hemisphere, which grows tenfold or more with two degrees.
    """
    directions_i3, weight_i = product_rule(degree)
    harmonics_ik = evaluate_basis(directions_i3, degree) * weight_i[:, None]
    # With g = T' y for its functions, their integrals with y are A T, and T' A T is the identity.
    return np.asarray(np.linalg.inv(evaluate_family(GRAM_SCHMIDT, directions_i3, degree).T @ harmonics_ik))


def _product_rule(degree: int, other: int) -> Rule:
    return product_rule(max(degree, other))


@functools.lru_cache(maxsize=4)
def _haar_rule(degree: int, other: int) -> Rule:
    side = 1 << level_of(degree)
    pairs = max(_CELL_PARTS, 4 * (other + 1)) // side + 1
    directions_i3 = cell_nodes(side, pairs).reshape(-1, 3)
    return directions_i3, np.full(len(directions_i3), 2.0 * np.pi / len(directions_i3))


def _haar_nodes(degree: int) -> Rule:
    directions_i3 = cell_nodes(1 << level_of(degree), 0).reshape(-1, 3)
    return directions_i3, np.full(len(directions_i3), 2.0 * np.pi / len(directions_i3))


def _haar_check(degree: int) -> None:
    level_of(degree)


register(
    Basis(
        SH,
        "Spherical harmonics",
        "spherical harmonics: of the whole sphere, turned and convolved exactly",
        evaluate_basis,
        _product_rule,
        product_rule,
        polar_roughness,
        hemispherical=False,
        weight="sphere",
    )
)
register(
    Basis(
        "hsh",
        "HSH",
        "hemispherical harmonics: shifted associated Legendre polynomials (Gautron et al. 2004)",
        functools.partial(evaluate_family, HSH),
        polar_rule,
        product_rule,
        polar_roughness,
    )
)
register(
    Basis(
        "gram-schmidt",
        "Gram-Schmidt SH",
        "spherical harmonics made orthonormal over the hemisphere; become spherical harmonics again exactly",
        functools.partial(evaluate_family, GRAM_SCHMIDT),
        _product_rule,
        product_rule,
        polar_roughness,
        to_sh=gram_schmidt_to_sh,
    )
)
register(
    Basis(
        "zernike",
        "Zernike",
        "Zernike polynomials under the equal-area map of the hemisphere to a disc (Koenderink and van Doorn 1998)",
        functools.partial(evaluate_family, ZERNIKE),
        polar_rule,
        product_rule,
        polar_roughness,
    )
)
register(
    Basis(
        "makhotkin",
        "Makhotkin",
        "hemispherical harmonics by adjoint Jacobi polynomials, orthonormal under the cosine (after Makhotkin 1996)",
        functools.partial(evaluate_family, MAKHOTKIN),
        polar_rule,
        product_rule,
        polar_roughness,
        weight="cosine",
    )
)
register(
    Basis(
        "haar",
        "Haar",
        "Haar wavelets on an equal-area octahedral square of the hemisphere (Ng et al. 2004): degrees 0, 1, 3, 7, 15",
        evaluate_haar,
        _haar_rule,
        _haar_nodes,
        level_roughness,
        check=_haar_check,
    )
)
