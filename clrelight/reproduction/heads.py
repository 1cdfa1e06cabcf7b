"""Photographs of synthetic heads under light that no subject was seen in: skies at random, and a few lamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.rotation import rotation_matrix
from clrelight.lighting.sky import sky_luminance
from datasets_synth.heads import Head, photograph_head

NOISE = 0.01
SKIES = ("overcast", "partly-cloudy", "clear")


def photograph(
    head: Head, shade_ip: NDArray[np.float32], radiance_ic: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return a head under light, exposed so that its brightest is 1, with noise."""
    picture_hwc = photograph_head(head, shade_ip, radiance_ic)
    picture_hwc /= max(float(np.quantile(picture_hwc, 0.999)), 1e-9)
    return np.clip(picture_hwc + NOISE * rng.standard_normal(picture_hwc.shape).astype(np.float32), 0.0, 1.0)


def turned(rng: np.random.Generator, directions_i3: NDArray[np.float64], about: str = "any") -> NDArray[np.float64]:
    """Return directions in the frame of light that is turned: any way, or about the upright axis y alone."""
    if about == "any":
        angles = (
            rng.uniform(-180.0, 180.0),
            float(np.degrees(np.arccos(rng.uniform(-1.0, 1.0)))),
            rng.uniform(-180, 180),
        )
        return directions_i3 @ rotation_matrix("euler", angles)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    return directions_i3 @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def sky_light_at(rng: np.random.Generator, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a sky over a ground of a fifth of the zenith; y of the picture is up, the head turned about it."""
    x_i, y_i, z_i = turned(rng, directions_i3, "y").T
    up_i3 = np.stack([x_i, -z_i, y_i], axis=1)
    value_i = np.full(len(directions_i3), 0.2)
    above = up_i3[:, 2] > 0.0
    sky = SKIES[rng.integers(len(SKIES))]
    value_i[above] = sky_luminance(up_i3[above], sky, rng.uniform(10.0, 80.0))
    return value_i[:, None] * rng.uniform(0.7, 1.0, 3)


def lamps_at(rng: np.random.Generator, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return one to five lamps in front, each over a tenth of a steradian or so, with a dim room."""
    radiance_ic = np.full((len(directions_i3), 3), 0.02)
    for _ in range(rng.integers(1, 6)):
        towards_3 = rng.standard_normal(3)
        towards_3[2] = abs(towards_3[2])
        cosine_i = directions_i3 @ (towards_3 / np.linalg.norm(towards_3))
        radiance_ic += rng.uniform(0.3, 1.0, 3) * np.exp(80.0 * (cosine_i[:, None] - 1.0))
    return radiance_ic
