"""How the values of pixels become planes: what a source gives, the curve they are coded behind, and one matrix."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight import recycling
from clrelight.codec.slabs import SLAB_BYTES
from clrelight.codec.streams import Linear, Source
from clrelight.codec.transforms.code_values import bend, code_values_of, node_matrices
from clrelight.codec.transforms.lifting import padded_width, split_planes
from clrelight.codec.transforms.map_planes import has_tile, planes_of_map
from clrelight.codec.transforms.whitening import Planes, reshaped
from clrelight.device import Device
from clrelight.matmul import PackedOperator, SampleCurve, apply_operator, pack_operator, sample_defines
from clrelight.memory import PIECE_BYTES
from clrelight.opencl.arguments import DeviceArray
from clrelight.streaming import Buffer
from clrelight.tiles import Span

_DEPTH = 64
_WHOLE = 1 << 31
"""Bytes of coefficients up to which kernels read them where they lie: drivers have bounds for an array."""
_ROWS = 32
"""That are taken together where it makes no difference to reading."""


class Pixels:
    """A source whose coefficients are coded as they are, or as those of sRGB code values.

    Between the two lie as few products as there can be: where coefficients are linear in what is read, they are never
    made. With a curve, radiance is evaluated at nodes (`code_values_of`), bent, and goes to planes from there.

    Parameters
    ----------
    source : Source
    transfer : str
        ``"linear"``, or ``"srgb"``: the coefficients of code values are coded.
    """

    def __init__(self, source: Source, transfer: str = "linear") -> None:
        self.shape, self.device, self.transfer, self.basis = source.shape, source.device, transfer, source.basis
        self._source, self.elsewhere, self.lights_i3 = source, source.elsewhere, source.lights_i3
        self._buffers: dict[str, Buffer] = defaultdict(Buffer)
        self._arrays: dict[str, DeviceArray] = {}  # where a device has memory of its own
        self._way: tuple[NDArray[np.float64], _Way] | None = None

    def coefficients(self, rows: Span, columns: Span) -> NDArray[np.float32]:
        """Return what is coded, (n_coeff, rows, columns, channel); the next call may overwrite it."""
        return self._coded(self._read(rows, columns))

    def of_places(self, places: Sequence[tuple[int, slice]]) -> NDArray[np.float32]:
        """Return the same of some pixels of some rows, (n_coeff, pixels, channel)."""
        return self._coded(self._source.read_scattered(places))[:, 0]

    def _coded(self, coeffs_khwc: NDArray[np.float32]) -> NDArray[np.float32]:
        if self.transfer == "srgb":
            return code_values_of(np.ascontiguousarray(coeffs_khwc), self.device, self.basis)
        return coeffs_khwc

    def planes(self, rows: Span, columns: Span, planes: Planes, *, lent: bool = False) -> DeviceArray:
        """Queue and return planes of a part of the image, (n_plane, height, padded width), in the order of the matrix.

        Where they are `lent`, the next that are lie in the same memory. The device may be computing them still, while
        the caller reads what the next are made of.
        """
        shape = (len(planes[1]), rows[1] - rows[0], padded_width(columns[1] - columns[0]))
        made = self.lend("planes", shape) if lent else self.device.empty(shape, np.float32)
        self.fill(made, rows, columns, planes)
        return made

    def fill(self, made: DeviceArray, rows: Span, columns: Span, planes: Planes, at: int = 0) -> None:
        """Queue planes of a part of the image, into the rows of `made` from `at` on."""
        way = self._way_to(planes)
        if way.fused is not None:
            way.fused.run(made, self._source, rows, columns, at)
            return
        if (whole := self._in_place()) is not None and has_tile(self.device, way.n_value):
            planes_of_map(made, whole, way.last, way.offset, rows, columns, at, self.device)
            return
        width, linear = columns[1] - columns[0], self._source.linear
        row_bytes = 4 * width * (2 * way.n_value + made.shape[0])
        step, curve = max(SLAB_BYTES // row_bytes, 1), SampleCurve() if linear is None else linear.curve
        for top in range(*rows, step):
            piece, at_row = (top, min(top + step, rows[1])), at + top - rows[0]
            held = self._read(piece, columns) if linear is None else self._source.read_samples(piece, columns)
            values = self._values(held if held.flags.c_contiguous else recycling.copied(held), way.first, curve)
            split = self.lend("split", (values.shape[0] * self.shape[3], held.shape[1], made.shape[2]))
            split_planes(reshaped(values, (values.shape[0], held.shape[1], width, self.shape[3])), split, self.device)
            self._place(made, split, width, way, at_row)

    def _in_place(self) -> DeviceArray | None:
        """Return coefficients in memory that kernels read as they are, where that is all there is to it."""
        held, device = self._source.in_memory, self.device
        if held is None or self.transfer == "srgb" or not (device.style == "cpu" and device.shares_memory):
            return None
        return device.upload(held) if held.nbytes <= min(_WHOLE, device.info.memory_bytes // 4) else None

    def rows_at_once(self, columns: Span, planes: Planes) -> int:
        """Return the rows of a part of the image that are read together."""
        fused = self._way_to(planes).fused
        return _ROWS if fused is None else fused.rows_at_once(columns[1] - columns[0], self.shape[3])

    def _way_to(self, planes: Planes) -> _Way:
        """Return what leads to planes; kept for the next part of the same ones."""
        if self._way is None or self._way[0] is not planes[0]:
            self._way = planes[0], _Way.of(self._source, self.transfer, planes)
        return self._way[1]

    def _read(self, rows: Span, columns: Span) -> NDArray[np.float32]:
        coeffs_khwc = self._source.read_part(rows, columns)
        self._source.check(coeffs_khwc, rows[0])
        return coeffs_khwc

    def _values(self, held: NDArray, first: PackedOperator | None, curve: SampleCurve) -> DeviceArray:
        """Queue what the last matrix is applied to, of each channel: (n, pixels of all channels)."""
        source = self.device.upload(held.reshape(len(held), -1))
        if first is None:
            return source
        values = self.lend("values", (first.shape[0], source.shape[1]))
        apply_operator(self.device, first, source, values, curve=curve)
        if self.transfer == "srgb":
            bend(values, self.device, decode=False)
        return values

    def _place(self, made: DeviceArray, split: DeviceArray, width: int, way: _Way, first_row: int) -> None:
        """Queue the planes of some rows of channels, and wait: what they are made of is read into again."""
        device, (count, _, pitch) = self.device, made.shape
        n_value, height, flat = split.shape[0], split.shape[1], split.shape[1] * pitch
        part = self.lend("part", (count, flat))
        apply_operator(device, way.last, reshaped(split, (n_value, flat)), part)
        device.launch(
            "codec/units_encode.cl",
            "place_planes",
            (height, count),
            *(made, part, way.offset, first_row, flat, *made.shape[1:], width),
        )
        device.finish()

    def lend(self, name: str, shape: tuple[int, ...]) -> DeviceArray:
        """Return memory under a name, the same for all that ask: what is new costs a page fault for every 4 KiB."""
        if self.device.shares_memory:
            return self.device.empty(shape, np.float32, self._buffers[name].lend(shape, np.float32))
        size, held = math.prod(shape), self._arrays.get(name)
        if held is None or held.shape[0] < size:
            held = self._arrays[name] = self.device.empty((size,), np.float32)
        return replace(held, shape=shape)

    def forget(self) -> None:
        """Let go of what was lent, for work that needs little of it."""
        self._buffers.clear()
        self._arrays.clear()


class _Chain:
    """The matrices between what is read and the planes.

    Attributes
    ----------
    first : ndarray, shape (n, n_read), float64, or None
        From what is read to what is bent, or to components; None where that is what is read.
    last : ndarray, shape (n_plane, n, channel), float64
    bends : bool
        Whether the curve lies between the two.
    """

    def __init__(self, linear: Linear | None, basis: str, transfer: str, operator_jkc: NDArray[np.float64]) -> None:
        fitted = None if linear is None else (linear.synthesis_kr, linear.analysis_ri)
        self.bends = transfer == "srgb"
        if self.bends:
            synthesis_nk, analysis_kn = node_matrices(operator_jkc.shape[1], basis)
            self.first: NDArray[np.float64] | None = synthesis_nk
            if fitted is not None:
                self.first = (synthesis_nk @ fitted[0]) @ fitted[1]
            self.last = np.einsum("jkc,kn->jnc", operator_jkc, analysis_kn, optimize=True)
        elif fitted is not None:
            self.first = fitted[1]
            self.last = np.einsum("jkc,kr->jrc", operator_jkc, fitted[0], optimize=True)
        else:
            self.first, self.last = None, operator_jkc


@dataclass(frozen=True)
class _Way:
    """The matrices of planes on a device: all in one kernel, or one after another."""

    n_value: int
    first: PackedOperator | None
    last: PackedOperator
    offset: DeviceArray
    fused: _Fused | None

    @classmethod
    def of(cls, source: Source, transfer: str, planes: Planes) -> _Way:
        """Return what leads from a source to planes."""
        (operator_jq, offset_j), device, linear = planes, source.device, source.linear
        n_coeff, channel = source.shape[0], source.shape[3]
        chain = _Chain(linear, source.basis, transfer, operator_jq.reshape(-1, n_coeff, channel))
        return cls(
            chain.last.shape[1] * channel,
            None if chain.first is None else pack_operator(device, chain.first),
            pack_operator(device, chain.last.reshape(len(offset_j), -1)),
            device.upload(offset_j.astype(np.float32)),
            None if linear is None else _Fused.of(chain, linear, source.sample_type, offset_j, device),
        )


@dataclass(frozen=True)
class _Fused:
    """One kernel from samples to planes, whose values on their way stay in a CPU's cache."""

    first: PackedOperator
    last: PackedOperator
    table: DeviceArray
    offset: DeviceArray
    linear: Linear
    sample_type: np.dtype
    device: Device
    tile: int
    room: int
    """Values of a pixel that there is memory for: as many as there can be, lest each number of them has its program."""
    bends: bool

    @classmethod
    def of(
        cls, chain: _Chain, linear: Linear, dtype: np.dtype, offset_j: NDArray[np.float64], device: Device
    ) -> _Fused | None:
        """Return the kernel for a chain; None where a device or a type has none, or no tile is small enough."""
        if device.style != "cpu" or not np.issubdtype(dtype, np.integer) or chain.first is None:
            return None
        values = math.prod(chain.last.shape[1:])
        least = 2 * device.info.lanes
        for tile in (256, 128, 64, 32, 16, 8):
            room = device.info.local_memory_bytes // (2 * 4 * tile) - _chunk(linear) - 8
            if tile >= least and room >= values:
                last_jcn = np.ascontiguousarray(chain.last.transpose(0, 2, 1)).reshape(len(chain.last), -1)
                packed = pack_operator(device, chain.first), pack_operator(device, last_jcn)
                table, offset = device.upload(linear.curve.table(dtype)), device.upload(offset_j.astype(np.float32))
                return cls(*packed, table, offset, linear, dtype, device, tile, room, chain.bends)
        return None

    def rows_at_once(self, width: int, channel: int) -> int:
        """Return the rows that are read while the device computes those before."""
        return max(PIECE_BYTES // (self.first.shape[1] * width * channel * self.sample_type.itemsize), 1)

    def run(self, made: DeviceArray, source: Source, rows: Span, columns: Span, at: int) -> None:
        """Queue planes; the next samples are read while the device computes."""
        device, curve, channel = self.device, self.linear.curve, source.shape[3]
        width = columns[1] - columns[0]
        heights = [operator.heights_b for operator in (self.first, self.last) if operator.heights_b is not None]
        step = self.rows_at_once(width, channel)
        for top in range(*rows, step):
            piece = (top, min(top + step, rows[1]))
            samples = source.read_samples(piece, columns)
            device.finish()  # what was held is read no more
            held = samples
            device.launch(
                "codec/planes.cl",
                "make_planes_jyx",
                (-(-width // self.tile), piece[1] - piece[0]),
                *(made, device.upload(held), self.first.packed_o, heights[0], self.last.packed_o, heights[1]),
                *(self.table, self.offset, 1.0 / curve.peak, at + top - rows[0], self.first.shape[0], *made.shape),
                *(*held.shape, heights[0].shape[0], heights[1].shape[0]),
                defines={
                    **sample_defines(self.sample_type),
                    "VECTOR": device.info.lanes,
                    "TILE": self.tile,
                    "CHUNK": _chunk(self.linear),
                    "DEPTH": _DEPTH,
                    "CURVE": curve.mode(self.sample_type),
                    "BEND": int(self.bends),
                    "ROOM": self.room,
                },
            )


def _chunk(linear: Linear) -> int:
    """Return the lights whose samples a tile holds at once."""
    return min(-(-linear.analysis_ri.shape[1] // _DEPTH), 4) * _DEPTH
