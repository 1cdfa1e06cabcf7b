"""Tiles of an image as a graphics card takes them: four planes to a texel, as floats of 16 bits or as bytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TILE = 256
"""Side of a tile in pixels of its level, without the border that neighbours share."""
BORDER = 1
LEVELS = 5
SHOWN_SIDE = 512
"""An image whose longer side is no longer has no coarser level."""
_LARGEST_HALF = 65504.0


@dataclass(frozen=True)
class TilePlace:
    """Which pixels of a level a tile and its border hold: rows and columns, from the first to before the end."""

    level: int
    top: int
    left: int
    bottom: int
    right: int


def level_side(side: int, level: int) -> int:
    """Return a side of the image at a level."""
    return -(-side >> level)


def count_levels(height: int, width: int) -> int:
    """Return how often an image is halved until it is small."""
    level = 0
    while level < LEVELS and max(level_side(height, level), level_side(width, level)) > SHOWN_SIDE:
        level += 1
    return level


def tile_place(height: int, width: int, level: int, row: int, column: int) -> TilePlace:
    """Return the pixels of a tile; LookupError where there is no such tile."""
    h, w = level_side(height, level), level_side(width, level)
    if not (0 <= level <= LEVELS and 0 <= row < -(-h // TILE) and 0 <= column < -(-w // TILE)):
        raise LookupError(f"there is no tile {level}/{row}/{column}")
    top, left = max(row * TILE - BORDER, 0), max(column * TILE - BORDER, 0)
    return TilePlace(level, top, left, min((row + 1) * TILE + BORDER, h), min((column + 1) * TILE + BORDER, w))


def halve(planes_phw: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the means of 2 × 2 pixels; at an odd edge, of those that are there."""
    _, height, width = planes_phw.shape
    padded = np.pad(planes_phw, [(0, 0), (0, height % 2), (0, width % 2)], mode="edge")
    rows = padded[:, 0::2] + padded[:, 1::2]
    return np.float32(0.25) * (rows[:, :, 0::2] + rows[:, :, 1::2])


def pack_half(planes_phw: NDArray[np.float32], group: int = 4) -> bytes:
    """Return texels [layer, row, column, 4] as 16-bit floats, cut to their range; `group` planes to a layer."""
    texels = _interleaved(np.clip(planes_phw, -_LARGEST_HALF, _LARGEST_HALF), group)
    return texels.astype("<f2").tobytes()


def pack_bytes(planes_phw: NDArray[np.float32]) -> bytes:
    """Return first levels and steps, float32 [layer, 4] each, then texels as bytes: ``low + step · byte``."""
    low_p = planes_phw.min(axis=(1, 2))
    step_p = (planes_phw.max(axis=(1, 2)) - low_p) / np.float32(255.0)
    codes = (planes_phw - low_p[:, None, None]) / np.where(step_p > 0, step_p, 1.0)[:, None, None].astype(np.float32)
    texels = _interleaved(np.rint(codes), 4).astype(np.uint8)
    filled = -len(low_p) % 4
    heads = [np.pad(each, (0, filled)).astype("<f4").tobytes() for each in (low_p, step_p)]
    return b"".join([*heads, texels.tobytes()])


def _interleaved(planes_phw: NDArray[np.float32], group: int) -> NDArray[np.float32]:
    count, height, width = planes_phw.shape
    layers = -(-count // group)
    texels = np.zeros((layers, height, width, 4), np.float32)
    for p, plane in enumerate(planes_phw):
        texels[p // group, :, :, p % group] = plane
    return texels
