"""Pyramids of tiles: each level half as large as the one before, cut while the rows of the picture arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Emit = Callable[[int, int, int, NDArray[np.uint8]], None]
"""Told of the level (0 is the finest), the column and the row of a tile, and its pixels (height, width, plane)."""


@dataclass(frozen=True)
class Cut:
    """How a picture becomes tiles.

    Attributes
    ----------
    height, width : int
        Of the picture, in pixels.
    tile : int
        Side of a tile without its overlap.
    overlap : int
        Pixels that a tile shares with each neighbour, on each side.
    rounds_up : bool
        Whether half of an odd side is rounded up, as Deep Zoom and IIIF have it, or down, as OpenLIME has it.
    to_pixel : bool
        Whether the last level is one pixel; else it is one tile.
    """

    height: int
    width: int
    tile: int
    overlap: int = 0
    rounds_up: bool = False
    to_pixel: bool = False

    @property
    def n_level(self) -> int:
        """Levels: 1 + ceil(log2(longer side / side of the last level))."""
        last = 1 if self.to_pixel else self.tile
        return 1 + max(-(-max(self.height, self.width) // last) - 1, 0).bit_length()

    def size(self, level: int) -> tuple[int, int]:
        """Return height and width of a level, 0 being the finest; rounded down, a side may be 0."""
        room = (1 << level) - 1 if self.rounds_up else 0
        return (self.height + room) >> level, (self.width + room) >> level

    def counts(self, level: int) -> tuple[int, int]:
        """Return how many rows and columns of tiles a level has."""
        height, width = self.size(level)
        return -(-height // self.tile), -(-width // self.tile)

    def span(self, index: int, length: int) -> tuple[int, int]:
        """Return where a row or column of tiles begins and ends among the pixels of a level, overlap included."""
        return max(index * self.tile - self.overlap, 0), min((index + 1) * self.tile + self.overlap, length)

    def places(self) -> Iterator[tuple[int, int, int]]:
        """Yield level, column and row of all tiles, the coarsest level first, row by row: viewers count so."""
        for level in reversed(range(self.n_level)):
            n_row, n_column = self.counts(level)
            for row in range(n_row):
                for column in range(n_column):
                    yield level, column, row


class Pyramid:
    """Cuts tiles of all levels from rows that come from the top down.

    Parameters
    ----------
    cut : Cut
    planes : int
        Values of a pixel.
    emit : callable
        Told of each tile once; its pixels are lent only while it runs.

    Notes
    -----
    Held are the rows of one row of tiles at each level: ``2 (tile + 2 overlap) · width · planes`` bytes in all.
    """

    def __init__(self, cut: Cut, planes: int, emit: Emit) -> None:
        self._levels = [_Level(cut, level, planes, emit) for level in range(cut.n_level)]

    def add(self, rows_hwp: NDArray[np.uint8]) -> None:
        """Take the next rows, (rows, width, plane)."""
        for level in self._levels:
            level.add(rows_hwp)
            rows_hwp = level.halved(rows_hwp)
            if not rows_hwp.size:
                return


class _Level:
    def __init__(self, cut: Cut, level: int, planes: int, emit: Emit) -> None:
        self._cut, self._level, self._emit = cut, level, emit
        self._height, self._width = cut.size(level)
        self._n_row, self._n_column = cut.counts(level)
        rows = min(cut.tile + 2 * cut.overlap, self._height)
        self._held_hwp = np.empty((rows, self._width, planes), np.uint8)
        self._first = self._end = self._row = self._seen = 0
        self._odd_hwp = np.empty((0, self._width, planes), np.uint8)

    def add(self, rows_hwp: NDArray[np.uint8]) -> None:
        while len(rows_hwp):
            taken = min(self._stop - self._end, len(rows_hwp))
            self._held_hwp[self._end - self._first : self._end - self._first + taken] = rows_hwp[:taken]
            self._end, rows_hwp = self._end + taken, rows_hwp[taken:]
            while self._row < self._n_row and self._end == self._stop:
                self._finish()

    @property
    def _stop(self) -> int:
        """Row behind the last of the row of tiles that is being filled."""
        return self._cut.span(self._row, self._height)[1]

    def _finish(self) -> None:
        """Hand out a row of tiles, and keep of it what the next one shares."""
        for column in range(self._n_column):
            left, right = self._cut.span(column, self._width)
            self._emit(self._level, column, self._row, self._held_hwp[: self._end - self._first, left:right])
        self._row += 1
        first = self._cut.span(self._row, self._height)[0]
        shared_hwp = self._held_hwp[first - self._first : self._end - self._first].copy()
        self._held_hwp[: len(shared_hwp)] = shared_hwp
        self._first = first

    def halved(self, rows_hwp: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the rows of the next level that these finish: means of two by two pixels, rounded."""
        self._seen += len(rows_hwp)
        if len(self._odd_hwp):
            rows_hwp = np.concatenate([self._odd_hwp, rows_hwp])
        if len(rows_hwp) % 2 and self._seen == self._height and self._cut.rounds_up:
            rows_hwp = np.concatenate([rows_hwp, rows_hwp[-1:]])
        pairs = len(rows_hwp) // 2
        self._odd_hwp = rows_hwp[2 * pairs :].copy()
        rows_hwp = rows_hwp[: 2 * pairs]
        if self._width % 2 and self._cut.rounds_up:
            rows_hwp = np.concatenate([rows_hwp, rows_hwp[:, -1:]], axis=1)
        columns = rows_hwp.shape[1] // 2
        upper_hwp = rows_hwp[::2, : 2 * columns].astype(np.uint16) + rows_hwp[1::2, : 2 * columns]
        sums_hwp = upper_hwp[:, ::2] + upper_hwp[:, 1::2]
        return ((sums_hwp + 2) >> 2).astype(np.uint8)
