"""Lights made without a map: distant lamps, round areas of the sky, shadows of round things, blends of samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.product import multiply_functions
from clrelight.harmonics.zonal import cap_kernel, turn_lobe
from clrelight.lighting.light import Light

WHITE = (1.0,)
BLEND_POWER = 10.0
"""Exponent of the distance in blends (spherical-harmonic-lighting, its example of local lights)."""


def directional_light(direction: Sequence[float], degree: int, colour: Sequence[float] = WHITE) -> Light:
    """Return one distant lamp, ``L = colour delta(s - d)``: a surface that faces it receives the irradiance `colour`.

    Parameters
    ----------
    direction : sequence of 3 floats
        Towards the lamp, of any length but 0.
    degree : int
        0 to `harmonics.basis.MAX_DEGREE`.
    colour : sequence of 1 or 3 floats
        Irradiance, not negative.
    """
    d_3, shades_c = _unit(direction, degree), checked_colour(colour)
    coeffs_kc = evaluate_basis(d_3[None], degree)[0][:, None] * shades_c
    return Light(coeffs_kc, "directional light", "", {"directional": [float(v) for v in d_3], "colour": [*colour]})


def cap_light(direction: Sequence[float], angle: float, degree: int, colour: Sequence[float] = WHITE) -> Light:
    """Return a round light: radiance `colour` within `angle` (degrees) of a direction, 0 elsewhere; exact.

    Raises
    ------
    InputError
        If the direction has no length, or the angle is not above 0 and at most 180 degrees.
    """
    d_3, shades_c = _unit(direction, degree), checked_colour(colour)
    coeffs_kc = turn_lobe(cap_kernel(np.radians(angle), degree), d_3)[:, None] * shades_c
    return Light(coeffs_kc, "spherical cap", "", {"cap": [*(float(v) for v in d_3), angle], "colour": [*colour]})


def cap_visibility(direction: Sequence[float], angle: float, degree: int) -> NDArray[np.float64]:
    """Return the coefficients of 0 within `angle` (degrees) of a direction, 1 elsewhere, ((degree + 1)**2,) float64."""
    # The opposite cap, which has the rest of the sphere. The whole sphere leaves none.
    if angle == 180.0:
        return np.zeros(coefficient_count(degree))
    return turn_lobe(cap_kernel(np.radians(180.0 - angle), degree), -_unit(direction, degree))


def cast_shadow(light: Light, direction: Sequence[float], angle: float) -> Light:
    """Return the light without what comes from within `angle` (degrees) of a direction: the shadow of a round thing.

    The coefficients of the product of the band-limited light and the visibility, of the light's degree, exact: of the
    visibility twice the degree has an effect (spherical-harmonic-lighting, section Creating Light Sources).
    """
    if not 0.0 < angle <= 180.0:
        raise InputError(f"the angle of a shadow must be above 0 and at most 180 degrees, got {angle:g}")
    if light.degree > MAX_DEGREE // 2:
        raise InputError(f"a shadow needs a light of degree {MAX_DEGREE // 2} or less, got {light.degree}")
    _unit(direction, light.degree)
    visible_k = cap_visibility(direction, angle, 2 * light.degree)
    shadows = [*light.config.get("shadows", []), [*(float(v) for v in direction), angle]]
    coeffs_kc = multiply_functions(light.coeffs_kc, visible_k[:, None])
    return replace(light, coeffs_kc=coeffs_kc, config={**light.config, "shadows": shadows})


def blend_lights(
    lights: Sequence[Light], positions_i3: NDArray[np.float64], place_3: NDArray[np.float64], power: float = BLEND_POWER
) -> Light:
    """Return the light at a place between samples of it, each weighted by ``1 / distance**power``; weights sum to 1.

    At a sample's own position it is that sample. Degrees that a sample lacks are 0, a gray one goes with coloured ones.

    Parameters
    ----------
    lights : sequence of Light, n of them
    positions_i3 : ndarray, shape (n, 3), float64
        Where they were sampled, all different.
    place_3 : ndarray, shape (3,), float64
    power : float
        Above 0; large ones approach the nearest sample.
    """
    positions_i3, place_3 = np.asarray(positions_i3, np.float64), np.asarray(place_3, np.float64)
    if not lights or positions_i3.shape != (len(lights), 3) or place_3.shape != (3,):
        raise InputError("a blend needs one or more lights, with one position of three numbers each")
    if not (np.isfinite(positions_i3).all() and np.isfinite(place_3).all()):
        raise InputError("positions of a blend must be finite numbers")
    if not 0.0 < power < np.inf:
        raise InputError(f"the power of a blend must be a finite number above 0, got {power:g}")
    if len(np.unique(positions_i3, axis=0)) < len(lights):
        raise InputError("two lights of a blend have the same position")
    weight_i = distance_weights(positions_i3, place_3[None], power)[0]
    channels = max(light.channels for light in lights)
    coeffs_kc = np.zeros((coefficient_count(max(light.degree for light in lights)), channels))
    for weight, light in zip(weight_i, lights, strict=True):
        coeffs_kc[: len(light.coeffs_kc)] += weight * light.coeffs_kc
    source = "blend of " + ", ".join(light.source or "a light" for light in lights)
    axes = {light.axes for light in lights}
    return Light(coeffs_kc, source, axes.pop() if len(axes) == 1 else "", {"blend": weight_i.tolist(), "power": power})


def distance_weights(
    positions_i3: NDArray[np.float64], points_n3: NDArray[np.float64], power: float = BLEND_POWER
) -> NDArray[np.float64]:
    """Return the shares ``1 / distance**power`` of samples at points, (n_point, n_sample) float64; rows sum to 1."""
    distance_ni = np.linalg.norm(points_n3[:, None] - positions_i3, axis=2)
    nearest_n1 = distance_ni.min(axis=1, keepdims=True)
    # Relative to the nearest, so that no power overflows; where that is 0, it alone counts.
    away_ni = np.where(distance_ni > 0.0, distance_ni, 1.0)
    weight_ni = np.where(nearest_n1 > 0.0, (nearest_n1 / away_ni) ** power, distance_ni == 0.0)
    return weight_ni / weight_ni.sum(axis=1, keepdims=True)


def _unit(direction: Sequence[float] | NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    d_3 = np.asarray(direction, dtype=np.float64)
    if d_3.shape != (3,) or not np.isfinite(d_3).all() or not d_3.any():
        raise InputError(f"a direction is three finite numbers that are not all zero, got {d_3}")
    d_3 = d_3 / np.abs(d_3).max()
    return d_3 / np.linalg.norm(d_3)


def checked_colour(colour: Sequence[float]) -> NDArray[np.float64]:
    """Return the channels of a colour, (1 or 3,) float64; InputError if it is none."""
    shades_c = np.asarray(colour, dtype=np.float64)
    if shades_c.shape not in ((1,), (3,)) or not np.isfinite(shades_c).all() or (shades_c < 0).any():
        raise InputError(f"a colour is 1 or 3 finite numbers that are not negative, got {', '.join(map(str, colour))}")
    return shades_c
