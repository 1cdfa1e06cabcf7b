"""A picture of the spheres that lights were found by, so that people see whether they were."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import linear_to_srgb
from clrelight.jobs.variation.light_doubts import RIVAL
from clrelight.jobs.variation.light_frames import Frames
from clrelight.jobs.variation.sphere_lights import SphereLights

_SIDE = 1600
_OUTLINE, _MARK, _UNSURE = (255, 160, 0), (0, 200, 255), (255, 0, 90)


def draw_spheres(frames: Frames, spheres: Sequence[SphereLights], budget: int) -> NDArray[np.uint8]:
    """Return the brightest of all photographs with outlines, and a cross where each highlight is: 8-bit RGB."""
    height, width = frames.shape_hw
    tight = int(np.ceil(np.sqrt(8.0 * height * width * len(frames.names) / budget)))
    factor = max(1, -(-max(height, width) // _SIDE), tight)
    grey_hw = frames.take((0, 0, width, height), factor).max(axis=0)
    top = float(np.quantile(grey_hw, 0.995)) or 1.0
    codes_hw = np.rint(255.0 * linear_to_srgb(np.clip(grey_hw / top, 0.0, 1.0))).astype(np.uint8)
    picture_hwc = np.repeat(codes_hw[:, :, None], 3, axis=2)
    for sphere in spheres:
        circle = sphere.circle
        angle_n = np.linspace(0.0, 2.0 * np.pi, max(64, int(8 * circle.radius / factor)))
        _put(
            picture_hwc,
            circle.x + circle.radius * np.cos(angle_n),
            circle.y + circle.radius * np.sin(angle_n),
            factor,
            _OUTLINE,
        )
        for each in sphere.highlights:
            if each is not None:
                arm_n = np.arange(-3, 4) * factor
                colour = _UNSURE if each.rival > RIVAL else _MARK
                _put(picture_hwc, each.x + arm_n, np.full(7, each.y), factor, colour)
                _put(picture_hwc, np.full(7, each.x), each.y + arm_n, factor, colour)
    return picture_hwc


def _put(
    picture_hwc: NDArray[np.uint8],
    x_n: NDArray[np.floating],
    y_n: NDArray[np.floating],
    factor: int,
    colour: tuple[int, int, int],
) -> None:
    column_n, row_n = (np.rint((each + 0.5) / factor - 0.5).astype(int) for each in (x_n, y_n))
    inside_n = (column_n >= 0) & (row_n >= 0) & (column_n < picture_hwc.shape[1]) & (row_n < picture_hwc.shape[0])
    picture_hwc[row_n[inside_n], column_n[inside_n]] = colour
