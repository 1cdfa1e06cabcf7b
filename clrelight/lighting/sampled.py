"""Light from functions of a direction by Monte Carlo, with standard errors; products of lights."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.harmonics.montecarlo import project_function
from clrelight.harmonics.product import multiply_functions
from clrelight.lighting.environment import Environment
from clrelight.lighting.layouts import parse_axes, texel_geometry
from clrelight.lighting.light import Light

REPEATS = 8
"""Independent estimates, whose spread is the standard error of their mean."""

DirectionFunction = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def sample_light(
    function: DirectionFunction, degree: int, samples: int, *, seed: int = 0, source: str = "", axes: str = ""
) -> tuple[Light, NDArray[np.float64]]:
    """Return a function's light by Monte Carlo integration, and the standard error of each coefficient.

    The mean of `REPEATS` independent projections on stratified directions (spherical-harmonic-lighting, eq. 5): their
    spread shows the error, which one stratified set does not tell.

    Parameters
    ----------
    function : callable
        From unit vectors (n, 3) to values (n, 1 or 3).
    degree : int
    samples : int
        Evaluations in all, at least `REPEATS`; rounded up to `REPEATS` squares.
    seed : int
    source, axes : str
        What the light says it was made of, and where x, y and z point there.

    Returns
    -------
    Light
    error_kc : ndarray, shape (n_coeff, channel), float64
    """
    if samples < REPEATS:
        raise InputError(f"a projection needs at least {REPEATS} samples, got {samples}")
    if seed < 0:
        raise InputError(f"seed must be at least 0, got {seed}")
    side = math.ceil(math.sqrt(samples / REPEATS) - 1e-9)
    estimates_rkc = np.stack(
        [project_function(function, degree, side * side, seed=seed * REPEATS + i) for i in range(REPEATS)]
    )
    config = {"method": "monte carlo", "samples": REPEATS * side * side, "seed": seed}
    light = Light(estimates_rkc.mean(axis=0), source=source, axes=axes, config=config)
    return light, estimates_rkc.std(axis=0, ddof=1) / math.sqrt(REPEATS)


def look_up(environment: Environment) -> DirectionFunction:
    """Return an environment map as a function of directions: the radiance of the texel that is nearest."""
    from scipy.spatial import cKDTree

    height, width = environment.radiance_hwc.shape[:2]
    view_t3, weights_t = texel_geometry(environment.layout, height, width)
    shown_t = np.flatnonzero(weights_t > 0.0)
    tree = cKDTree(view_t3[shown_t])
    radiance_tc = environment.radiance_hwc.reshape(height * width, -1)
    into_view_33 = parse_axes(environment.axes)[1]

    def radiance(directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        _, nearest_i = tree.query(directions_i3 @ into_view_33)
        return radiance_tc[shown_t[nearest_i]].astype(np.float64)

    return radiance


def multiply_lights(first: Light, second: Light, degree: int | None = None) -> Light:
    """Return the product of two functions on the sphere, such as light and visibility; one channel goes with three.

    Parameters
    ----------
    first, second : Light
    degree : int, optional
        Of the product; default: the larger of both. All of it has the sum of both degrees.
    """
    wanted = max(first.degree, second.degree) if degree is None else degree
    if not 0 <= wanted <= MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {wanted}")
    with np.errstate(over="ignore", invalid="ignore"):  # a light refuses what is not finite
        product_kc = multiply_functions(first.coeffs_kc, second.coeffs_kc, wanted)
    source = " times ".join(each.source or "a light" for each in (first, second))
    same = first.axes if first.axes == second.axes else first.axes or second.axes
    config = {"method": "product", "degrees": [first.degree, second.degree]}
    return Light(product_kc, source=source, axes=same, config=config)
