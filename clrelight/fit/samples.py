"""A sample of a stack's pixels, for what a fit learns from data before it runs."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import count

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import srgb_to_linear
from clrelight.dataset import LightStack
from clrelight.errors import InputError

MAX_COLUMNS = 20_000
"""Columns (pixel and channel) of a sample."""
_MAX_VALUES = 1 << 23
"""Values of a sample over all lights; with more lights than 420 it has fewer columns."""

_SHEAR = (np.sqrt(5.0) - 1.0) / 2.0
"""Each lattice row starts a golden-section step further on, so that no regular texture keeps in step with it."""


class Samples:
    """Pixels evenly spread over a stack, read when first asked for.

    Parameters
    ----------
    stack : LightStack
        Pixels outside its mask are not taken.
    max_columns : int
        At most so many columns, at least one pixel.
    """

    def __init__(self, stack: LightStack, max_columns: int = MAX_COLUMNS) -> None:
        self._source, self._max_columns = stack, max_columns

    @property
    def channels(self) -> int:
        """Number of channels; nothing is read for it."""
        return self._source.image_shape[2]

    @cached_property
    def stack(self) -> LightStack:
        """The pixels as a stack of one row, in the source's own type."""
        source = self._source
        columns = min(self._max_columns, max(1, _MAX_VALUES // source.n_light))
        picked = _pick_pixels(source, max(1, columns // source.image_shape[2]))
        # Only rows with a picked pixel are read.
        rows = [source.read_rows(row, row + 1)[:, :, pixels] for row, pixels in picked.items()]
        return replace(source, images_ihwc=np.concatenate(rows, axis=2), mask_hw=None, surface=None)

    @cached_property
    def radiance_ip(self) -> NDArray[np.float64]:
        """Linear radiance in units of the peak, shape (n_light, pixel * channel), channels adjacent."""
        encoded_ip = self.encoded_ip
        return srgb_to_linear(encoded_ip) if self.stack.transfer == "srgb" else encoded_ip

    @cached_property
    def encoded_ip(self) -> NDArray[np.float64]:
        """The same in the stack's own transfer, in which errors are measured."""
        return self.stack.images_ihwc.astype(np.float64).reshape(self.stack.n_light, -1) / self.stack.peak

    def thin(self, max_columns: int) -> Samples:
        """Return at most so many of these columns, evenly spread (at least one pixel)."""
        pixels, channels = self.stack.image_shape[1:]
        wanted = max(1, max_columns // channels)
        chosen = np.unique(np.linspace(0, pixels - 1, min(wanted, pixels)).astype(np.intp))
        return self.holding(replace(self.stack, images_ihwc=self.stack.images_ihwc[:, :, chosen]))

    def select(self, lights_i: NDArray[np.intp]) -> Samples:
        """Return the same pixels under these lights only."""
        return self.holding(self.stack.select(lights_i))

    @property
    def source(self) -> LightStack:
        """The stack whose pixels these are; nothing is read for it."""
        return self._source

    @staticmethod
    def holding(stack: LightStack) -> Samples:
        """Return all pixels of a stack of one row."""
        made = Samples(stack)
        made.__dict__["stack"] = stack  # what the cached property would compute, known already
        return made


def _pick_pixels(stack: LightStack, wanted: int) -> dict[int, NDArray[np.intp]]:
    """Return the columns to take of each row: a lattice of square cells, coarse enough for `wanted` pixels."""
    height, width, _ = stack.image_shape
    mask_hw = np.ones((height, width), bool) if stack.mask_hw is None else stack.mask_hw
    inside = int(mask_hw.sum())
    if inside == 0:
        raise InputError("the mask leaves no pixel to fit")
    step = max(1, int(np.sqrt(inside / wanted)))
    for spacing in count(step):
        picked = _lattice(mask_hw, spacing)
        total = sum(len(pixels) for pixels in picked.values())
        if total <= wanted:
            break
    if 2 * total < wanted:
        # A mask of thin or small pieces falls between the lattice's points: take its pixels in reading order.
        flat = np.flatnonzero(mask_hw)[np.linspace(0, inside - 1, min(inside, wanted)).astype(np.intp)]
        rows, pixels = np.unravel_index(flat, mask_hw.shape)
        picked = {int(row): pixels[rows == row] for row in np.unique(rows)}
    return picked


def _lattice(mask_hw: NDArray[np.bool_], spacing: int) -> dict[int, NDArray[np.intp]]:
    picked = {}
    for index, row in enumerate(range(spacing // 2, len(mask_hw), spacing)):
        pixels = np.arange(int(index * _SHEAR * spacing) % spacing, mask_hw.shape[1], spacing)
        pixels = pixels[mask_hw[row, pixels]]
        if len(pixels):
            picked[row] = pixels
    return picked
