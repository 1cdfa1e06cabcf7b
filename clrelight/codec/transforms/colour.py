"""Colours as an eye sees their differences: axes along which errors of images cost alike."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import srgb_to_linear
from clrelight.errors import InputError, counted

RADIANCE, PERCEPTUAL = "radiance", "perceptual"
METRICS = (RADIANCE, PERCEPTUAL)
"""What errors cost: the same in every channel, or what they are in CIELAB."""

# IEC 61966-2-1: linear sRGB to CIE XYZ, and CIE 15: the white point D65.
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_WHITE = _XYZ.sum(axis=1)
_GREY = 0.5
"""Code value around which colours are taken to differ as they do everywhere."""
_STEP = 1e-4


def colour_axes(metric: str, transfer: str) -> NDArray[np.float64] | None:
    """Return axes (3, 3) along which errors behind a transfer cost alike, the largest entry 1; None for all axes."""
    return None if metric == RADIANCE else _lightness_and_chroma(transfer)


def check_metric(metric: str, channel: int) -> None:
    """Raise InputError for images without colours."""
    if metric == PERCEPTUAL and channel != 3:
        raise InputError(f"metric perceptual is for red, green and blue, the images have {counted(channel, 'channel')}")


def to_lab(radiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return CIELAB (lightness, a, b) of linear sRGB radiance, both on the last axis."""
    ratio = np.maximum(radiance @ _XYZ.T, 0.0) / _WHITE
    root = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


@functools.cache
def _lightness_and_chroma(transfer: str) -> NDArray[np.float64]:
    """Return the derivatives of CIELAB at a grey."""
    grey = np.full(3, _GREY if transfer == "srgb" else srgb_to_linear(_GREY))
    shifted = grey + _STEP * np.concatenate([np.eye(3), -np.eye(3)])
    lab = to_lab(srgb_to_linear(shifted) if transfer == "srgb" else shifted)
    derivative_dc = (lab[:3] - lab[3:]).T / (2 * _STEP)
    return derivative_dc / np.abs(derivative_dc).max()
