"""Code the indices of wavelet-transformed planes in units that any machine decodes alone, and alike.

A unit is one place of one level and holds HL, LH and HH of all planes there, or LL of all planes; its samples know
those of its parent, one level coarser, and nothing else outside. Units follow each other from coarse to fine. A stream
is one unit, or all of them where a map is small; compiled loops (``units_encode.cl``, ``units_decode.cl``) code streams
side by side. What stands in a stream: docs/bitstream.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.transforms.lifting import list_subbands
from clrelight.tiles import Rectangle

LEVELS = 5
PRECINCT = 512
"""Side in pixels of what one unit of the coarsest three levels, four of level 2 and sixteen of level 1 are of."""

_FIELDS = 19  # as in units.clh
_WHOLE, _STRIPS, _LAST_PIECES = 1 << 20, 4, 4
"""Pixels up to which an image may be one tile; a larger one has about as many strips or more."""
MARGIN = 128
"""Pixels around a tile that its transform looks at: 4 (2^LEVELS - 1), and a multiple of 2^LEVELS."""


@dataclass(frozen=True)
class Window(Rectangle):
    """A part of an image whose planes are transformed together; it begins at multiples of ``2 ** LEVELS``."""

    def sides_at(self, level: int) -> tuple[int, int]:
        """Return the height and width of its planes at a level."""
        return low_side(self.bottom, level) - (self.top >> level), low_side(self.right, level) - (self.left >> level)


@dataclass(frozen=True)
class Unit:
    """A place: its level, 0 for LL, and its first row and column in the low subband of the level."""

    level: int
    row: int
    column: int

    @property
    def side(self) -> int:
        """Rows and columns of its subbands at most."""
        return unit_side(self.level)


def unit_side(level: int) -> int:
    """Return the rows and columns of a unit's subbands: what a precinct has, 64 at most."""
    return min(PRECINCT >> (level or LEVELS), 64)


def list_units(height: int, width: int) -> list[Unit]:
    """Return all units of an image, from coarse to fine, rows first."""
    units = []
    for level in (0, *range(LEVELS, 0, -1)):
        side, depth = unit_side(level), level or LEVELS
        rows, columns = low_side(height, depth), low_side(width, depth)
        units += [Unit(level, row, column) for row in range(0, rows, side) for column in range(0, columns, side)]
    return units


def count_units(height: int, width: int) -> int:
    """Return the number of `list_units`, of images of any size that a header claims."""
    count = 0
    for level in range(LEVELS + 1):
        side, depth = unit_side(level), level or LEVELS
        count += -(-low_side(height, depth) // side) * -(-low_side(width, depth) // side)
    return count


def low_side(side: int, level: int) -> int:
    """Return the samples of a side of the low subband of a level: the pixels of the image at that level."""
    return -(-side >> level)


def describe_units(units: list[Unit], height: int, width: int, window: Window, pitch: int) -> NDArray[np.int32]:
    """Return how units lie in a window's planes, whose rows have `pitch` values, (n_unit, 19): see ``units.clh``."""
    fields = np.zeros((len(units), _FIELDS), np.int32)
    fields[:, 10:13] = -1
    for at, unit in zip(fields, units, strict=True):
        depth = unit.level or LEVELS
        row, column = unit.row - (window.top >> depth), unit.column - (window.left >> depth)
        at[0] = unit.level
        if unit.level == 0:
            at[1] = row * pitch + column
            at[4] = min(unit.side, low_side(height, depth) - unit.row)
            at[7] = min(unit.side, low_side(width, depth) - unit.column)
            continue
        bands = _bands(height, width, depth, window)
        parents = _bands(height, width, depth + 1, window) if depth < LEVELS else []
        for band, (first_row, first_column, rows, columns) in enumerate(bands):
            at[1 + band] = (first_row + row) * pitch + first_column + column
            at[4 + band] = min(unit.side, rows - unit.row)
            at[7 + band] = min(unit.side, columns - unit.column)
            if not parents:
                continue
            first_row, first_column, rows, columns = parents[band]
            if rows > unit.row // 2 and columns > unit.column // 2:
                at[10 + band] = (first_row + row // 2) * pitch + first_column + column // 2
                at[13 + band], at[16 + band] = rows - unit.row // 2, columns - unit.column // 2
    return fields


@lru_cache(maxsize=64)
def _bands(height: int, width: int, level: int, window: Window) -> list[tuple[int, int, int, int]]:
    """Return where HL, LH and HH begin in a window's planes, and how many rows and columns the image has of them."""
    low_row, low_column = low_side(window.shape[0], level), low_side(window.shape[1], level)
    low_h, low_w = low_side(height, level), low_side(width, level)
    high_h, high_w = low_side(height, level - 1) - low_h, low_side(width, level - 1) - low_w
    return [
        (0, low_column, low_h, high_w),
        (low_row, 0, high_h, low_w),
        (low_row, low_column, high_h, high_w),
    ]


def place_units(units: list[Unit], window: Window, level: int = 0) -> NDArray[np.int32]:
    """Return where units' subbands lie in planes of a window at a level, (n_unit, 3, 6).

    Of HL, LH and HH, or of LL first: row and column of its first sample, which may lie outside; the first row of the
    window's subband and that behind its last, and the same of columns.
    """
    places = np.zeros((len(units), 3, 6), np.int32)
    found = list_subbands(*window.sides_at(level), LEVELS - level)
    bands = {(band.name, band.level + level): band for band in found}
    for at, unit in zip(places, units, strict=True):
        depth = unit.level or LEVELS
        for place, name in zip(at, ("HL", "LH", "HH") if unit.level else ("LL",), strict=False):
            if (band := bands.get((name, depth))) is None:
                continue
            place[0] = band.rows.start + unit.row - (window.top >> depth)
            place[1] = band.columns.start + unit.column - (window.left >> depth)
            place[2:] = band.rows.start, band.rows.stop, band.columns.start, band.columns.stop
    return places


@dataclass(frozen=True)
class Layout:
    """Which units of a window are coded, in which streams.

    Attributes
    ----------
    unit_uf : ndarray, shape (n_unit, 19), int32
        See `describe_units`; from coarse to fine.
    part_t4 : ndarray, shape (n_stream, 4), int32
        First unit of each stream, the one behind its last; its first plane, and the one behind its last.
    """

    unit_uf: NDArray[np.int32]
    part_t4: NDArray[np.int32]

    @property
    def levels(self) -> NDArray[np.int32]:
        """The level of each stream's first unit."""
        return self.unit_uf[self.part_t4[:, 0], 0]

    def of_streams(self, chosen: Sequence[int]) -> Layout:
        """Return the layout of some streams only, in order."""
        return replace(self, part_t4=np.ascontiguousarray(self.part_t4[list(chosen)]))

    def batches(self, *, apart: bool = False) -> list[tuple[int, int]]:
        """Return the first and last but one of the streams that need none of each other, in order.

        Where groups of planes are to be `apart`, streams of a batch are also of one group.
        """
        level_t = self.levels
        rank_t = np.where(level_t == 0, LEVELS + 1, level_t)
        changes = (np.diff(rank_t) != 0) & (rank_t[1:] < LEVELS)  # LL is no parent
        if apart:
            changes |= np.diff(self.part_t4[:, 2]) != 0
        starts = [0, *(np.flatnonzero(changes) + 1).tolist(), len(rank_t)]
        return list(itertools.pairwise(starts))

    def of_first(self, count: int) -> Layout:
        """Return the layout of the first planes only."""
        if count >= int(self.part_t4[:, 3].max(initial=0)):
            return self
        return replace(self, part_t4=np.minimum(self.part_t4, [1 << 30, 1 << 30, count, count]).astype(np.int32))


def lay_out(
    units: list[Unit], sides: tuple[int, int], window: Window, pitch: int, together: bool, groups: list[tuple[int, int]]
) -> Layout:
    """Return the layout of units of an image: each a stream of every group of planes, or all together one.

    Streams follow each other level by level, of a level group by group, and in those unit by unit.
    """
    spans = [(0, len(units))]
    if not together:
        levels = [unit.level for unit in units]
        starts = [0, *(u for u in range(1, len(units)) if levels[u] != levels[u - 1]), len(units)]
        spans = list(itertools.pairwise(starts))
    parts: list[tuple[int, ...]] = []
    for first, end in spans:
        found = [(first, end)] if together else [(u, u + 1) for u in range(first, end)]
        parts += [(*span, *group) for group in groups for span in found]
    return Layout(describe_units(units, *sides, window, pitch), np.array(parts, np.int32).reshape(-1, 4))


@dataclass(frozen=True)
class Tile:
    """Units that are made together, and the window that their transform looks at.

    Attributes
    ----------
    units : list of Unit
        From coarse to fine.
    streams : list of int
        Their numbers among all units; 0 alone where all are one stream.
    window : Window
    top, bottom : int
        Rows of pixels that the units are of.
    n_pixel : int
        Their pixels.
    """

    units: list[Unit]
    streams: list[int]
    window: Window
    top: int
    bottom: int
    n_pixel: int


def whole_tile(height: int, width: int, streams: list[int]) -> Tile:
    """Return the tile of a whole image."""
    return Tile(list_units(height, width), streams, Window(0, 0, height, width), 0, height, height * width)


def tile_of(
    height: int, width: int, sides: tuple[int, int, int, int], among: list[tuple[int, Unit]] | None = None
) -> Tile:
    """Return the tile of top, left, bottom and right, the first two of which are multiples of `PRECINCT`.

    Its units are `among` those, with their numbers; by default all of the image.
    """
    top, left, bottom, right = sides
    known = list(enumerate(list_units(height, width))) if among is None else among
    chosen = [(t, unit) for t, unit in known if _begins_in(unit, top, left, bottom, right)]
    window = Window(
        max(top - MARGIN, 0), max(left - MARGIN, 0), min(bottom + MARGIN, height), min(right + MARGIN, width)
    )
    n_pixel = (bottom - top) * (right - left)
    return Tile([unit for _, unit in chosen], [t for t, _ in chosen], window, top, bottom, n_pixel)


def list_tiles(height: int, width: int, count: int, memory: int) -> list[Tile]:
    """Return the tiles of an image of so many planes: whole precincts whose windows fit a number of bytes, rows first.

    Strips as wide as the image where one fits, which rows are read once for; one precinct at the least. The last strip
    is in pieces: what comes last is coded several times, which takes its memory twice.
    """
    known = list(enumerate(list_units(height, width)))
    if is_one_tile(height, width, count, memory):
        return [whole_tile(height, width, list(range(len(known))))]
    rows, columns = tile_sides(height, width, count, memory)
    tiles = []
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        if bottom == height:
            columns = min(columns, -(-width // (_LAST_PIECES * PRECINCT)) * PRECINCT)
        for left in range(0, width, columns):
            right = min(left + columns, width)
            tiles.append(tile_of(height, width, (top, left, bottom, right), known))
    return tiles


def is_one_tile(height: int, width: int, count: int, memory: int) -> bool:
    """Return whether an image of so many planes is one tile within so many bytes."""
    return height * width <= _WHOLE and 4 * height * width * count <= memory


def tile_sides(height: int, width: int, count: int, memory: int) -> tuple[int, int]:
    """Return the rows and columns of tiles of so many planes whose windows fit a number of bytes, if any do."""
    values = memory // (4 * max(count, 1))
    rows = min(values // width - 2 * MARGIN, height // _STRIPS + PRECINCT - 1) // PRECINCT * PRECINCT
    if rows >= PRECINCT or (height <= PRECINCT and values >= width * height):
        return min(max(rows, PRECINCT), height), width
    columns = (values // min(PRECINCT + 2 * MARGIN, height) - 2 * MARGIN) // PRECINCT * PRECINCT
    return min(PRECINCT, height), min(max(columns, PRECINCT), width)


def _begins_in(unit: Unit, top: int, left: int, bottom: int, right: int) -> bool:
    depth = unit.level or LEVELS
    return top <= unit.row << depth < bottom and left <= unit.column << depth < right
