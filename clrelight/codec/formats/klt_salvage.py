"""What is left of a body in units where some of them are damaged.

A unit of HL, LH and HH that is lost leaves zeros, so that its place shows what the coarser level holds; units that know
their parents by it are lost with it. A unit of LL is filled from the samples around it, as smoothly as there is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body
from clrelight.codec.damage import Damage, Lost
from clrelight.codec.entropy.unit_index import Stored
from clrelight.codec.entropy.unit_streams import decode_streams, default_tables
from clrelight.codec.entropy.units import LEVELS, Unit, Window, lay_out, list_units, low_side, place_units, unit_side
from clrelight.codec.transforms.lifting import padded_width
from clrelight.codec.workspace import Shape
from clrelight.device import Device
from clrelight.errors import PayloadError, StoreFormatError
from clrelight.opencl.arguments import DeviceArray


class Salvage:
    """Knows which units of a body are damaged, and what takes their place.

    Parameters
    ----------
    shape : tuple of int
        (n_coeff, height, width, channel).
    stored : Stored
        Where the streams of units lie, each alone.
    damage : Damage
        Told of each unit that is asked for and damaged.
    """

    def __init__(self, shape: Shape, stored: Stored, damage: Damage) -> None:
        self._height, self._width, self._stored, self._damage = shape[1], shape[2], stored, damage
        self._units = list_units(self._height, self._width)
        self._number = {unit: t for t, unit in enumerate(self._units)}
        self._faulty: set[int] = set()
        self._low_jyx: NDArray[np.int32] | None = None

    def keep(self, chosen: Sequence[int], body: Body) -> list[int]:
        """Return those of the units, from coarse to fine, that can be decoded; of all planes, or they are lost."""
        kept, gone = [], set()
        for t in chosen:
            if self._parent(t) in gone:
                gone.add(t)
                continue
            if self._is_whole(t, body):
                kept.append(t)
            else:
                gone.add(t)
                self._tell(t)
        return kept

    def fault(self, numbers: Sequence[int]) -> None:
        """Take note of units that cannot be decoded although their checksums fit."""
        self._faulty.update(numbers)

    def filled(
        self,
        values: DeviceArray,
        window: Window,
        chosen: Sequence[int],
        body: Body,
        device: Device,
        weight_jc: NDArray[np.float32] | None,
    ) -> DeviceArray:
        """Return planes of a window, or sums of them, with what is lost of LL filled."""
        lost = [self._units[t] for t in chosen if not self._units[t].level and t in self._faulty]
        if not lost:
            return values
        if self._low_jyx is None:
            self._low_jyx = self._make_low(body, device)
        values_jyx = device.download(values)
        top, left = window.top >> LEVELS, window.left >> LEVELS
        bottom, right = low_side(window.bottom, LEVELS), low_side(window.right, LEVELS)
        for unit in lost:
            rows = slice(max(unit.row, top), min(unit.row + unit.side, bottom))
            columns = slice(max(unit.column, left), min(unit.column + unit.side, right))
            if rows.start >= rows.stop or columns.start >= columns.stop:
                continue
            low_jyx = self._low_jyx[:, rows, columns].astype(np.float32)
            if weight_jc is not None:
                low_jyx = np.einsum("jyx,jc->cyx", low_jyx, weight_jc)
            values_jyx[:, rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] = low_jyx
        return device.hold(values_jyx)

    def _is_whole(self, t: int, body: Body) -> bool:
        if t in self._faulty:
            return False
        try:
            for stream in self._stored.numbers(self._units, [t]):
                self._stored.read(body, stream)
        except (PayloadError, StoreFormatError):
            self._faulty.add(t)
            return False
        return True

    def _parent(self, t: int) -> int:
        """Return the unit that a unit knows its parents by; -1 where there is none."""
        unit = self._units[t]
        if unit.level in (0, LEVELS):
            return -1
        side = unit_side(unit.level + 1)
        row, column = (place // 2 // side * side for place in (unit.row, unit.column))
        return self._number[Unit(unit.level + 1, row, column)]

    def _tell(self, t: int) -> None:
        unit = self._units[t]
        depth = unit.level or LEVELS
        top, left = unit.row << depth, unit.column << depth
        bottom, right = (place + (unit.side << depth) for place in (top, left))
        self._damage.lost[t] = Lost(unit.level, top, left, min(bottom, self._height), min(right, self._width))

    def _make_low(self, body: Body, device: Device) -> NDArray[np.int32]:
        """Return LL of all planes, with what is lost of it filled."""
        height, width = low_side(self._height, LEVELS), low_side(self._width, LEVELS)
        kept = [t for t, unit in enumerate(self._units) if unit.level == 0 and self._is_whole(t, body)]
        window, sides = Window(0, 0, self._height, self._width), (self._height, self._width)
        stored, count = self._stored, self._stored.n_plane
        while True:
            values = device.hold(np.zeros((count, height, padded_width(width)), np.float32))
            units = [self._units[t] for t in kept]
            if units:
                layout = lay_out(units, sides, window, 1, False, stored.groups)
                places = place_units(units, window, LEVELS)
                streams = [stored.read(body, t) for t in stored.numbers(self._units, kept)]
                known = (count, 1, 1)  # LL is no parent
                fault_t = decode_streams(device, layout, places, streams, default_tables(), values, known)
                if fault_t.any():
                    self._faulty.update(kept[u] for u in layout.part_t4[fault_t != 0, 0])
                    kept = [t for t in kept if t not in self._faulty]
                    continue
            is_known = np.zeros((height, width), np.bool_)
            for unit in units:
                is_known[unit.row : unit.row + unit.side, unit.column : unit.column + unit.side] = True
            return fill_smoothly(device.download(values)[:, :, :width].astype(np.int32), is_known)


def fill_smoothly(planes_jyx: NDArray[np.int32], is_known_yx: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return planes whose unknown samples are each the mean of its neighbours, known ones as they are.

    That is Laplace's equation, with nothing flowing over the edges of the image; zeros where nothing is known.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import splu

    result = planes_jyx.copy()
    if is_known_yx.all():
        return result
    if not is_known_yx.any():
        result[...] = 0
        return result
    number_yx = np.full(is_known_yx.shape, -1)
    number_yx[~is_known_yx] = np.arange(np.count_nonzero(~is_known_yx))
    count = int(number_yx.max()) + 1
    weight_n, known_nj = np.zeros(count), np.zeros((count, len(planes_jyx)))
    rows, columns = [], []
    for axis in (1, 2):
        for first, second in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
            here = (first, slice(None)) if axis == 1 else (slice(None), first)
            there = (second, slice(None)) if axis == 1 else (slice(None), second)
            a, b = number_yx[here], number_yx[there]
            unknown = a >= 0
            np.add.at(weight_n, a[unknown], 1.0)
            rows.append(a[unknown & (b >= 0)])
            columns.append(b[unknown & (b >= 0)])
            beside = unknown & (b < 0)
            np.add.at(known_nj, a[beside], planes_jyx[(slice(None), *there)][:, beside].T)
    row, column = np.concatenate(rows), np.concatenate(columns)
    everyone = np.arange(count)
    matrix = coo_array(
        (
            np.concatenate([weight_n, -np.ones(len(row))]),
            (np.concatenate([everyone, row]), np.concatenate([everyone, column])),
        ),
        shape=(count, count),
    )
    result[:, ~is_known_yx] = np.rint(splu(matrix.tocsc()).solve(known_nj).T).astype(np.int32)
    return result
