"""The light that scenes of surfaces stand in: area lights in a dim room, of high dynamic range, the same everywhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.sampling import make_pattern
from clrelight.transfer.functions import FixedLight
from datasets_synth.shapes import axes_about


@dataclass(frozen=True)
class AreaLight:
    """A distant disc.

    Attributes
    ----------
    azimuth, elevation : float
        Of its middle, in degrees: azimuth from x towards y.
    radius : float
        Its angular radius in degrees.
    radiance : tuple of float
        Linear RGB.
    """

    azimuth: float
    elevation: float
    radius: float
    radiance: tuple[float, float, float]

    @property
    def direction(self) -> NDArray[np.float64]:
        """Unit vector towards its middle."""
        a, e = math.radians(self.azimuth), math.radians(self.elevation)
        return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


STUDIO = (
    AreaLight(-130.0, 42.0, 16.0, (11.0, 9.6, 7.8)),  # warm key, before and to her right
    AreaLight(-20.0, 25.0, 24.0, (1.3, 1.7, 2.4)),  # cool fill
    AreaLight(75.0, 50.0, 12.0, (7.0, 7.2, 8.0)),  # rim, from behind
)
ZENITH, HORIZON, GROUND = (0.34, 0.38, 0.46), (0.16, 0.16, 0.17), (0.06, 0.05, 0.045)
"""Radiance of the room above, at eye level, and below."""


def studio_radiance(directions_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the radiance from unit directions in the axes of the scene, z up; shape (n, 3), linear RGB."""
    height_n1 = directions_n3[:, 2:]
    above = np.array(HORIZON) + np.clip(height_n1, 0.0, 1.0) * (np.array(ZENITH) - np.array(HORIZON))
    below = np.array(HORIZON) + np.clip(-height_n1, 0.0, 1.0) * (np.array(GROUND) - np.array(HORIZON))
    radiance_n3 = np.where(height_n1 > 0.0, above, below)
    for light in STUDIO:
        inside_n = directions_n3 @ light.direction > math.cos(math.radians(light.radius))
        radiance_n3[inside_n] += light.radiance
    return radiance_n3


def studio_lights(per_area: int = 20, room: int = 40) -> FixedLight:
    """Return the studio as distant lights: so many for each area light, and so many for the room without them."""
    directions, irradiance = [], []
    for light in STUDIO:
        cap_m3 = _cap(per_area, math.radians(light.radius)) @ axes_about(light.direction)
        solid_angle = 2.0 * math.pi * (1.0 - math.cos(math.radians(light.radius)))
        directions.append(cap_m3)
        irradiance.append(np.tile(np.array(light.radiance) * solid_angle / per_area, (per_area, 1)))
    around_m3 = make_pattern("uniform", room, sphere=True)
    lit_by_areas_m3 = sum(
        np.outer(around_m3 @ light.direction > math.cos(math.radians(light.radius)), light.radiance) for light in STUDIO
    )
    directions.append(around_m3)
    irradiance.append((studio_radiance(around_m3) - lit_by_areas_m3) * (4.0 * math.pi / room))
    return FixedLight(np.concatenate(directions), np.concatenate(irradiance))


def _cap(count: int, radius: float) -> NDArray[np.float64]:
    """Return a spiral of directions about z that share a cap of this angular radius evenly."""
    z_m = 1.0 - (1.0 - math.cos(radius)) * (np.arange(count) + 0.5) / count
    azimuth_m = np.arange(count) * (math.pi * (3.0 - math.sqrt(5.0)))
    across_m = np.sqrt(1.0 - z_m * z_m)
    return np.stack([across_m * np.cos(azimuth_m), across_m * np.sin(azimuth_m), z_m], axis=1)
