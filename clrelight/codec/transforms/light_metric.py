"""What errors cost where a stack's lights tell what images look like, and where a fit makes it up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import basis_of
from clrelight.codec.transforms.metric import Metric
from clrelight.harmonics.index import degree_of
from clrelight.harmonics.quadrature import product_rule

_WIDTH = 2.0
"""Of a light's surroundings, in distances between lights: gaps between lights cost what lights do."""
_ELSEWHERE = 0.02
"""Part of a cost that errors have wherever lights are not, as in the mean over the hemisphere."""
_LEAST_NODES = 16
_AT_ONCE = 1 << 9
"""Lights whose surroundings are summed together."""


def light_weights(
    nodes_n3: NDArray[np.float64], weight_n: NDArray[np.float64], lights_i3: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Return what errors at directions cost, most near lights, of the same sum as their solid angles.

    It is ``weight (0.98 rho + 0.02)``, rho the density of lights, each blurred to twice their distance (von
    Mises-Fisher), of mean 1. So lights in a cap take the bits of what a fit makes up outside of it, and gaps between
    lights cost what lights do.

    Parameters
    ----------
    nodes_n3 : ndarray, shape (n_node, 3), float64
        Unit vectors that share the hemisphere among them.
    weight_n : ndarray, shape (n_node,), float64
        Solid angles in steradian.
    lights_i3 : ndarray, shape (n_light, 3), float64, or None
        Unit vectors, of which those at z < 0 do not count. Of None, or of one direction, nothing is known.

    Returns
    -------
    ndarray, shape (n_node,), float64
        `weight_n` itself where nothing is known.
    """
    above_i3 = np.zeros((0, 3)) if lights_i3 is None else lights_i3[lights_i3[:, 2] >= 0.0]
    different_u3 = np.unique(above_i3, axis=0)
    if len(different_u3) < 2:
        return weight_n
    from scipy.spatial import cKDTree

    chord_u = cKDTree(different_u3).query(different_u3, k=2)[0][:, 1]
    # No narrower than nodes lie, which see what functions of the degree can tell apart.
    width = max(_WIDTH * float(np.median(chord_u)), 2.0 * float(np.sqrt(weight_n.max())))
    density_n = np.zeros(len(nodes_n3))
    for first in range(0, len(above_i3), _AT_ONCE):
        some_i3 = above_i3[first : first + _AT_ONCE]
        # What would lie below the horizon is mirrored at it: even lights have the same density everywhere.
        near_ni = sum(np.exp((nodes_n3 @ (some_i3 * [1.0, 1.0, side]).T - 1.0) / width**2) for side in (1.0, -1.0))
        density_n += (near_ni / (weight_n @ near_ni)).sum(axis=1)
    density_n *= weight_n.sum() / len(above_i3)
    return weight_n * ((1.0 - _ELSEWHERE) * density_n + _ELSEWHERE)


def light_root(metric: Metric, basis: str, lights_i3: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Return the root R of what errors e of whitened coordinates cost under lights, ``|R e|^2``.

    ``R' R = integral w (F^-1 y) (F^-1 y)'``, F the metric's `forward_jk` and w the `light_weights`, of which the part
    that is the same everywhere is exact.

    Parameters
    ----------
    metric : Metric
        In which all the hemisphere costs alike.
    basis : str
        What coefficients are of (`clrelight.bases`).
    lights_i3 : ndarray, shape (n_light, 3), float64, or None

    Returns
    -------
    ndarray, shape (n_component, n_component), float64
        Upper triangular; the identity where nothing is known of lights.
    """
    degree, n_component = degree_of(metric.forward_jk.shape[1]), len(metric.forward_jk)
    nodes_n3, weight_n = product_rule(max(degree + 2, _LEAST_NODES))
    cost_n = light_weights(nodes_n3, weight_n, lights_i3)
    if cost_n is weight_n:
        return np.eye(n_component)
    shown_nj = basis_of(basis).evaluate(nodes_n3, degree) @ metric.inverse_kj
    cost_jj = (shown_nj * (cost_n - _ELSEWHERE * weight_n)[:, None]).T @ shown_nj
    return np.asarray(np.linalg.cholesky(cost_jj + _ELSEWHERE * np.eye(n_component)).T, np.float64)
