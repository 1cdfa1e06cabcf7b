"""Which units of a body a region hangs on, and how they become its planes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight import recycling
from clrelight.codec.bodies import Body
from clrelight.codec.entropy.unit_index import Stored
from clrelight.codec.entropy.unit_streams import decode_streams, default_tables
from clrelight.codec.entropy.units import (
    LEVELS,
    MARGIN,
    PRECINCT,
    Unit,
    Window,
    lay_out,
    list_units,
    low_side,
    place_units,
)
from clrelight.codec.formats.klt_salvage import Salvage
from clrelight.codec.transforms.lifting import padded_width, transform_planes
from clrelight.codec.views import Region
from clrelight.codec.workspace import Shape
from clrelight.codec.zeros import zeros
from clrelight.device import Device
from clrelight.errors import PayloadError
from clrelight.opencl.arguments import DeviceArray

_AT_ONCE = 1 << 31
"""Bytes of planes that are decoded at once."""
_KNOWN_BYTES = 1 << 25
"""Of sizes, up to which rows of precincts are decoded together."""
_REACH = 6
"""Samples of a subband beyond a region that its synthesis looks at: half of the next finer, and three, rounded up."""


@dataclass(frozen=True)
class Held:
    """Planes of a region, or sums of them, in those of a window around it.

    Attributes
    ----------
    region : Region
    values : DeviceArray, shape (n_plane, rows, pitch), float32, or None
        Those of its level, ``2 ** level`` times as large as they are; None where there are no planes.
    top, left : int
        Where the region begins in them.
    """

    region: Region
    values: DeviceArray | None
    top: int = 0
    left: int = 0

    @property
    def scale(self) -> float:
        """What values are to be multiplied with: each level of the transform doubles what is even."""
        return float(0.5**self.region.level)

    def rows(self, first: int, end: int) -> Held:
        """Return some of the image's rows."""
        region = replace(self.region, top=first, bottom=end)
        return replace(self, region=region, top=self.top + first - self.region.top)

    def array(self, device: Device) -> NDArray[np.float32]:
        """Return the planes, (n_plane, height, width); rows may lie apart, and memory may be that of the values."""
        height, width = self.region.shape
        if self.values is None:
            return np.zeros((0, height, width), np.float32)
        part = device.download(self.values)[:, self.top : self.top + height, self.left : self.left + width]
        return part * np.float32(self.scale) if self.region.level else part


def join_parts(parts: Iterable[tuple[Region, NDArray[np.float32]]], region: Region) -> NDArray[np.float32]:
    """Return the values (n, height, width, ...) of a region from those of its parts; of one part alone as they are."""
    joined: NDArray[np.float32] | None = None
    for part, values in parts:
        if part == region:
            return values
        if joined is None:
            joined = recycling.empty((len(values), *region.shape, *values.shape[3:]), np.float32)
        top, left = part.top - region.top, part.left - region.left
        joined[:, top : top + values.shape[1], left : left + values.shape[2]] = values
    assert joined is not None
    return joined


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
    salvage : Salvage, optional
        Lets units be damaged.
    """

    def __init__(
        self, body: Body, stored: Stored, shape: Shape, device: Device, salvage: Salvage | None = None
    ) -> None:
        self._body, self._stored, self._shape, self._device = body, stored, shape, device
        self._salvage = salvage
        self._units = list_units(shape[1], shape[2])

    @property
    def whole(self) -> Region:
        """The image."""
        return Region(0, 0, *self._shape[1:3])

    def parts(self, region: Region, weight_cj: NDArray[np.float64] | None = None) -> Iterator[Held]:
        """Yield the planes of a region in steps, or sums of them times weights; PayloadError where units are damaged.

        Part by part where they are many; one more part may be held while one is made.
        """
        if weight_cj is None and not self._stored.n_plane:
            yield Held(region, None)
            return
        n_values = self._stored.n_plane if weight_cj is None else len(weight_cj)
        if (halves := self._halves(region, n_values)) is not None:
            for half in halves:
                yield from self.parts(half, weight_cj)
            return
        weight_jc = None if weight_cj is None else np.ascontiguousarray(weight_cj.T, np.float32)
        level = region.level
        window = around(region, *self._shape[1:3])
        values = self._decode(region, window, weight_jc)
        if level < LEVELS:
            transform_planes("synthesise", values, window.sides_at(level)[1], LEVELS - level, self._device)
        yield Held(region, values, region.top - (window.top >> level), region.left - (window.left >> level))

    def planes(self, region: Region) -> NDArray[np.float32]:
        """Return the planes of a region, (n_plane, height, width)."""
        found = join_parts(((part.region, part.array(self._device)) for part in self.parts(region)), region)
        return found if found.flags.c_contiguous else recycling.copied(found)

    @property
    def is_cut(self) -> bool:
        """Whether units are streams of their own, none of which may be damaged."""
        return not self._stored.together and self._salvage is None

    def holds(self, region: Region, n_values: int) -> bool:
        """Return whether so many values of a region are one part."""
        return self._halves(region, n_values) is None

    def rows_of(self, region: Region) -> dict[int, list[int]]:
        """Return the units that a region hangs on, by their rows of precincts; they are read next."""
        chosen = self._needed(region)
        self._stored.expect(self._body, self._stored.numbers(self._units, chosen))
        return self._by_rows(chosen)

    def row_of(self, chosen: list[int], window: Window, level: int, weight_jc: NDArray[np.float32]) -> DeviceArray:
        """Return sums of units of one row of precincts, in a window; PayloadError where they are damaged."""
        return self._sound(*self._run([chosen] if chosen else [], window, level, weight_jc))

    def _halves(self, region: Region, n_values: int) -> tuple[Region, Region] | None:
        """Return two parts of a region whose values, and sizes of what lies around, a device may not hold."""
        top, left, bottom, right = region.top, region.left, region.bottom, region.right
        level, least = region.level, PRECINCT >> region.level
        values, known = (
            [(side << level) + 2 * around >> depth for side in region.shape]
            for around, depth in ((MARGIN, level), (PRECINCT, 1))
        )
        needed = 4 * n_values * values[0] * values[1] + self._stored.n_plane * known[0] * known[1]
        fits = needed <= min(_AT_ONCE, self._device.info.memory_bytes // 4)
        if fits or self._stored.together or max(region.shape) <= least:
            return None
        if region.shape[0] >= region.shape[1]:
            middle = (top + bottom) // 2 // least * least
            middle = middle if top < middle < bottom else top + least
            return Region(top, left, middle, right, level), Region(middle, left, bottom, right, level)
        middle = (left + right) // 2 // least * least
        middle = middle if left < middle < right else left + least
        return Region(top, left, bottom, middle, level), Region(top, middle, bottom, right, level)

    def _decode(self, region: Region, window: Window, weight_jc: NDArray[np.float32] | None) -> DeviceArray:
        """Return values of indices, or sums, in a window at the region's level; what the region needs is in them."""
        chosen = list(range(len(self._units))) if self._stored.together else self._needed(region)
        self._stored.expect(self._body, self._stored.numbers(self._units, chosen))
        if self._salvage is None:
            return self._sound(*self._run(self._groups(chosen), window, region.level, weight_jc))
        while True:
            kept = self._salvage.keep(chosen, self._body)
            values, faulty = self._run(self._groups(kept), window, region.level, weight_jc)
            if not faulty:
                return self._salvage.filled(values, window, chosen, self._body, self._device, weight_jc)
            self._salvage.fault([t for t, _ in faulty])

    def _sound(self, values: DeviceArray, faulty: list[tuple[int, int]]) -> DeviceArray:
        if faulty:
            raise PayloadError(f"unit {faulty[0][1]} of the {self._stored.name} body cannot be decoded")
        return values

    def _run(
        self, groups: list[list[int]], window: Window, level: int, weight_jc: NDArray[np.float32] | None
    ) -> tuple[DeviceArray, list[tuple[int, int]]]:
        """Decode units into planes of a window at a level, or sums of them.

        Returns those, and which units fail, each with the number of its stream.
        """
        rows, columns = window.sides_at(level)
        n_values = self._stored.n_plane if weight_jc is None else weight_jc.shape[1]
        values = zeros((n_values, rows, padded_width(columns)), self._device)
        faulty = []
        for group in groups:
            faulty += self._run_group(group, window, level, values, weight_jc)
        return values, faulty

    def _run_group(
        self, chosen: list[int], window: Window, level: int, values: DeviceArray, weight_jc: NDArray[np.float32] | None
    ) -> list[tuple[int, int]]:
        """Decode units that no others hang on, or that hang on no others; return which fail."""
        _, height, width, _ = self._shape
        stored, units = self._stored, [self._units[t] for t in chosen]
        cover = Window(0, 0, height, width) if stored.together else _cover(units, height, width)
        known = (stored.n_plane, low_side(cover.shape[0], 1), low_side(cover.shape[1], 1))
        layout = lay_out(units, (height, width), cover, known[-1], stored.together, stored.groups)
        numbers = stored.numbers(self._units, chosen)
        streams = [stored.read(self._body, t) for t in numbers]
        places, tables = place_units(units, window, level), default_tables()
        fault_t = decode_streams(
            self._device, layout, places, streams, tables, values, known, weight_jc, stored.coarse_jl
        )
        return [(chosen[layout.part_t4[at, 0]], numbers[at]) for at in np.flatnonzero(fault_t)]

    def _groups(self, chosen: list[int]) -> list[list[int]]:
        """Return units apart by rows of precincts, from coarse to fine: what contexts know of others is within one.

        Rows whose sizes are few are together: of the coarsest levels a row has hardly a unit for each processor.
        """
        if self._stored.together or not chosen:
            return [chosen] if chosen else []
        rows = self._by_rows(chosen)
        width = _cover([self._units[t] for t in chosen], *self._shape[1:3]).shape[1]
        sizes = max(self._stored.n_plane * (PRECINCT // 2) * (width // 2), 1)
        numbers, step = sorted(rows), max(_KNOWN_BYTES // sizes, 1)
        together = [numbers[first : first + step] for first in range(0, len(numbers), step)]
        return [sorted(t for number in some for t in rows[number]) for some in together]

    def _by_rows(self, chosen: list[int]) -> dict[int, list[int]]:
        rows: dict[int, list[int]] = {}
        for t in chosen:
            unit = self._units[t]
            rows.setdefault((unit.row << (unit.level or LEVELS)) // PRECINCT, []).append(t)
        return rows

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


def around(region: Region, height: int, width: int) -> Window:
    """Return the pixels that a region's transform looks at."""
    least = 1 << LEVELS
    top, left = (max((side << region.level) - MARGIN, 0) // least * least for side in (region.top, region.left))
    bottom = min(-(-((region.bottom << region.level) + MARGIN) // least) * least, height)
    right = min(-(-((region.right << region.level) + MARGIN) // least) * least, width)
    return Window(top, left, bottom, right)
