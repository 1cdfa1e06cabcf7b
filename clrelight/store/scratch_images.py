"""Photographs in a file without a name, for work that reads them more often than memory could hold them."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.store.blocks import box_of
from clrelight.store.scratch import Scratch
from clrelight.tiles import Rectangle


class ScratchImages:
    """Images (n_light, height, width, channel) that are written by rows, then read as `StoredArray` is.

    They are gone with the process, however it ends. Nothing is checked: nobody else can reach them.

    Parameters
    ----------
    folder : path
        Of what disk.
    shape : tuple of int
    dtype : dtype
    in_memory : bool
        As of `clrelight.store.scratch.Scratch`.
    """

    chunks = None
    has_columns = True

    def __init__(
        self, folder: str | os.PathLike, shape: tuple[int, ...], dtype: np.dtype, *, in_memory: bool = False
    ) -> None:
        self.shape, self.dtype = tuple(shape), np.dtype(dtype)
        self._row_bytes = math.prod(shape[2:]) * self.dtype.itemsize
        self._image_bytes = self._row_bytes * shape[1]
        self._scratch = Scratch(folder, self._image_bytes * shape[0], in_memory=in_memory)

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def in_memory(self) -> bool:
        """Whether they lie in memory, where that was asked for."""
        return self._scratch.in_memory

    def write_rows(self, light: int, first: int, rows_hwc: NDArray) -> None:
        """Write some rows of an image, of this type; several threads may."""
        if rows_hwc.dtype != self.dtype or rows_hwc.shape[1:] != self.shape[2:]:
            raise TypeError(f"expected {self.dtype} rows of {self.shape[2:]}, got {rows_hwc.dtype} {rows_hwc.shape}")
        self._scratch.write(light * self._image_bytes + first * self._row_bytes, np.ascontiguousarray(rows_hwc))

    def write_part(self, light: int, first: int, left: int, part_hwc: NDArray) -> None:
        """Write some columns of rows of an image."""
        if part_hwc.shape[1] == self.shape[2]:
            self.write_rows(light, first, part_hwc)
            return
        pixel_bytes = self._row_bytes // self.shape[2]
        for row, values in enumerate(np.ascontiguousarray(part_hwc), start=first):
            self._scratch.write(light * self._image_bytes + row * self._row_bytes + left * pixel_bytes, values)

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """See `clrelight.tiles.PixelArray`; the disk's other columns are not touched."""
        if out.dtype != self.dtype:
            raise TypeError(f"expected an array of {self.dtype}, got {out.dtype}")
        self._scratch.read_tile_into(self.shape, tile, out, picked_n)

    def __getitem__(self, key: Any) -> NDArray:
        """Read a selection: integers, slices, and lists of integers."""
        (lights, rows, *others), rest = box_of(key, self.shape)
        out = np.empty((lights.stop - lights.start, rows.stop - rows.start, *self.shape[2:]), self.dtype)
        self.read_into(Rectangle(rows.start, 0, rows.stop, self.shape[2]), out, np.arange(lights.start, lights.stop))
        return out[(slice(None), slice(None), *others)][rest]

    def close(self) -> None:
        """Give the disk its room back."""
        self._scratch.close()
