"""How body 4 of the codec `klt` becomes planes, coefficients or images: all of it, or a part, at any level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.unit_streams import decode_streams, default_tables
from clrelight.codec.entropy.units import (
    LEVELS,
    MARGIN,
    PRECINCT,
    Unit,
    Window,
    lay_out,
    list_units,
    tile_sides,
)
from clrelight.codec.formats.klt_units import Parsed, Shape, is_together, read_stream
from clrelight.codec.streams import Body, Target
from clrelight.codec.transforms.code_values import radiance_of
from clrelight.codec.transforms.lifting import join_channels, list_subbands, padded_width, transform_planes
from clrelight.codec.transforms.whitening import reshaped
from clrelight.conventions import srgb_to_linear
from clrelight.device import Device
from clrelight.errors import PayloadError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degree_of
from clrelight.matmul import apply_operator, multiply_columns, pack_operator
from clrelight.opencl.arguments import DeviceArray

_REACH = 6
"""Samples of a subband beyond a region that its synthesis looks at: half of the next finer, and three, rounded up."""
_PIECE_BYTES = 1 << 26


@dataclass(frozen=True)
class Region:
    """A part of an image at a level: rows and columns, from the first to the one before the end, in pixels there."""

    top: int
    left: int
    bottom: int
    right: int
    level: int = 0

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.bottom - self.top, self.right - self.left


def size_at(side: int, level: int) -> int:
    """Return the pixels of a side of an image at a level."""
    return -(-side >> level)


class UnitReader:
    """Decodes what a region needs.

    Parameters
    ----------
    body : Body
        Bytes, or what is read when sliced: only units of the region are.
    parsed : Parsed
    shape : tuple of int
        (n_coeff, height, width, channel).
    device : Device
    """

    def __init__(self, body: Body, parsed: Parsed, shape: Shape, device: Device) -> None:
        self._body, self._parsed, self._shape, self._device = body, parsed, shape, device
        self._units = list_units(shape[1], shape[2])

    @property
    def whole(self) -> Region:
        """The image."""
        return Region(0, 0, *self._shape[1:3])

    def planes(self, region: Region) -> NDArray[np.float32]:
        """Return the planes of a region in steps, (n_plane, height, width), float32; PayloadError if units are damaged."""
        return self._synthesised(region, None)

    def sums(self, region: Region, weight_cj: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return weighted sums of the planes of a region, (n_sum, height, width), float32."""
        return self._synthesised(region, np.ascontiguousarray(weight_cj.T, np.float32))

    def _synthesised(self, region: Region, weight_jc: NDArray[np.float32] | None) -> NDArray[np.float32]:
        """Decode the units of a region, and transform their planes or sums back."""
        level = region.level
        decoded, rooms = self._decode(region, weight_jc)
        window = _around(region, *self._shape[1:3])
        values_jyx = _crop(decoded, rooms, window, level)
        count, height, pitch = values_jyx.shape
        width = size_at(window.right, level) - (window.left >> level)
        values = self._device.empty(values_jyx.shape, np.float32, values_jyx)
        if values.host is None:
            values = self._device.upload(values_jyx)
        if LEVELS > level:
            transform_planes("synthesise", values, width, LEVELS - level, self._device)
        found = self._device.download(values)
        top, left = region.top - (window.top >> level), region.left - (window.left >> level)
        part = found[:, top : top + region.shape[0], left : left + region.shape[1]]
        # Every level of the transform doubles what is even: an image at a level is a mean.
        return np.ascontiguousarray(part) if not level else part * np.float32(0.5**level)

    def _decode(self, region: Region, weight_jc: NDArray[np.float32] | None) -> tuple[NDArray[np.float32], Window]:
        """Return wavelet coefficients of a window of whole units; what the region needs is in them."""
        _, height, width, _ = self._shape
        count = self._parsed.head.n_plane
        together = is_together(self._shape)
        chosen = list(range(len(self._units))) if together else self._needed(region)
        units = [self._units[t] for t in chosen]
        window = Window(0, 0, height, width) if together else _cover(units, height, width)
        pitch = padded_width(window.shape[1])
        layout = lay_out(units, height, width, window, pitch, together)
        streams = [read_stream(self._body, self._parsed, t) for t in ([0] if together else chosen)]
        index = self._device.empty((count, window.shape[0], pitch), np.int32, *self._zeros(count, window, pitch, np.int32))
        sums = None
        if weight_jc is not None:
            n_sum = weight_jc.shape[1]
            sums = self._device.empty(
                (n_sum, window.shape[0], pitch), np.float32, *self._zeros(n_sum, window, pitch, np.float32)
            )
        fault_t = decode_streams(self._device, layout, streams, default_tables(), index, count, sums, weight_jc)
        if fault_t.any():
            raise PayloadError(f"unit {chosen[int(np.argmax(fault_t))]} of the klt body cannot be decoded")
        if sums is not None:
            return self._device.download(sums), window
        self._device.launch(
            "codec/units_decode.cl", "value_indices", (pitch, window.shape[0], count), index, *index.shape
        )
        return self._device.download(index).view(np.float32), window

    def _zeros(self, count: int, window: Window, pitch: int, dtype: type) -> list[NDArray]:
        return [np.zeros((count, window.shape[0], pitch), dtype)] if self._device.shares_memory else []

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
    spans = [(u.row << d, u.column << d, (u.row + u.side) << d, (u.column + u.side) << d) for u in units for d in [u.level or LEVELS]]
    top, left, bottom, right = (f(s) for f, s in zip((min, min, max, max), zip(*spans, strict=True), strict=True))
    down = [side // PRECINCT * PRECINCT for side in (top, left)]
    up = [-(-side // PRECINCT) * PRECINCT for side in (bottom, right)]
    return Window(down[0], down[1], min(up[0], height), min(up[1], width))


def _around(region: Region, height: int, width: int) -> Window:
    """Return the pixels that a region's transform looks at."""
    least = 1 << LEVELS
    top, left = (max((side << region.level) - MARGIN, 0) // least * least for side in (region.top, region.left))
    bottom = min(-(-((region.bottom << region.level) + MARGIN) // least) * least, height)
    right = min(-(-((region.right << region.level) + MARGIN) // least) * least, width)
    return Window(top, left, bottom, right)


def _crop(decoded: NDArray[np.float32], held: Window, wanted: Window, level: int) -> NDArray[np.float32]:
    """Return the subbands of a smaller window from those of a larger one, down to a level."""
    if held == wanted and level == 0:
        return decoded
    height, width = (size_at(end, level) - (first >> level) for first, end in ((wanted.top, wanted.bottom), (wanted.left, wanted.right)))
    result = np.zeros((len(decoded), height, padded_width(width)), np.float32)
    source = {(b.name, b.level): b for b in list_subbands(*held.shape, LEVELS)}
    for band in list_subbands(height, width, LEVELS - level):
        depth = band.level + level
        found = source.get((band.name, depth))
        if found is None:
            continue
        y = found.rows.start + (wanted.top >> depth) - (held.top >> depth)
        x = found.columns.start + (wanted.left >> depth) - (held.left >> depth)
        rows, columns = band.shape
        top, left = max((held.top >> depth) - (wanted.top >> depth), 0), max((held.left >> depth) - (wanted.left >> depth), 0)
        rows = min(rows, found.rows.stop - y) - top
        columns = min(columns, found.columns.stop - x) - left
        if rows <= 0 or columns <= 0:
            continue
        to_y, to_x = band.rows.start + top, band.columns.start + left
        result[:, to_y : to_y + rows, to_x : to_x + columns] = decoded[:, y + top : y + top + rows, x + left : x + left + columns]
    return result


def decode_rows(body: Body, parsed: Parsed, target: Target, device: Device, memory: int) -> None:
    """Put the coefficients of a body, strip by strip where planes of all of it pass a number of bytes."""
    maker = _Maker(parsed, target.shape, device)
    strips = _Strips(UnitReader(body, parsed, target.shape, device), target.shape, parsed.head.n_plane, memory)
    for part in target.row_parts():
        target.put_rows(part.start, maker.coefficients(strips.rows(part.start, part.stop)))


def decode_region(body: Body, parsed: Parsed, shape: Shape, region: Region, device: Device) -> NDArray[np.float32]:
    """Return the coefficients of a part of an image, at a level; only units that it hangs on are read."""
    reader = UnitReader(body, parsed, shape, device)
    return _Maker(parsed, shape, device).coefficients(_planes_of(reader, region, parsed.head.n_plane))


def _planes_of(reader: UnitReader, region: Region, count: int) -> NDArray[np.float32]:
    return reader.planes(region) if count else np.zeros((0, *region.shape), np.float32)


class _Maker:
    """Makes coefficients of planes."""

    def __init__(self, parsed: Parsed, shape: Shape, device: Device) -> None:
        self._device, self._transfer = device, parsed.head.transfer
        self._n_coeff, self._channel = shape[0], shape[3]
        n_value = self._n_coeff * self._channel
        self._packed = pack_operator(device, parsed.operator_kcj.reshape(n_value, -1))

    def coefficients(self, planes_jyx: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return coefficients (n_coeff, height, width, channel) of planes in steps, (n_plane, height, width)."""
        count, height, width = planes_jyx.shape
        coeffs_khwc = np.empty((self._n_coeff, height, width, self._channel), np.float32)
        n_value, pitch = self._n_coeff * self._channel, padded_width(width)
        step = max(_PIECE_BYTES // (4 * pitch * (2 * n_value + count)), 1)
        for first in range(0, height, step):
            rows = slice(first, min(first + step, height))
            size = rows.stop - first
            source = np.ones((count + 1, size, pitch), np.float32)
            source[:count, :, :width] = planes_jyx[:, rows]
            made = self._device.empty((n_value, size * pitch), np.float32)
            apply_operator(self._device, self._packed, self._device.upload(source.reshape(count + 1, -1)), made)
            part_shape = (self._n_coeff, size, width, self._channel)
            part = join_channels(
                reshaped(made, (n_value, size, pitch)), part_shape, np.ones(self._n_coeff, np.float32), self._device
            )
            if self._transfer == "srgb":
                part = radiance_of(part, self._device)
            coeffs_khwc[:, rows] = part
        return coeffs_khwc


class _Strips:
    """Planes of rows, decoded strip by strip."""

    def __init__(self, reader: UnitReader, shape: Shape, count: int, memory: int) -> None:
        self._reader, self._count = reader, count
        _, self._height, self._width, _ = shape
        # What is decoded, what of it is transformed back, and the planes of the strip.
        self._step, self._columns = tile_sides(self._height, self._width, count, memory // 3)
        self._first, self._held = 0, np.zeros((count, 0, self._width), np.float32)

    def rows(self, first: int, end: int) -> NDArray[np.float32]:
        """Return the planes of some rows; they are asked for from top to bottom."""
        found = []
        while first < end:
            if not self._first <= first < self._first + self._held.shape[1]:
                self._first = first // self._step * self._step
                bottom = min(self._first + self._step, self._height)
                self._held = np.zeros((self._count, 0, self._width), np.float32)  # its memory goes first
                self._held = self._decode(self._first, bottom)
            last = min(end, self._first + self._held.shape[1])
            found.append(self._held[:, first - self._first : last - self._first])
            first = last
        return found[0] if len(found) == 1 else np.concatenate(found, axis=1)


    def _decode(self, top: int, bottom: int) -> NDArray[np.float32]:
        if self._columns >= self._width:
            return _planes_of(self._reader, Region(top, 0, bottom, self._width), self._count)
        planes_jyx = np.empty((self._count, bottom - top, self._width), np.float32)
        for left in range(0, self._width, self._columns):
            right = min(left + self._columns, self._width)
            planes_jyx[:, :, left:right] = _planes_of(self._reader, Region(top, left, bottom, right), self._count)
        return planes_jyx


def bytes_at_once(shape: Shape, count: int) -> int:
    """Return about the bytes that planes take at the least while a body is decoded."""
    _, height, width, _ = shape
    side = PRECINCT + 2 * MARGIN
    return 4 * count * (min(height, PRECINCT) * width + 2 * min(height, side) * min(width, side))


class UnitView:
    """A body that is relit without its coefficients: light by light, only sums of planes are transformed back.

    See `clrelight.codec.registry.View`. Behind a curve, the code values that the body holds are evaluated at a light, and
    become radiance then.
    """

    def __init__(self, body: Body, parsed: Parsed, shape: Shape) -> None:
        self._body, self._parsed, self._shape = body, parsed, shape

    def to_coeffs(self, device: Device) -> NDArray[np.float32]:
        """Return the (n_coeff, height, width, channel) float32 coefficients."""
        return decode_region(self._body, self._parsed, self._shape, Region(0, 0, *self._shape[1:3]), device)

    def relight(self, directions_i3: NDArray[np.float64], device: Device) -> NDArray[np.float32]:
        """Return images (n_light, height, width, channel), float32 linear radiance in units of the peak."""
        return self.relight_region(directions_i3, Region(0, 0, *self._shape[1:3]), device)

    def relight_region(
        self, directions_i3: NDArray[np.float64], region: Region, device: Device
    ) -> NDArray[np.float32]:
        """Return a part of the images at a level."""
        n_coeff, channel, _ = self._parsed.operator_kcj.shape
        basis_ik = evaluate_basis(directions_i3, degree_of(n_coeff))
        operator_mj = np.einsum("ik,kcj->icj", basis_ik, self._parsed.operator_kcj).reshape(len(basis_ik) * channel, -1)
        count = self._parsed.head.n_plane
        sums = np.zeros((len(operator_mj), *region.shape), np.float32)
        if count:
            reader = UnitReader(self._body, self._parsed, self._shape, device)
            sums = self._sums(reader, region, operator_mj[:, :count], device)
        sums += operator_mj[:, count, None, None].astype(np.float32)
        images = sums.reshape(len(basis_ik), channel, *region.shape).transpose(0, 2, 3, 1)
        if self._parsed.head.transfer == "srgb":
            with np.errstate(over="ignore", invalid="ignore"):
                images = np.copysign(srgb_to_linear(np.abs(images), np.float32), images)
        if not np.isfinite(images.min()) or not np.isfinite(images.max()):
            raise PayloadError("the payload relights to values that are not finite: no encoder wrote it")
        return np.ascontiguousarray(images)

    def _sums(
        self, reader: UnitReader, region: Region, operator_mj: NDArray[np.float64], device: Device
    ) -> NDArray[np.float32]:
        """Return sums of planes, by whichever is less work: sums of wavelet coefficients, or planes first."""
        n_sum, count = operator_mj.shape
        if n_sum < count:
            result = np.empty((n_sum, *region.shape), np.float32)
            step = PRECINCT * 2
            for top in range(region.top, region.bottom, step):
                rows = Region(top, region.left, min(top + step, region.bottom), region.right, region.level)
                result[:, top - region.top : rows.bottom - region.top] = reader.sums(rows, operator_mj)
            return result
        planes_jyx = reader.planes(region)
        return multiply_columns(device, operator_mj, planes_jyx.reshape(count, -1)).reshape(n_sum, *region.shape)
