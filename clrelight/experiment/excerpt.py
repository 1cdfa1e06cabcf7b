"""Windows spread over a large image, side by side in a small one: what a trade-off is measured on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.memory import IMAGE_MEMORY
from clrelight.tiles import Rectangle, read_tile

WINDOW = 64
"""Height and width of a window in pixels: what codecs cut a map into, so that few coefficients reach over a seam."""


def excerpt_of(stack: LightStack, pixels: float) -> tuple[LightStack, float]:
    """Return a stack in memory of about so many pixels, and how many of the image's each stands for.

    Parameters
    ----------
    stack : LightStack
    pixels : float
        Images that are no larger are returned as they are; so are those of a surface, whose pixels are vertices.

    Returns
    -------
    LightStack
    float
        Pixels of the image for each of the excerpt.

    Raises
    ------
    InputError
        If the mask leaves no pixel of the excerpt.
    """
    height, width, channel = stack.image_shape
    if height * width <= pixels or stack.surface is not None:
        return stack, 1.0
    sides = min(WINDOW, height), min(WINDOW, width)
    down = min(height // sides[0], max(1, round(math.sqrt(pixels * height / width) / sides[0])))
    across = min(width // sides[1], max(1, round(pixels / (down * sides[0] * sides[1]))))
    tops, lefts = _places(height, sides[0], down), _places(width, sides[1], across)
    images_ihwc = np.empty((stack.n_light, down * sides[0], across * sides[1], channel), stack.images_ihwc.dtype)
    mask_hw = None if stack.mask_hw is None else np.zeros(images_ihwc.shape[1:3], bool)
    for row, top in enumerate(tops):
        for column, left in enumerate(lefts):
            window = Rectangle(top, left, top + sides[0], left + sides[1])
            rows, columns = (slice(n * side, (n + 1) * side) for n, side in zip((row, column), sides, strict=True))
            tile_ihwc = np.empty((stack.n_light, *sides, channel), images_ihwc.dtype)
            images_ihwc[:, rows, columns] = read_tile(stack.images_ihwc, window, tile_ihwc)
            if mask_hw is not None and stack.mask_hw is not None:
                mask_hw[rows, columns] = stack.mask_hw[window.rows, window.columns]
    if mask_hw is not None and not mask_hw.any():
        raise InputError("the mask leaves no pixel in the windows that are measured: give more --megapixels")
    scale = height * width / (images_ihwc.shape[1] * images_ihwc.shape[2])
    return replace(stack, images_ihwc=images_ihwc, mask_hw=mask_hw), scale


def _places(length: int, side: int, count: int) -> NDArray[np.intp]:
    """Return where windows begin: evenly, without overlap, the first and last as far from the edges as each other."""
    gap = (length - count * side) / (count + 1)
    return np.rint(gap + np.arange(count) * (side + gap)).astype(np.intp)


def in_memory(stack: LightStack) -> LightStack:
    """Return a stack with its images in memory where they are not too large, so that no time is one of reading."""
    size = math.prod(stack.images_ihwc.shape) * stack.images_ihwc.dtype.itemsize
    return replace(stack, images_ihwc=stack.read_rows(0, stack.image_shape[0])) if size <= IMAGE_MEMORY else stack
