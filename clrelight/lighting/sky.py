"""Skies of the CIE: luminance over the hemisphere from the sun's position and the luminance of the zenith.

All are a gradation from zenith to horizon times an indicatrix, a scattering function of the angle from the sun. The sun
itself is not in them. Azimuth runs from x towards y; z is up, and nothing comes from below the horizon.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.index import coefficient_count, degrees_of_coefficients
from clrelight.lighting.lamps import WHITE, checked_colour
from clrelight.lighting.light import Light, turn_about_z

Curve = Callable[[NDArray[np.float64]], NDArray[np.float64]]

# CIE S 011/E:2003, table 1: a, b of the gradation and c, d, e of the indicatrix of types 1 to 15.
_GENERAL = (
    (4.0, -0.70, 0.0, -1.0, 0.0),
    (4.0, -0.70, 2.0, -1.5, 0.15),
    (1.1, -0.80, 0.0, -1.0, 0.0),
    (1.1, -0.80, 2.0, -1.5, 0.15),
    (0.0, -1.00, 0.0, -1.0, 0.0),
    (0.0, -1.00, 2.0, -1.5, 0.15),
    (0.0, -1.00, 5.0, -2.5, 0.30),
    (0.0, -1.00, 10.0, -3.0, 0.45),
    (-1.0, -0.55, 2.0, -1.5, 0.15),
    (-1.0, -0.55, 5.0, -2.5, 0.30),
    (-1.0, -0.55, 10.0, -3.0, 0.45),
    (-1.0, -0.32, 10.0, -3.0, 0.45),
    (-1.0, -0.32, 16.0, -3.0, 0.30),
    (-1.0, -0.15, 16.0, -3.0, 0.30),
    (-1.0, -0.15, 24.0, -2.8, 0.15),
)

SKIES = ("overcast", "clear", "partly-cloudy", *(str(number) for number in range(1, len(_GENERAL) + 1)))
"""Names of the three skies of spherical-harmonic-lighting, and the types of the CIE standard general sky."""

# Gauss points per side beyond those that the degree needs: errors are then below 1e-11.
_NODES = 96
_NODES_AT_ONCE = 4096


@dataclass(frozen=True)
class _Sky:
    gradation: Curve  # of z = cos of the zenith angle
    indicatrix: Curve  # of the angle from the sun


def sky_luminance(
    directions_i3: NDArray[np.float64], sky: str, sun_elevation: float, sun_azimuth: float = 0.0
) -> NDArray[np.float64]:
    """Return the luminance relative to the zenith's at unit directions, (n,) float64; 0 below the horizon.

    Zenith angle θ, angle γ from the sun, zenith angle S of the sun:

    * overcast (Moon and Spencer; CIE 1955): ``(1 + 2 cos θ) / 3``
    * clear (Kittler; CIE): ``f(γ) φ(θ) / (f(S) φ(0))``, ``f(γ) = 0.91 + 10 exp(-3 γ) + 0.45 cos² γ``,
      ``φ(θ) = 1 - exp(-0.32 / cos θ)``
    * partly cloudy: the same with ``f(γ) = 0.526 + 5 exp(-1.5 γ)``, ``φ(θ) = 1 - exp(-0.80 / cos θ)``
    * 1 to 15 (CIE S 011): ``f(γ) = 1 + c (exp(d γ) - exp(d π / 2)) + e cos² γ``, ``φ(θ) = 1 + a exp(b / cos θ)``

    Parameters
    ----------
    directions_i3 : ndarray, shape (n, 3), float64
    sky : str
        One of `SKIES`.
    sun_elevation : float
        Degrees above the horizon, 0 to 90. The overcast sky is the same for all.
    sun_azimuth : float
        Degrees from x towards y.
    """
    model = _checked_sky(sky, sun_elevation, sun_azimuth)
    elevation, azimuth = np.radians(sun_elevation), np.radians(sun_azimuth)
    across = np.cos(elevation)
    sun_3 = np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])
    # Twice the angle whose tangent is |s - sun| / |s + sun|: exact near the sun too, where the cosine is flat.
    apart_i = np.linalg.norm(directions_i3 - sun_3, axis=1)
    angle_i = 2.0 * np.arctan2(apart_i, np.linalg.norm(directions_i3 + sun_3, axis=1))
    return _relative(model, directions_i3[:, 2], angle_i, elevation)


def sky_light(
    sky: str,
    sun_elevation: float = 90.0,
    sun_azimuth: float = 0.0,
    *,
    zenith: float = 1.0,
    degree: int = 6,
    colour: Sequence[float] = WHITE,
) -> Light:
    """Return a sky as a light, in the units of `zenith`.

    Quadrature in polar coordinates about the sun, where the indicatrix has its peak, over the part of each circle that
    is above the horizon.

    Parameters
    ----------
    sky, sun_elevation, sun_azimuth
        See `sky_luminance`.
    zenith : float
        Luminance of the zenith, in kcd/m²; that is what the light's radiance is then in.
    degree : int
        0 to `harmonics.basis.MAX_DEGREE`.
    colour : sequence of 1 or 3 floats
        Factor of each channel, not negative.

    Raises
    ------
    InputError
        If there is no such sky, the sun is below the horizon or beyond the zenith, or the zenith's luminance is not
        above 0.
    """
    model = _checked_sky(sky, sun_elevation, sun_azimuth)
    if not 0.0 < zenith < np.inf:
        raise InputError(f"the luminance of the zenith must be above 0 kcd/m², got {zenith:g}")
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    shades_c = checked_colour(colour)
    elevation = float(np.radians(sun_elevation))
    nodes_i3, angle_i, weight_i = _sun_nodes(elevation, _NODES + degree)
    value_i = weight_i * _relative(model, nodes_i3[:, 2], angle_i, elevation)
    coeffs_k = np.zeros(coefficient_count(degree))
    for start in range(0, len(value_i), _NODES_AT_ONCE):
        part = slice(start, start + _NODES_AT_ONCE)
        coeffs_k += evaluate_basis(nodes_i3[part], degree).T @ value_i[part]
    # The nodes are one side of the sky, whose mirror image in y is the other.
    l = degrees_of_coefficients(degree)
    coeffs_k[np.arange(len(coeffs_k)) < l * (l + 1)] = 0.0
    config = {"sky": sky, "sun": [sun_elevation, sun_azimuth], "zenith": zenith, "colour": [*colour]}
    made = Light(2.0 * zenith * coeffs_k[:, None] * shades_c, f"CIE sky, {sky}", "", config)
    return replace(turn_about_z(made, float(np.radians(sun_azimuth))), config=config)


def _relative(
    model: _Sky, z_i: NDArray[np.float64], angle_i: NDArray[np.float64], elevation: float
) -> NDArray[np.float64]:
    up_i = np.maximum(z_i, np.finfo(np.float64).tiny)
    zenith = model.gradation(np.ones(1)) * model.indicatrix(np.array([0.5 * np.pi - elevation]))
    return np.where(z_i > 0.0, model.gradation(up_i) * model.indicatrix(angle_i) / zenith, 0.0)


def _sun_nodes(elevation: float, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return directions (n, 3), angles (n,) from the sun and weights (n,), for the half y > 0 above the horizon.

    The sun is at azimuth 0.

    ``s = cos γ sun + sin γ (cos ψ up + sin ψ y)`` is above the horizon where ``cos ψ > -tan(elevation) / tan γ``: for
    all ψ up to γ = elevation, for none beyond π - elevation. At both the bound of ψ goes like a square root, which a
    cosine in place of γ makes smooth.
    """
    node_q, weight_q = np.polynomial.legendre.leggauss(count)
    turn_q, turn_weight_q = 0.5 * np.pi * (node_q + 1.0), 0.5 * np.pi * weight_q
    gammas, gamma_weights = [], []
    for low, high in ((0.0, elevation), (elevation, np.pi - elevation)):
        if high <= low:  # the sun at the horizon, or at the zenith
            continue
        gammas.append(low + (high - low) * 0.5 * (1.0 - np.cos(turn_q)))
        gamma_weights.append((high - low) * 0.5 * np.sin(turn_q) * turn_weight_q)
    gamma_g, gamma_weight_g = np.concatenate(gammas), np.concatenate(gamma_weights)
    bound_g = np.arccos(np.clip(-np.sin(elevation) * np.cos(gamma_g) / (np.cos(elevation) * np.sin(gamma_g)), -1, 1))
    psi_gq = 0.5 * bound_g[:, None] * (node_q + 1.0)
    weight_gq = 0.5 * bound_g[:, None] * weight_q * (np.sin(gamma_g) * gamma_weight_g)[:, None]
    cosine_g, sine_g = np.cos(gamma_g)[:, None], np.sin(gamma_g)[:, None]
    up_gq, side_gq = sine_g * np.cos(psi_gq), sine_g * np.sin(psi_gq)
    x_gq = cosine_g * np.cos(elevation) - up_gq * np.sin(elevation)
    z_gq = cosine_g * np.sin(elevation) + up_gq * np.cos(elevation)
    nodes_i3 = np.stack([x_gq, side_gq, z_gq], axis=2).reshape(-1, 3)
    return nodes_i3, np.repeat(gamma_g, count), weight_gq.ravel()


def _checked_sky(sky: str, sun_elevation: float, sun_azimuth: float) -> _Sky:
    if sky not in SKIES:
        raise InputError(f"sky must be one of {', '.join(SKIES)}, got {sky!r}")
    if sun_elevation < 0.0:
        raise InputError(f"the sun is below the horizon: its elevation must be 0 to 90 degrees, got {sun_elevation:g}")
    if not sun_elevation <= 90.0 or not np.isfinite(sun_azimuth):
        raise InputError(
            f"the sun needs an elevation of 0 to 90 degrees and a finite azimuth, got {sun_elevation:g},{sun_azimuth:g}"
        )
    if sky == "overcast":
        return _Sky(lambda z: (1.0 + 2.0 * z) / 3.0, np.ones_like)
    if sky == "clear":
        return _Sky(lambda z: -np.expm1(-0.32 / z), lambda g: 0.91 + 10.0 * np.exp(-3.0 * g) + 0.45 * np.cos(g) ** 2)
    if sky == "partly-cloudy":
        return _Sky(lambda z: -np.expm1(-0.80 / z), lambda g: 0.526 + 5.0 * np.exp(-1.5 * g))
    a, b, c, d, e = _GENERAL[int(sky) - 1]
    return _Sky(
        lambda z: 1.0 + a * np.exp(b / z),
        lambda g: 1.0 + c * (np.exp(d * g) - np.exp(0.5 * np.pi * d)) + e * np.cos(g) ** 2,
    )
