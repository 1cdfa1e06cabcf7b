"""Heads for tests of recognition: ellipsoids with nose, brows, eyes and lips, and painted regions, by a seed.

A head is a height field over the picture's plane, seen from afar. Its photographs under any light have attached and
cast shadows: from each pixel the way to the light is followed over the heights.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.sampling import make_pattern
from datasets_synth.codes import check_dtype, to_codes
from datasets_synth.texture import fractal_noise

WIDTH = 2.4
"""Of the picture, in the units of heads, which are about 1.5 wide and 2 high."""
_STEPS, _FAR = 40, 1.6
"""Places that are looked at on the way to a light, and how far, in those units."""
_BIAS, _BLOCK = 0.02, 1 << 16


@dataclass(frozen=True)
class Head:
    """A head as a camera in front of it sees it.

    Attributes
    ----------
    heights_hw : ndarray, shape (height, width), float64
        Towards the camera, in units in which the picture is `WIDTH` wide; -inf beside the head.
    normals_hw3 : ndarray, shape (height, width, 3), float64
        Unit vectors, x right, y up, z to the camera; 0 beside the head.
    albedo_hwc : ndarray, shape (height, width, 3), float64
    mask_hw : ndarray, shape (height, width), bool
    """

    heights_hw: NDArray[np.float64]
    normals_hw3: NDArray[np.float64]
    albedo_hwc: NDArray[np.float64]
    mask_hw: NDArray[np.bool_]


def make_head(seed: int, size: int = 64) -> Head:
    """Return a head of its own proportions and colours; all seeds look straight ahead, eyes in the same place."""
    rng = np.random.default_rng([seed, 8])
    step = WIDTH / size
    x_hw, y_hw = np.meshgrid((np.arange(size) + 0.5 - size / 2) * step, (size / 2 - 0.5 - np.arange(size)) * step)
    half_width, half_height, depth = rng.uniform(0.68, 0.82), rng.uniform(0.95, 1.08), rng.uniform(0.65, 0.95)
    # Broader at the brow than at the chin, by so much.
    jaw = rng.uniform(0.05, 0.28)
    square_hw = (x_hw / (half_width * (1.0 + jaw * y_hw))) ** 2 + (np.abs(y_hw) / half_height) ** rng.uniform(2.0, 2.6)
    mask_hw = square_hw < 0.97
    heights_hw = depth * np.sqrt(np.maximum(1.0 - square_hw, 0.0))
    for bump_hw in _features(rng, x_hw, y_hw):
        heights_hw = heights_hw + bump_hw
    down_hw, right_hw = np.gradient(heights_hw, step)
    normals_hw3 = np.stack([-right_hw, down_hw, np.ones_like(heights_hw)], axis=2)
    normals_hw3 /= np.linalg.norm(normals_hw3, axis=2, keepdims=True)
    normals_hw3[~mask_hw] = 0.0
    albedo_hwc = np.where(mask_hw[:, :, None], _paint(rng, seed, x_hw, y_hw), 0.0)
    return Head(np.where(mask_hw, heights_hw, -np.inf), normals_hw3, albedo_hwc, mask_hw)


def _bump(x_hw: NDArray, y_hw: NDArray, x: float, y: float, across: float, along: float) -> NDArray[np.float64]:
    return np.asarray(np.exp(-(((x_hw - x) / across) ** 2) - ((y_hw - y) / along) ** 2))


def _features(rng: np.random.Generator, x_hw: NDArray, y_hw: NDArray) -> list[NDArray[np.float64]]:
    """Return what nose, brows, sockets, cheeks, lips and chin add to the heights."""
    apart, eye = rng.uniform(0.27, 0.34), rng.uniform(0.14, 0.22)
    long, mouth = rng.uniform(0.26, 0.38), rng.uniform(-0.52, -0.42)
    nose, tip = rng.uniform(0.10, 0.20), rng.uniform(0.10, 0.18)
    socket, brow, cheek = rng.uniform(0.05, 0.12), rng.uniform(0.03, 0.09), rng.uniform(0.0, 0.10)
    parts = [
        nose * _bump(x_hw, y_hw, 0.0, eye - 0.5 * long, 0.08, 0.6 * long),
        tip * _bump(x_hw, y_hw, 0.0, eye - long, rng.uniform(0.08, 0.13), 0.09),
        rng.uniform(0.03, 0.07) * _bump(x_hw, y_hw, 0.0, mouth, rng.uniform(0.18, 0.28), 0.07),
        rng.uniform(0.02, 0.08) * _bump(x_hw, y_hw, 0.0, -0.78, 0.16, 0.12),
    ]
    for side in (-1.0, 1.0):
        parts += [
            -socket * _bump(x_hw, y_hw, side * apart, eye, 0.14, 0.09),
            0.05 * _bump(x_hw, y_hw, side * apart, eye, 0.07, 0.05),
            brow * _bump(x_hw, y_hw, side * apart, eye + 0.15, 0.20, 0.06),
            cheek * _bump(x_hw, y_hw, side * 0.40, eye - 0.35, 0.18, 0.18),
        ]
    return parts


def _paint(rng: np.random.Generator, seed: int, x_hw: NDArray, y_hw: NDArray) -> NDArray[np.float64]:
    """Return the colours of skin, lips, eyes, brows and hair, mottled."""
    tone = rng.uniform(0.25, 0.75)
    skin = tone * np.array([1.0, rng.uniform(0.72, 0.85), rng.uniform(0.55, 0.72)])
    hair = rng.uniform(0.05, 0.4) * np.array([1.0, 0.8, 0.6])
    apart, eye, line = rng.uniform(0.28, 0.33), rng.uniform(0.15, 0.21), rng.uniform(0.5, 0.8)
    places_s2 = np.stack([x_hw.ravel(), y_hw.ravel()], axis=1) / 0.35 + 40.0
    mottle_hw = 1.0 + 0.3 * (fractal_noise(places_s2, seed).reshape(x_hw.shape) - 0.5)
    colour_hwc = skin * mottle_hw[:, :, None]
    regions: list[tuple[NDArray[np.bool_], NDArray[np.float64]]] = [
        (
            _bump(x_hw, y_hw, 0.0, rng.uniform(-0.52, -0.42), rng.uniform(0.15, 0.24), 0.06) > 0.4,
            skin * [0.9, 0.5, 0.5],
        ),
        (y_hw > line + 0.3 * rng.uniform(-1.0, 1.0) * x_hw**2, hair),
    ]
    for side in (-1.0, 1.0):
        regions += [
            (_bump(x_hw, y_hw, side * apart, eye, 0.10, 0.05) > 0.4, np.full(3, 0.8)),
            (_bump(x_hw, y_hw, side * apart, eye, 0.045, 0.045) > 0.4, np.full(3, rng.uniform(0.03, 0.2))),
            (_bump(x_hw, y_hw, side * apart, eye + 0.15, rng.uniform(0.15, 0.22), 0.035) > 0.4, hair),
        ]
    for inside_hw, colour in regions:
        colour_hwc[inside_hw] = colour
    return np.clip(colour_hwc, 0.02, 1.0)


def shade_head(head: Head, directions_i3: NDArray[np.float64], cast: bool = True) -> NDArray[np.float32]:
    """Return ``max(0, n . l) V(l)`` of the pixels inside the mask, shape (n_light, P), for lights all around.

    Parameters
    ----------
    head : Head
    directions_i3 : ndarray, shape (n_light, 3)
        Unit vectors to the lights.
    cast : bool
        Whether parts of the head shade others; else V is 1.
    """
    row_p, column_p = np.nonzero(head.mask_hw)
    normals_p3 = head.normals_hw3[head.mask_hw]
    shade_ip = np.maximum(directions_i3 @ normals_p3.T, 0.0).astype(np.float32)
    if not cast:
        return shade_ip
    size, step = head.mask_hw.shape[0], WIDTH / head.mask_hw.shape[0]
    padded_hw = np.pad(head.heights_hw, 1, constant_values=-np.inf)
    start_p = head.heights_hw[head.mask_hw]
    way_t = step + (np.arange(_STEPS) / _STEPS) ** 1.5 * _FAR
    block = max(1, _BLOCK // max(1, len(row_p)))
    for first in range(0, len(directions_i3), block):
        part = slice(first, first + block)
        x_i1, y_i1, z_i1 = (directions_i3[part, axis, None] for axis in range(3))
        free_ip = np.ones((len(x_i1), len(row_p)), bool)
        for way in way_t:
            row_ip = np.clip(np.rint(row_p - way * y_i1 / step).astype(np.int32), -1, size) + 1
            column_ip = np.clip(np.rint(column_p + way * x_i1 / step).astype(np.int32), -1, size) + 1
            free_ip &= padded_hw[row_ip, column_ip] <= start_p + way * z_i1 + _BIAS
        shade_ip[part] *= free_ip
    return shade_ip


def photograph_head(head: Head, shade_ip: NDArray[np.float32], radiance_ic: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the head under many lights at once, (height, width, 3): ``albedo sum_i radiance_i shade_i``.

    Parameters
    ----------
    head : Head
    shade_ip : ndarray, shape (n_light, P)
        From `shade_head`.
    radiance_ic : ndarray, shape (n_light, 3)
        Radiance times solid angle, over pi.
    """
    picture_hwc = np.zeros((*head.mask_hw.shape, 3), np.float32)
    picture_hwc[head.mask_hw] = (shade_ip.T @ radiance_ic.astype(np.float32)) * head.albedo_hwc[head.mask_hw]
    return picture_hwc


def render_heads(
    size: int,
    lights: int,
    pattern: str,
    seed: int,
    dtype: str,
    progress: Callable[[int, int], None] | None = None,
) -> LightStack:
    """Return a head under distant lights one by one, as `clrelight synth head` makes it."""
    check_dtype(dtype)
    head, directions_i3 = make_head(seed, size), make_pattern(pattern, lights, seed)
    images_ihwc = np.zeros((lights, size, size, 3), np.float32)
    for i in range(lights):
        shade_ip = shade_head(head, directions_i3[i : i + 1])
        images_ihwc[i] = photograph_head(head, shade_ip, np.ones((1, 3)))
        if progress is not None:
            progress(i + 1, lights)
    stack = LightStack(images_ihwc, directions_i3, 1.0, "linear", None, head.mask_hw, "head")
    return to_codes(stack, dtype)
