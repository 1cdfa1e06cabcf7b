"""Images of a fitted view under light from everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clrelight.conventions import srgb_to_linear
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.harmonics.hemisphere import project_onto_hemisphere
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light
from clrelight.relight import combine_maps

TONEMAPS = ("clip", "reinhard")
"""How radiance above 1 is shown: clipped, or compressed by ``v / (1 + v)`` (Reinhard et al. 2002, eq. 3)."""

AUTO_PERCENTILE = 99.0
"""Automatic exposure makes this percentile of the brightest channel white."""


def relight_under(coefficients: CoefficientMap, light: Light, *, device: Device | None = None) -> NDArray[np.float32]:
    """Return the view under a light from everywhere, ``image = c^T A l`` (noise-resistant-fitting, eq. 4 and 5).

    What comes from below the horizon is cut: fits of stacks know the upper hemisphere only.

    Returns
    -------
    ndarray, shape (height, width, channel), float32
        Linear radiance in units of the peak, not clipped. A gray view under a coloured light is coloured.
    """
    device = device or open_device()
    seen_kc = project_onto_hemisphere(light.coeffs_kc, coefficients.degree)
    channel = coefficients.image_shape[2]
    images_ahwc = combine_maps(device, seen_kc.T, coefficients)
    if channel == 1 or light.channels == 1:
        return np.concatenate(list(images_ahwc), axis=2) if channel == 1 else images_ahwc[0]
    _check_channels(channel, light.channels)
    return np.stack([images_ahwc[c, ..., c] for c in range(channel)], axis=2)


def gather_light(environment: Environment, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how much light of the upper hemisphere belongs to each direction, (n_light, channel) float64.

    Every texel above the horizon goes to the nearest direction: ``E_i = sum w L`` over the direction's Voronoi cell.
    """
    texel_t3, weights_t = environment.geometry()
    above_t = (texel_t3[:, 2] > 0) & (weights_t > 0)
    nearest_t = cKDTree(directions_i3).query(texel_t3[above_t])[1]
    radiance_tc = environment.radiance_hwc.reshape(-1, environment.channels)[above_t].astype(np.float64)
    weighted_tc = weights_t[above_t, None] * radiance_tc
    return np.stack([np.bincount(nearest_t, column, len(directions_i3)) for column in weighted_tc.T], axis=1)


def sum_photographs(stack: LightStack, light_ic: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of a stack's photographs, each times its light, in linear radiance: what relighting should give.

    Parameters
    ----------
    stack : LightStack
    light_ic : ndarray, shape (n_light, 1 or 3), float64
        From `gather_light`.

    Returns
    -------
    ndarray, shape (height, width, channel), float64
    """
    height, width, channel = stack.image_shape
    if channel > 1 and light_ic.shape[1] > 1:
        _check_channels(channel, light_ic.shape[1])
    image_hwc = np.zeros((height, width, max(channel, light_ic.shape[1])))
    for index, light_c in enumerate(light_ic):
        values_hwc = np.asarray(stack.images_ihwc[index : index + 1])[0] / stack.peak
        image_hwc += light_c * (srgb_to_linear(values_hwc) if stack.transfer == "srgb" else values_hwc)
    return image_hwc


def automatic_exposure(image_hwc: NDArray) -> float:
    """Return the stops that make the `AUTO_PERCENTILE` of an image's brightest channel 1; 0 for a black one."""
    white = float(np.percentile(image_hwc.max(axis=2), AUTO_PERCENTILE))
    return -float(np.log2(white)) if white > 0 else 0.0


def map_tones(image_hwc: NDArray[np.float32], tonemap: str) -> NDArray[np.float32]:
    """Return linear radiance in 0 .. 1 for display, by one of `TONEMAPS`; what is below 0 becomes 0."""
    positive = np.maximum(image_hwc, 0.0, dtype=np.float32)
    if tonemap == "clip":
        return np.minimum(positive, 1.0, dtype=np.float32)
    if tonemap == "reinhard":
        return np.divide(positive, 1.0 + positive, dtype=np.float32)
    raise InputError(f"tone mapping must be one of {', '.join(TONEMAPS)}, got {tonemap!r}")


def _check_channels(view: int, light: int) -> None:
    if view != light:
        raise InputError(f"the view has {view} channels and the light {light}: one of them must be 1, or both the same")
