"""Rectangles of images, the tiles that they are cut into, and what gives the values of one.

Whatever is larger than memory is gone through tile by tile: `row_tiles` says which, `read_tile` reads one of any
`PixelArray`, and `clrelight.streaming.reading_ahead` the next while one is worked on; `clrelight.passes` is all of
that for a stack.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Span = tuple[int, int]
"""The first of some rows or columns, and the one behind the last."""


@dataclass(frozen=True)
class Rectangle:
    """Rows and columns of an image, in pixels, from the first to the one before the end."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.bottom - self.top, self.right - self.left

    @property
    def n_pixel(self) -> int:
        """Height times width."""
        return (self.bottom - self.top) * (self.right - self.left)

    @property
    def sides(self) -> tuple[int, int, int, int]:
        """Top, left, bottom and right, from which another is made."""
        return self.top, self.left, self.bottom, self.right

    @property
    def rows(self) -> slice:
        """As an index."""
        return slice(self.top, self.bottom)

    @property
    def columns(self) -> slice:
        """As an index."""
        return slice(self.left, self.right)

    def check_within(self, height: int, width: int) -> None:
        """Raise ValueError where it is not a part of an image of a size."""
        if not (0 <= self.top <= self.bottom <= height and 0 <= self.left <= self.right <= width):
            raise ValueError(f"expected a part of {height} x {width} pixels, got {self}")


@runtime_checkable
class PixelArray(Protocol):
    """Values (n, height, width, channel) of n images or maps, read tile by tile.

    Attributes
    ----------
    shape, dtype
        As of an ndarray.
    chunks : tuple of int or None
        Shape of the pieces in which it is stored, if it is.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    chunks: tuple[int, ...] | None

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """Read a tile of all images, or of those picked, into an array (images, height, width, channel).

        Its type is that of the values, or holds them; ValueError where shapes differ.
        """
        ...


def read_tile(array_nhwc: Any, tile: Rectangle, out_nhwc: NDArray, picked_n: NDArray[np.intp] | None = None) -> NDArray:
    """Fill `out_nhwc` with a tile of an array, a `PixelArray`, or what else is read when indexed, and return it."""
    if not isinstance(array_nhwc, np.ndarray) and isinstance(array_nhwc, PixelArray):
        array_nhwc.read_into(tile, out_nhwc, picked_n)
    elif picked_n is None:
        out_nhwc[...] = array_nhwc[:, tile.rows, tile.columns]
    else:
        out_nhwc[...] = array_nhwc[:, tile.rows, tile.columns][picked_n]
    return out_nhwc


def read_rows_into(array_nhwc: Any, first: int, end: int, out_nhwc: NDArray) -> NDArray:
    """Fill `out_nhwc` with whole rows first..end, as `read_tile` does."""
    return read_tile(array_nhwc, Rectangle(first, 0, end, array_nhwc.shape[2]), out_nhwc)


def chunk_rows(array_nhwc: Any) -> int:
    """Return how many rows of it are stored together; 1 where that does not matter."""
    chunks = getattr(array_nhwc, "chunks", None)
    return int(chunks[1]) if chunks else 1


def has_columns(array_nhwc: Any) -> bool:
    """Return whether some columns of rows cost no more than their own bytes."""
    return bool(getattr(array_nhwc, "has_columns", False))


def row_tiles(rows: Span, step: int) -> list[Span]:
    """Return parts of so many whole rows each, the last of what is left."""
    return [(first, min(first + step, rows[1])) for first in range(*rows, step)]


def check_shape(tile: Rectangle, out: NDArray, shape: tuple[int, ...], picked_n: NDArray[np.intp] | None) -> None:
    """Raise ValueError unless a tile lies in an array of a shape, and `out` has that of what is read."""
    tile.check_within(*shape[1:3])
    expected = (shape[0] if picked_n is None else len(picked_n), *tile.shape, *shape[3:])
    if out.shape != expected:
        raise ValueError(f"expected an array {expected} for {tile}, got {out.shape}")


class LightSubset:
    """Some lights of images that are read tile by tile."""

    def __init__(self, images_ihwc: Any, lights_i: NDArray[np.intp]) -> None:
        self._images, self._lights = images_ihwc, lights_i
        self.shape = (len(lights_i), *images_ihwc.shape[1:])
        self.dtype, self.chunks = images_ihwc.dtype, getattr(images_ihwc, "chunks", None)
        self.has_columns = has_columns(images_ihwc)

    def __getitem__(self, key: tuple[slice, ...]) -> NDArray:
        # HDF5 reads scattered lights slowly and rows of all lights fast, so pick after reading.
        lights, *rest = key
        return self._images[(slice(None), *rest)][self._lights][lights]

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """See `PixelArray`; the lights that are left out take little memory where the images are a file's."""
        read_tile(self._images, tile, out, self._lights if picked_n is None else self._lights[picked_n])
