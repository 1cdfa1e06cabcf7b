"""Sums of planes of a body in units from top to bottom, row of precincts by row, with no unit decoded twice.

What a row's transform looks at of the rows above it and below (`MARGIN` of `clrelight.codec.entropy.units`) is kept as
wavelet coefficients: of sums that is little, while planes of as many rows would not fit into what is usually there.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight import recycling
from clrelight.codec.entropy.units import LEVELS, PRECINCT, Window
from clrelight.codec.formats.klt_regions import Held, UnitReader, around
from clrelight.codec.transforms.lifting import list_subbands, padded_width, transform_planes
from clrelight.codec.views import Region
from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray

_SMALL_BYTES = 1 << 23
"""Of a region's sums, up to which it is one part: few units are more evenly spread over processors all at once."""


def sums_by_rows(
    reader: UnitReader, region: Region, weight_cj: NDArray[np.float64], sides: tuple[int, int], device: Device
) -> Iterator[Held]:
    """Yield weighted sums of the planes of a region of an image of some height and width, from top to bottom.

    PayloadError where units are damaged, unless they are to be salvaged: then all is one part, as a small region is.
    """
    least = PRECINCT >> region.level
    cuts = [region.top, *range((region.top // least + 1) * least, region.bottom, least), region.bottom]
    rows, columns = around(region, *sides).sides_at(region.level)
    count = len(weight_cj)
    is_small = 4 * count * rows * columns <= _SMALL_BYTES and reader.holds(region, count)
    if len(cuts) == 2 or is_small or not reader.is_cut:
        yield from reader.parts(region, weight_cj)
        return
    held = _Rows(reader, region, np.ascontiguousarray(weight_cj.T, np.float32), sides)
    for top, bottom in itertools.pairwise(cuts):
        part = Region(top, region.left, bottom, region.right, region.level)
        yield held.transformed_back(part, device)


class _Rows:
    """Wavelet coefficients of sums, of the rows of precincts that are being looked at."""

    def __init__(
        self, reader: UnitReader, region: Region, weight_jc: NDArray[np.float32], sides: tuple[int, int]
    ) -> None:
        self._reader, self._level, self._weight_jc, self._sides = reader, region.level, weight_jc, sides
        whole = around(region, *sides)
        self._left, self._right = whole.left, whole.right
        self._units = reader.rows_of(region)
        self._held: dict[int, tuple[Window, NDArray[np.float32]]] = {}

    def transformed_back(self, part: Region, device: Device) -> Held:
        """Return the sums of a part, whose rows lie in one row of precincts."""
        window = around(part, *self._sides)
        rows, columns = window.sides_at(self._level)
        count, pitch = self._weight_jc.shape[1], padded_width(columns)
        values_cyx = recycling.empty((count, rows, pitch), np.float32)
        numbers = range(window.top // PRECINCT, (window.bottom - 1) // PRECINCT + 1)
        for number in [number for number in self._held if number not in numbers]:
            del self._held[number]
        for number in numbers:
            if number not in self._held:
                self._held[number] = self._decoded(number, device)
            self._copy(values_cyx, window, *self._held[number])
        values = device.hold(values_cyx)
        if self._level < LEVELS:
            transform_planes("synthesise", values, columns, LEVELS - self._level, device)
        device.finish()
        top, left = part.top - (window.top >> self._level), part.left - (window.left >> self._level)
        return Held(part, values, top, left)

    def _decoded(self, number: int, device: Device) -> tuple[Window, NDArray[np.float32]]:
        top = number * PRECINCT
        window = Window(top, self._left, min(top + PRECINCT, self._sides[0]), self._right)
        values: DeviceArray = self._reader.row_of(self._units.get(number, []), window, self._level, self._weight_jc)
        return window, device.download(values)

    def _copy(self, to_cyx: NDArray[np.float32], to: Window, source: Window, from_cyx: NDArray[np.float32]) -> None:
        """Copy what a window has of each subband of another; both have the same columns."""
        levels = LEVELS - self._level
        found = {(band.name, band.level): band for band in list_subbands(*source.sides_at(self._level), levels)}
        for band in list_subbands(*to.sides_at(self._level), levels):
            given = found.get((band.name, band.level))
            if given is None:
                continue
            depth = band.level + self._level
            offset = (source.top >> depth) - (to.top >> depth)
            first, end = max(offset, 0), min(offset + given.shape[0], band.shape[0])
            if first < end:
                begin, ours = given.rows.start - offset, band.rows.start
                to_cyx[:, ours + first : ours + end, band.columns] = from_cyx[
                    :, begin + first : begin + end, given.columns
                ]
