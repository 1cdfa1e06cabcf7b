"""Which units of body 4 of the codec `klt` a region hangs on, and how they become its planes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body
from clrelight.codec.entropy.unit_index import Stored
from clrelight.codec.entropy.unit_streams import decode_streams, default_tables
from clrelight.codec.entropy.units import LEVELS, MARGIN, PRECINCT, Unit, Window, lay_out, list_units, low_side
from clrelight.codec.rooms import Shape
from clrelight.codec.transforms.lifting import list_subbands, padded_width, transform_planes
from clrelight.codec.transforms.whitening import with_type
from clrelight.codec.views import Region
from clrelight.device import Device
from clrelight.errors import PayloadError

_AT_ONCE = 1 << 31
"""Bytes of planes that are decoded at once."""
_REACH = 6
"""Samples of a subband beyond a region that its synthesis looks at: half of the next finer, and three, rounded up."""


class UnitReader:
    """Decodes what a region needs.

    Parameters
    ----------
    body : Body
        Bytes, or what is read when sliced: only units of the region are.
    stored : Stored
        Where its streams lie.
    shape : tuple of int
        (n_coeff, height, width, channel).
    device : Device
    """

    def __init__(self, body: Body, stored: Stored, shape: Shape, device: Device) -> None:
        self._body, self._stored, self._shape, self._device = body, stored, shape, device
        self._units = list_units(shape[1], shape[2])

    @property
    def whole(self) -> Region:
        """The image."""
        return Region(0, 0, *self._shape[1:3])

    def planes(self, region: Region) -> NDArray[np.float32]:
        """Return the planes of a region in steps, (n_plane, height, width); PayloadError where units are damaged."""
        return self._synthesised(region, None)

    def sums(self, region: Region, weight_cj: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return weighted sums of the planes of a region, (n_sum, height, width), float32."""
        return self._synthesised(region, np.ascontiguousarray(weight_cj.T, np.float32))

    def _synthesised(self, region: Region, weight_jc: NDArray[np.float32] | None) -> NDArray[np.float32]:
        """Decode the units of a region, and transform their planes or sums back; part by part where they are many."""
        level = region.level
        if (halves := self._halves(region)) is not None:
            parts = [self._synthesised(half, weight_jc) for half in halves]
            return np.concatenate(parts, axis=1 if halves[0].shape[1] == region.shape[1] else 2)
        decoded, rooms = self._decode(region, weight_jc)
        window = _around(region, *self._shape[1:3])
        values = self._device.hold(_crop(decoded, rooms, window, level))
        width = low_side(window.right, level) - (window.left >> level)
        if values.dtype == np.int32:
            count, *sides = values.shape
            self._device.launch("codec/units_decode.cl", "value_indices", (*sides[::-1], count), values, *values.shape)
            values = with_type(values, np.float32)
        if level < LEVELS:
            transform_planes("synthesise", values, width, LEVELS - level, self._device)
        found = self._device.download(values)
        top, left = region.top - (window.top >> level), region.left - (window.left >> level)
        part = found[:, top : top + region.shape[0], left : left + region.shape[1]]
        # Every level of the transform doubles what is even: an image at a level is a mean.
        return np.ascontiguousarray(part) if not level else part * np.float32(0.5**level)

    def _halves(self, region: Region) -> tuple[Region, Region] | None:
        """Return two parts of a region whose planes of all levels, and of what lies around, a device may not hold."""
        top, left, bottom, right = region.top, region.left, region.bottom, region.right
        level, least = region.level, PRECINCT >> region.level
        sides = [(side << level) + 2 * PRECINCT for side in region.shape]
        count = max(self._stored.n_plane, 1)
        fits = 4 * count * sides[0] * sides[1] <= min(_AT_ONCE, self._device.info.memory_bytes // 4)
        if fits or self._stored.together or max(region.shape) <= least:
            return None
        if region.shape[0] >= region.shape[1]:
            middle = (top + bottom) // 2 // least * least
            middle = middle if top < middle < bottom else top + least
            return Region(top, left, middle, right, level), Region(middle, left, bottom, right, level)
        middle = (left + right) // 2 // least * least
        middle = middle if left < middle < right else left + least
        return Region(top, left, bottom, middle, level), Region(top, middle, bottom, right, level)

    def _decode(self, region: Region, weight_jc: NDArray[np.float32] | None) -> tuple[NDArray, Window]:
        """Return indices, or sums, in a window of whole units; what the region needs is in them."""
        _, height, width, _ = self._shape
        count = self._stored.n_plane
        together = self._stored.together
        chosen = list(range(len(self._units))) if together else self._needed(region)
        units = [self._units[t] for t in chosen]
        window = Window(0, 0, height, width) if together else _cover(units, height, width)
        pitch = padded_width(window.shape[1])
        layout = lay_out(units, (height, width), window, pitch, together, self._stored.groups)
        numbers = self._stored.numbers(self._units, chosen)
        streams = [self._stored.read(self._body, t) for t in numbers]
        # Memory that is not there before something is written to it.
        index = self._device.hold(np.zeros((count, window.shape[0], pitch), np.int32))
        sums = None
        if weight_jc is not None:
            sums = self._device.hold(np.zeros((weight_jc.shape[1], window.shape[0], pitch), np.float32))
        coarse_jl = self._stored.coarse_jl
        fault_t = decode_streams(self._device, layout, streams, default_tables(), index, sums, weight_jc, coarse_jl)
        if fault_t.any():
            number = numbers[int(np.argmax(fault_t))]
            raise PayloadError(f"unit {number} of the {self._stored.name} body cannot be decoded")
        return self._device.download(index if sums is None else sums), window

    def _needed(self, region: Region) -> list[int]:
        """Return the numbers of the units that a region's samples hang on."""
        _, height, width, _ = self._shape
        scale = region.level
        top, left = region.top << scale, region.left << scale
        bottom, right = min(region.bottom << scale, height), min(region.right << scale, width)
        chosen = []
        for t, unit in enumerate(self._units):
            depth = unit.level or LEVELS
            if unit.level and unit.level <= scale:
                continue
            rows = ((top >> depth) - _REACH, (bottom >> depth) + _REACH)
            columns = ((left >> depth) - _REACH, (right >> depth) + _REACH)
            if _meets(unit.row, unit.side, rows) and _meets(unit.column, unit.side, columns):
                chosen.append(t)
        return chosen


def _meets(first: int, count: int, span: tuple[int, int]) -> bool:
    return first < span[1] and first + count > span[0]


def _cover(units: list[Unit], height: int, width: int) -> Window:
    """Return the window of whole precincts in which units lie."""
    rows = [side << (u.level or LEVELS) for u in units for side in (u.row, u.row + u.side)]
    columns = [side << (u.level or LEVELS) for u in units for side in (u.column, u.column + u.side)]
    bottom, right = (-(-max(sides) // PRECINCT) * PRECINCT for sides in (rows, columns))
    top, left = (min(sides) // PRECINCT * PRECINCT for sides in (rows, columns))
    return Window(top, left, min(bottom, height), min(right, width))


def _around(region: Region, height: int, width: int) -> Window:
    """Return the pixels that a region's transform looks at."""
    least = 1 << LEVELS
    top, left = (max((side << region.level) - MARGIN, 0) // least * least for side in (region.top, region.left))
    bottom = min(-(-((region.bottom << region.level) + MARGIN) // least) * least, height)
    right = min(-(-((region.right << region.level) + MARGIN) // least) * least, width)
    return Window(top, left, bottom, right)


def _crop(decoded: NDArray, held: Window, wanted: Window, level: int) -> NDArray:
    """Return the subbands of a window from those of another, down to a level; zeros where there are none."""
    if held == wanted and level == 0:
        return decoded
    height = low_side(wanted.bottom, level) - (wanted.top >> level)
    width = low_side(wanted.right, level) - (wanted.left >> level)
    result = np.zeros((len(decoded), height, padded_width(width)), decoded.dtype)
    source = {(band.name, band.level): band for band in list_subbands(*held.shape, LEVELS)}
    for band in list_subbands(height, width, LEVELS - level):
        depth = band.level + level
        found = source.get((band.name, depth))
        if found is None:
            continue
        from_rows, to_rows = _overlap(found.rows, held.top >> depth, band.rows, wanted.top >> depth)
        from_columns, to_columns = _overlap(found.columns, held.left >> depth, band.columns, wanted.left >> depth)
        result[:, to_rows, to_columns] = decoded[:, from_rows, from_columns]
    return result


def _overlap(held: slice, held_first: int, wanted: slice, wanted_first: int) -> tuple[slice, slice]:
    """Return which part of one range is which part of another, both beginning at numbers of one count."""
    first = max(held_first, wanted_first)
    end = min(held_first + held.stop - held.start, wanted_first + wanted.stop - wanted.start)
    count = max(end - first, 0)
    start, place = held.start + first - held_first, wanted.start + first - wanted_first
    return slice(start, start + count), slice(place, place + count)
