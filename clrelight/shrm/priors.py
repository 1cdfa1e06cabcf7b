"""What reflectances are like before anything is seen of one: how coefficients of known ones vary together."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.lafortune import SKIN
from clrelight.brdf.radial import Lambert, Mirrored, Phong
from clrelight.shrm.observation import make_terms

_TYPICAL: dict[str, tuple[CentredBrdf, ...]] = {
    "reflection": (
        *(Microfacet(sigma) for sigma in (0.1, 0.2, 0.35, 0.7)),
        *(Phong(exponent) for exponent in (2.0, 8.0, 32.0, 128.0)),
        Mirrored(Lambert()),
        SKIN,
    ),
    "normal": (Lambert(), *(Phong(exponent) for exponent in (2.0, 8.0))),
    "tangent": tuple(KajiyaKay(exponent) for exponent in (2.0, 8.0, 32.0, 128.0)),
}
"""About each central direction; what Phong's lobe is about does not matter to it."""

_OWN, _LEAST = 0.1, 1e-3
"""Parts of each coefficient's own mean square, and of the largest, that vary with no other."""


@functools.lru_cache(maxsize=8)
def typical_root(degree: int, order: int, azimuth: bool, centre: str) -> NDArray[np.float64]:
    """Return T (unknown, unknown) with ``T T^T`` the second moments of typical reflectances of one energy.

    Unknowns ``x = T z`` of equally likely z are then as likely as such reflectances: one view sees a two-dimensional
    part of a four-dimensional light field, and the rest is what goes with it.
    """
    terms = make_terms(degree, order, azimuth=azimuth)
    moments_jj = np.zeros((len(terms), len(terms)))
    for brdf in _TYPICAL[centre]:
        values_jc = terms.unknowns(brdf_coefficients(brdf, degree, order).rho_lpqc)
        moments_jj += values_jc @ values_jc.T / np.sum(values_jc**2)
    own_j = np.diag(moments_jj)
    return np.asarray(np.linalg.cholesky(moments_jj + np.diag(_OWN * own_j + _LEAST * own_j.max())), np.float64)
