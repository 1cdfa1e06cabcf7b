"""Images of a fitted view under light from everywhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.bases.products import seen_light
from clrelight.dataset import CoefficientMap
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.lighting.light import Light
from clrelight.relight import combine_maps
from clrelight.surface import surface_facts

TONEMAPS = ("clip", "reinhard")
"""How radiance above 1 is shown: clipped, or compressed by ``v / (1 + v)`` (Reinhard et al. 2002, eq. 3)."""

AUTO_PERCENTILE = 99.0
"""Automatic exposure makes this percentile of the brightest channel white."""


def relight_under(coefficients: CoefficientMap, light: Light, *, device: Device | None = None) -> NDArray[np.float32]:
    """Return the view under a light from everywhere, ``image = c^T A l`` (noise-resistant-fitting, eq. 4 and 5).

    What comes from below the horizon is cut: fits of stacks know the upper hemisphere only. Functions of a surface in
    the axes of its positions know the whole sphere, decoded or a part of them too; InputError of others of a surface.

    Returns
    -------
    ndarray, shape (height, width, channel), float32
        Linear radiance in units of the peak, not clipped. A gray view under a coloured light is coloured.
    """
    device = device or open_device()
    facts = surface_facts(coefficients.surface, coefficients.config)
    if facts is None:
        seen_kc = seen_light(coefficients.basis, coefficients.degree, light.coeffs_kc)
    else:
        seen_kc = _seen_by(facts, light, coefficients.n_coeff)
    channel = coefficients.image_shape[2]
    images_ahwc = combine_maps(device, seen_kc.T, coefficients)
    if channel == 1 or light.channels == 1:
        return np.concatenate(list(images_ahwc), axis=2) if channel == 1 else images_ahwc[0]
    check_channels(channel, light.channels)
    return np.stack([images_ahwc[c, ..., c] for c in range(channel)], axis=2)


def _seen_by(facts: Mapping[str, Any], light: Light, n_coeff: int) -> NDArray[np.float64]:
    if facts.get("frame") == "local":
        raise InputError("these functions are in each vertex's own frame, where a light is another at each vertex")
    if facts.get("argument") == "view":
        raise InputError("these functions are of the direction to the eye, under a light that is fixed")
    seen_kc = np.zeros((n_coeff, light.channels))
    count = min(n_coeff, len(light.coeffs_kc))
    seen_kc[:count] = light.coeffs_kc[:count]
    return seen_kc


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


def check_channels(view: int, light: int) -> None:
    """Raise InputError unless a view and a light have as many channels, or one of them one."""
    if view != light:
        raise InputError(f"the view has {view} channels and the light {light}: one of them must be 1, or both the same")
