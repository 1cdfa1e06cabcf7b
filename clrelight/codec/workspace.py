"""Where intermediate maps lie while a codec works, and how much memory its parts may take."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, counted
from clrelight.memory import ARRAY_MEMORY
from clrelight.tiles import PixelArray, Rectangle, read_tile

Shape = tuple[int, int, int, int]
"""(n_coeff, height, width, channel)."""
Progress = Callable[[int, int], object]
"""Told how much of how much is done."""

PARTS = 4
"""Pieces of a budget: the part being read, the one being coded, what is made of it, and what that takes meanwhile."""


class Planes(PixelArray, Protocol):
    """Maps of float32, put and read some at a time, or some rows of all at a time."""

    def put_maps(self, first: int, maps: NDArray[np.float32]) -> None:
        """Put whole maps, from number `first` on; they must not change any more."""
        ...

    def put_rows(self, first: int, rows: NDArray[np.float32]) -> None:
        """Put rows of every map, from row `first` on."""
        ...

    def maps(self, first: int, end: int) -> NDArray[np.float32]:
        """Return some maps, not to be written to."""
        ...


class ArrayPlanes:
    """`Planes` in memory."""

    chunks: tuple[int, ...] | None = None

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape, self.dtype = shape, np.dtype(np.float32)
        self._values: NDArray[np.float32] | None = None

    def put_maps(self, first: int, maps: NDArray[np.float32]) -> None:
        """See `Planes`."""
        if maps.shape == self.shape:
            self._values = maps
        else:
            self.whole()[first : first + len(maps)] = maps

    def put_rows(self, first: int, rows: NDArray[np.float32]) -> None:
        """See `Planes`."""
        if rows.shape == self.shape:
            self._values = rows
        else:
            self.whole()[:, first : first + rows.shape[1]] = rows

    def maps(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Planes`."""
        return self.whole()[first:end]

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """See `clrelight.tiles.PixelArray`."""
        read_tile(self.whole(), tile, out, picked_n)

    def whole(self) -> NDArray[np.float32]:
        """Return everything; memory is taken when it is first needed."""
        if self._values is None:
            self._values = np.empty(self.shape, np.float32)
        return self._values


class Workspace:
    """Where intermediate maps lie, and how much memory parts may take: here all that they need."""

    memory_bytes = ARRAY_MEMORY
    """Bytes that a codec which chooses the size of its parts may take for them."""

    def make_planes(self, shape: tuple[int, ...]) -> Planes:
        """Return maps of a shape, to be filled."""
        return ArrayPlanes(shape)

    def part_rows(self, shape: Shape, multiple: int) -> int:
        """Return how many rows of coefficients a part has: a multiple of some, or all."""
        return shape[1]

    def part_maps(self, shape: Shape) -> int:
        """Return how many maps a part has."""
        return shape[0]

    def tell(self, done: int, total: int) -> None:
        """Hear of progress."""


class BoundedWorkspace(Workspace):
    """A workspace whose parts keep to a number of bytes together.

    Parameters
    ----------
    memory_bytes : int
        Bytes for `PARTS` parts.
    progress : callable, optional
        Told how many rows or maps of a pass over them are done.
    """

    def __init__(self, memory_bytes: int, progress: Progress | None = None) -> None:
        self.memory_bytes, self._part_bytes = memory_bytes, memory_bytes // PARTS
        self.progress = progress

    def part_rows(self, shape: Shape, multiple: int) -> int:
        """See `Workspace`; InputError where not even the fewest rows fit."""
        n_coeff, height, width, channel = shape
        row_bytes = 4 * n_coeff * width * channel
        rows = self._part_bytes // row_bytes
        least = min(multiple, height)
        if rows < least:
            raise InputError(
                f"{counted(least, 'row')} of these coefficients, {PARTS} times, take {PARTS * least * row_bytes} "
                f"bytes, more than the memory budget {self.memory_bytes}"
            )
        return height if rows >= height else rows - rows % multiple

    def part_maps(self, shape: Shape) -> int:
        """See `Workspace`; at least one."""
        return min(max(self._part_bytes // (4 * math.prod(shape[1:])), 1), shape[0])

    def holds(self, n_bytes: int) -> bool:
        """Return whether as much is one part, beside which there is room for others."""
        return n_bytes <= self._part_bytes

    def tell(self, done: int, total: int) -> None:
        """See `Workspace`."""
        if self.progress is not None:
            self.progress(done, total)
