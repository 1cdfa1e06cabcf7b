"""Which lights to take: what a set of directions makes of the noise in its images, and choosing sets that do better."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import check_directions
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.decomposition import decompose
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.quadrature import product_rule
from clrelight.sampling import PATTERNS, farthest_point_subset, make_pattern

MAX_DEGREE = 15
"""Above it float64 can hardly tell the basis functions apart on a hemisphere (condition 5e10 here, 1e13 at 18)."""

CHOICES = ("farthest", "greedy", "every", "random")
"""Ways to choose some of given lights: well spread, least image noise, every k-th, at random."""
PROPOSALS = (*PATTERNS, *CHOICES[:2])
"""Ways to propose lights where there are none yet."""

_CANDIDATES = 4096
"""Directions that proposals choose from: about 2 degrees apart on a hemisphere."""
_PRIOR = 1e-3
"""Greedy choice begins with this times the identity as information: any light then lowers a finite trace."""


@dataclass(frozen=True)
class LightQuality:
    """What a set of lights makes of noise, by unconstrained least squares.

    Attributes
    ----------
    n_light : int
    condition : float
        Largest over smallest singular value of the basis matrix Y; inf where some combination of the basis functions
        is not seen at all.
    image_noise : float
        Variance of the relit image's noise, in the mean over all lights of the hemisphere (or sphere), for noise of
        variance 1 that is independent in every photograph: ``tr((Y'Y)^-1 G) / area``, where G holds the integrals of
        products of basis functions over the hemisphere.
    coefficient_noise : float
        ``tr((Y'Y)^-1)``: the squared norm of the noise of the coefficients.
    """

    n_light: int
    condition: float
    image_noise: float
    coefficient_noise: float

    def to_config(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return asdict(self)


def assess_lights(directions_i3: NDArray[np.float64], degree: int, *, sphere: bool = False) -> LightQuality:
    """Return what a set of lights makes of noise at a degree; no finite noise where there are too few of them.

    Parameters
    ----------
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors.
    degree : int
        Largest degree, 0 to `MAX_DEGREE`.
    sphere : bool
        Relight from the whole sphere instead of the upper hemisphere.

    Raises
    ------
    InputError
        The directions are no unit vectors, or the degree is out of range.
    """
    check_directions(directions_i3, None)
    n_coeff = coefficient_count(_checked_degree(degree))
    basis_ik = evaluate_basis(directions_i3, degree)
    svd = decompose(basis_ik)
    if len(svd.singular_r) < n_coeff:
        return LightQuality(len(directions_i3), math.inf, math.inf, math.inf)
    # In functions that are orthonormal over the hemisphere G is the identity, and no small number is squared.
    seen_r = np.linalg.svd(basis_ik @ _orthonormalize(degree, sphere), compute_uv=False)
    area = (4.0 if sphere else 2.0) * np.pi
    return LightQuality(
        len(directions_i3), svd.condition, float(np.sum(seen_r**-2.0)) / area, float(np.sum(svd.singular_r**-2.0))
    )


def propose_lights(pattern: str, count: int, degree: int, *, below: bool = False, seed: int = 0) -> NDArray[np.float64]:
    """Return `count` directions of one of `PROPOSALS`, (count, 3) float64 unit vectors.

    ``"farthest"`` and ``"greedy"`` choose from a fine spiral, as `choose_lights` does from given lights; the others are
    those of `clrelight.sampling.make_pattern`. With `below` the whole sphere is covered.

    Raises
    ------
    InputError
        Unknown pattern, a count out of range, or a pattern of the hemisphere with `below`.
    """
    if pattern not in PROPOSALS:
        raise InputError(f"pattern must be one of {', '.join(PROPOSALS)}, got {pattern!r}")
    if pattern in PATTERNS:
        return make_pattern(pattern, count, seed, sphere=below)
    if not 1 <= count <= _CANDIDATES:
        raise InputError(f"{pattern} proposes 1 to {_CANDIDATES} lights, got {count}")
    candidates_j3 = make_pattern("uniform", _CANDIDATES, sphere=below)
    return candidates_j3[choose_lights(pattern, candidates_j3, count, degree, sphere=below)]


def choose_lights(
    choice: str, directions_i3: NDArray[np.float64], count: int, degree: int, *, sphere: bool = False, seed: int = 0
) -> NDArray[np.intp]:
    """Return the indices of `count` of the given lights, chosen in one of the ways `CHOICES`.

    Parameters
    ----------
    choice : str
        ``"farthest"``: see `clrelight.sampling.farthest_point_subset`. ``"greedy"``: always the light that lowers the
        noise of relit images most (A-optimal, one light at a time). ``"every"``: at equal steps of their numbers.
        ``"random"``: without replacement.
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors.
    count : int
        1 to n_light.
    degree : int
        What ``"greedy"`` chooses for.
    sphere : bool
        As in `assess_lights`.
    seed : int
        Of ``"random"``.

    Returns
    -------
    ndarray, shape (count,), intp
        Distinct indices; farthest, greedy and random ones in the order chosen, so that a prefix is a choice too.

    Raises
    ------
    InputError
        Unknown choice, or a count out of range.
    """
    check_directions(directions_i3, None)
    n_light = len(directions_i3)
    if choice not in CHOICES:
        raise InputError(f"lights are chosen by one of {', '.join(CHOICES)}, got {choice!r}")
    if not 1 <= count <= n_light:
        raise InputError(f"can choose 1 to {n_light} lights, got {count}")
    if choice == "farthest":
        return farthest_point_subset(directions_i3, count)
    if choice == "greedy":
        return _choose_greedily(directions_i3, count, degree, sphere)
    if choice == "every":
        return np.arange(count) * n_light // count
    # Only Generator.random is drawn: the one stream that NumPy versions have in common.
    return np.argsort(np.random.default_rng(seed).random(n_light), kind="stable")[:count]


def _choose_greedily(directions_i3: NDArray, count: int, degree: int, sphere: bool) -> NDArray[np.intp]:
    """Take the light with the largest fall of ``tr(M^-1)``, M the information so far: ``|M^-1 z|^2 / (1 + z'M^-1 z)``.

    A light changes M by ``z z'``, so inverse and products with it follow by Sherman and Morrison's formula.
    """
    seen_ik = evaluate_basis(directions_i3, _checked_degree(degree)) @ _orthonormalize(degree, sphere)
    product_ik = seen_ik / _PRIOR
    chosen = np.empty(count, dtype=np.intp)
    free_i = np.ones(len(directions_i3), bool)
    for step in range(count):
        scale_i = 1.0 + np.sum(seen_ik * product_ik, axis=1)
        fall_i = np.where(free_i, np.sum(product_ik**2, axis=1) / scale_i, -1.0)
        light = chosen[step] = np.argmax(fall_i)
        free_i[light] = False
        product_ik -= np.outer(seen_ik @ product_ik[light], product_ik[light] / scale_i[light])
    return chosen


def _orthonormalize(degree: int, sphere: bool) -> NDArray[np.float64]:
    """Return T such that the columns of ``Y T`` are orthonormal over the hemisphere (over the sphere: the identity).

    From the SVD of Y at the nodes of a quadrature that is exact for products of two basis functions: Gauss's in z times
    equal steps of azimuth.
    """
    if sphere:
        return np.eye(coefficient_count(degree))
    nodes_i3, area = product_rule(degree)
    svd = decompose(np.sqrt(area)[:, None] * evaluate_basis(nodes_i3, degree))
    return svd.right_kr / svd.singular_r


def _checked_degree(degree: int) -> int:
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"lights are planned for degree 0 to {MAX_DEGREE}, got {degree}")
    return degree
