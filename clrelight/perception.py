"""Differences of pictures as an eye sees them: FLIP, and colour differences by CIEDE2000."""

from __future__ import annotations

import importlib.util

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.transforms.colour import to_lab
from clrelight.conventions import linear_to_srgb, srgb_to_linear
from clrelight.errors import InputError

PIXELS_PER_DEGREE = 67.0
"""Of the viewer that FLIP takes for granted: 0.7 m before a display 3840 pixels and 0.7 m wide."""

_TO_POWER_7 = 25.0**7


def check_perception(channel: int) -> None:
    """Raise InputError if pictures of so many channels have no colours, or FLIP is not installed."""
    if channel not in (1, 3):
        raise InputError(f"perceptual figures are for grey or red, green and blue, the images have {channel} channels")
    if importlib.util.find_spec("flip_evaluator") is None:
        raise InputError("perceptual figures need the package flip-evaluator: pip install 'clrelight[flip]'")


def display_of(values_hwc: NDArray, transfer: str) -> NDArray[np.float32]:
    """Return sRGB values (height, width, 3) in [0, 1] of values in units of the peak behind a transfer.

    They are clipped to [0, 1]; linear ones go through the sRGB curve; a single channel becomes three.
    """
    clipped = np.clip(np.asarray(values_hwc, np.float64), 0.0, 1.0)
    shown = clipped if transfer == "srgb" else linear_to_srgb(clipped)
    height, width, _ = shown.shape
    return np.ascontiguousarray(np.broadcast_to(shown, (height, width, 3)), np.float32)


def flip_of(reference_hwc: NDArray[np.float32], test_hwc: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the FLIP (height, width), 0 to 1, of two pictures of sRGB values in [0, 1].

    LDR-FLIP of Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild 2020, by their own program, at
    `PIXELS_PER_DEGREE`.
    """
    import flip_evaluator
    from threadpoolctl import threadpool_limits

    asked = {"ppd": PIXELS_PER_DEGREE}
    # Its threads gain a little on an idle machine, and wait for each other on a busy one: ten times as long.
    with threadpool_limits(1, user_api="openmp"):
        error_hwc, _, _ = flip_evaluator.evaluate(
            reference_hwc, test_hwc, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False, parameters=asked
        )
    return np.asarray(error_hwc)[..., 0]


def colour_difference(reference: NDArray, test: NDArray) -> NDArray[np.float64]:
    """Return CIEDE2000 (...) of sRGB values (..., 3) in [0, 1], at D65."""
    return ciede2000(to_lab(srgb_to_linear(reference)), to_lab(srgb_to_linear(test)))


def ciede2000(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the colour difference of CIELAB colours, both on the last axis (CIE 142-2001; Sharma, Wu, Dalal 2005)."""
    (l1, a1, b1), (l2, a2, b2) = np.moveaxis(one, -1, 0), np.moveaxis(other, -1, 0)
    mean7 = ((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(mean7 / (mean7 + _TO_POWER_7))
    c1, c2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)
    h1, h2 = np.arctan2(b1, stretch * a1) % (2 * np.pi), np.arctan2(b2, stretch * a2) % (2 * np.pi)
    grey = c1 * c2 == 0.0
    turn = np.where(grey, 0.0, (h2 - h1 + np.pi) % (2 * np.pi) - np.pi)
    turn = np.where(turn == -np.pi, np.pi, turn)
    around = np.abs(h1 - h2) > np.pi
    hue = np.where(grey, h1 + h2, (h1 + h2) / 2 + np.where(around, np.where(h1 + h2 < 2 * np.pi, np.pi, -np.pi), 0.0))
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    weight = (
        1.0
        - 0.17 * np.cos(hue - np.radians(30))
        + 0.24 * np.cos(2 * hue)
        + 0.32 * np.cos(3 * hue + np.radians(6))
        - 0.20 * np.cos(4 * hue - np.radians(63))
    )
    scale_l = 1.0 + 0.015 * (lightness - 50) ** 2 / np.sqrt(20 + (lightness - 50) ** 2)
    term_l = (l2 - l1) / scale_l
    term_c = (c2 - c1) / (1.0 + 0.045 * chroma)
    term_h = 2.0 * np.sqrt(c1 * c2) * np.sin(turn / 2) / (1.0 + 0.015 * chroma * weight)
    blue = np.exp(-(((np.degrees(hue) - 275) / 25) ** 2))
    rotation = -2.0 * np.sqrt(chroma**7 / (chroma**7 + _TO_POWER_7)) * np.sin(np.radians(60) * blue)
    return np.sqrt(np.maximum(term_l**2 + term_c**2 + term_h**2 + rotation * term_c * term_h, 0.0))
