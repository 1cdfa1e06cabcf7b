"""A stack of any size, made in a moment: rings on a plane, tiled, with hard shadows, highlights and noise."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.sampling import make_pattern
from clrelight.store import create_stack

TILE = 64
"""Largest width and height of the tile that is repeated."""

_RADIUS, _TUBE = 0.55, 0.25  # of the ring, in half widths of the tile
_STEPS = 32
_GAINS = (1.0, 0.85, 0.7, 0.55)
_NOISE = 0.01
_GLOSS = 40.0


def write_scene(path: str | os.PathLike[str], size: int, lights: int) -> None:
    """Write a grey float16 stack of ``size`` by ``size`` pixels, row by row: its memory does not grow with the height.

    The same size and lights give the same samples. A column of pixels is what a coefficient fit sees of real objects:
    diffuse and glossy reflection, attached and cast shadows, and the camera's noise.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    directions_i3 = make_pattern("uniform", lights)
    tiles_gitt = make_tiles(directions_i3, min(size, TILE))
    side = tiles_gitt.shape[-1]
    across = -(-size // side)
    # Neighbouring tiles differ in brightness, so that coders find no exact repetition.
    gain_tt = np.random.default_rng(1).integers(0, len(_GAINS), (across, across))
    blank_ihwc = np.broadcast_to(np.float16(0), (lights, size, size, 1))
    with create_stack(path, LightStack(blank_ihwc, directions_i3, 1.0, name="rings")) as sink:
        step = sink.chunks[1]
        for first in range(0, size, step):
            rows = np.arange(first, min(first + step, size))
            band_ihw = np.empty((lights, len(rows), across * side), np.float16)
            for r, row in enumerate(rows):
                for c, gain in enumerate(gain_tt[row // side]):
                    band_ihw[:, r, c * side : (c + 1) * side] = tiles_gitt[gain, :, row % side]
            sink[:, rows[0] : rows[-1] + 1] = band_ihw[:, :, :size, None]


def make_tiles(directions_i3: NDArray[np.float64], side: int) -> NDArray[np.float16]:
    """Return one ring under each light at each brightness, (gain, n_light, side, side), within [0, 1]."""
    x_p, y_p = (axis.reshape(-1) for axis in np.meshgrid(*[(np.arange(side) + 0.5) * (2.0 / side) - 1.0] * 2))
    height_p = _height(x_p, y_p)
    normal_p3 = _normals(x_p, y_p, height_p)
    albedo_p = 0.35 + 0.45 * (height_p > 0)
    images_ip = np.empty((len(directions_i3), side * side))
    for i, light_3 in enumerate(directions_i3):
        half_3 = light_3 + np.array([0.0, 0.0, 1.0])
        cosine_p = np.maximum(normal_p3 @ light_3, 0.0)
        gloss_p = np.maximum(normal_p3 @ (half_3 / np.linalg.norm(half_3)), 0.0) ** _GLOSS
        images_ip[i] = _is_lit(x_p, y_p, height_p, light_3) * (albedo_p * cosine_p + 0.3 * gloss_p * (cosine_p > 0))
    images_ip += _NOISE * np.random.default_rng(0).random(images_ip.shape)
    shape = (len(_GAINS), len(directions_i3), side, side)
    return (np.array(_GAINS)[:, None, None] * np.minimum(images_ip, 1.0)).reshape(shape).astype(np.float16)


def _height(x_p: NDArray[np.float64], y_p: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sqrt(np.maximum(_TUBE**2 - (np.hypot(x_p, y_p) - _RADIUS) ** 2, 0.0))


def _normals(x_p: NDArray[np.float64], y_p: NDArray[np.float64], height_p: NDArray[np.float64]) -> NDArray[np.float64]:
    distance_p = np.maximum(np.hypot(x_p, y_p), 1e-9)
    out_p = (distance_p - _RADIUS) / distance_p
    on_ring_p3 = np.stack([out_p * x_p, out_p * y_p, height_p], axis=1) / _TUBE
    return np.where(height_p[:, None] > 0, on_ring_p3, (0.0, 0.0, 1.0))


def _is_lit(
    x_p: NDArray[np.float64], y_p: NDArray[np.float64], height_p: NDArray[np.float64], light_3: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which points see the light past the ring: no step towards it may be below the surface."""
    lit_p = np.ones(len(x_p), bool)
    # Beyond this the way is above the ring, or outside it.
    longest = min((_TUBE + 1e-3) / light_3[2], 2.0 * (_RADIUS + _TUBE) + 2.0)
    for distance in longest * (np.arange(_STEPS) + 1.0) / _STEPS:
        step_3 = distance * light_3
        lit_p &= height_p + step_3[2] + 1e-6 >= _height(x_p + step_3[0], y_p + step_3[1])
    return lit_p
