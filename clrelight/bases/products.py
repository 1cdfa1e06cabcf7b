"""Integrals over the hemisphere of products of a basis' functions, with each other and with spherical harmonics."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from clrelight.bases.registry import SH, basis_of
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.hemisphere import hemisphere_autocorrelation, project_onto_hemisphere
from clrelight.harmonics.index import degree_of
from clrelight.harmonics.quadrature import product_rule


@functools.lru_cache(maxsize=8)
def gram_matrix(basis_id: str, degree: int) -> NDArray[np.float64]:
    """Return ``G = integral_(z > 0) b b^T ds``, (n_coeff, n_coeff) float64: the metric of errors in images."""
    basis = basis_of(basis_id)
    n_coeff = basis.count(degree)
    if basis.weight == "hemisphere":
        return np.eye(n_coeff)
    if basis_id == SH:
        return hemisphere_autocorrelation(degree)
    # Products of one order are polynomials of z.
    directions_i3, weight_i = product_rule(degree + 1)
    basis_ik = basis.evaluate(directions_i3, degree)
    return np.asarray((basis_ik * weight_i[:, None]).T @ basis_ik)


@functools.lru_cache(maxsize=8)
def harmonics_seen(basis_id: str, degree: int, light_degree: int) -> NDArray[np.float64]:
    """Return ``integral_(z > 0) b y^T ds`` with spherical harmonics, (n_coeff, (light_degree + 1)**2) float64."""
    basis = basis_of(basis_id)
    basis.check(degree)
    directions_i3, weight_i = basis.rule(degree, light_degree)
    weighted_ik = basis.evaluate(directions_i3, degree) * weight_i[:, None]
    return np.asarray(weighted_ik.T @ evaluate_basis(directions_i3, light_degree))


def seen_light(basis_id: str, degree: int, light_kc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the integral over the hemisphere of each function times a light given by harmonics, (n_coeff, channel).

    A view's radiance under the light is ``c^T`` of it. Exact to rounding; of the basis ``haar`` to 2e-4 of the light's
    coefficients.
    """
    if basis_id == SH:
        return project_onto_hemisphere(light_kc, degree)
    return harmonics_seen(basis_id, degree, degree_of(len(light_kc))) @ light_kc
