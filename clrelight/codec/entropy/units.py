"""Code the indices of wavelet-transformed planes in units that any machine decodes alone, and alike.

A unit is one place of one level and holds HL, LH and HH of all planes there, or LL of all planes; its samples know those
of its parent, one level coarser, and nothing else outside. Units follow each other from coarse to fine. A stream is one
unit, or all of them where a map is small; compiled loops (``units_encode.cl``, ``units_decode.cl``) code streams side by
side. What stands in a stream: docs/bitstream.md.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.errors import PayloadError
from clrelight.opencl.arguments import DeviceArray

LEVELS = 5
PRECINCT = 512
"""Side in pixels of what one unit of the coarsest three levels, four of level 2 and sixteen of level 1 are of."""

# As in units.clh.
NEAR, HINT, SYMBOLS, LOWS = 12, 16, 16, 16
CONTEXTS = 3 * NEAR * HINT + LOWS
FLAGS = 7 * 16 + 2 * 16
ONE = 1 << 14
_WORK_BYTES = 1 << 18
_FIELDS = 19
_MARGIN = 128
"""Pixels around a tile that its transform looks at: 4 (2^LEVELS - 1), and a multiple of 2^LEVELS."""


@dataclass(frozen=True)
class Window:
    """A part of an image whose planes are transformed together, and the tile in it that is coded.

    Attributes
    ----------
    top, left, bottom, right : int
        Pixels of the image; the first two are multiples of ``2 ** LEVELS``.
    """

    top: int
    left: int
    bottom: int
    right: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.bottom - self.top, self.right - self.left


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
        rows, columns = _low_side(height, depth), _low_side(width, depth)
        units += [Unit(level, row, column) for row in range(0, rows, side) for column in range(0, columns, side)]
    return units


def _low_side(side: int, level: int) -> int:
    return -(-side >> level)


def describe_units(units: list[Unit], height: int, width: int, window: Window) -> NDArray[np.int32]:
    """Return how units lie in the planes of a window of an image, (n_unit, 19): see ``units.clh``."""
    fields = np.zeros((len(units), _FIELDS), np.int32)
    fields[:, 10:13] = -1
    pitch = window.shape[1]
    for at, unit in zip(fields, units, strict=True):
        depth = unit.level or LEVELS
        row, column = unit.row - (window.top >> depth), unit.column - (window.left >> depth)
        at[0] = unit.level
        if unit.level == 0:
            at[1] = row * pitch + column
            at[4] = min(unit.side, _low_side(height, depth) - unit.row)
            at[7] = min(unit.side, _low_side(width, depth) - unit.column)
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
    low_row, low_column = _low_side(window.shape[0], level), _low_side(window.shape[1], level)
    low_h, low_w = _low_side(height, level), _low_side(width, level)
    high_h, high_w = _low_side(height, level - 1) - low_h, _low_side(width, level - 1) - low_w
    return [
        (0, low_column, low_h, high_w),
        (low_row, 0, high_h, low_w),
        (low_row, low_column, high_h, high_w),
    ]


@dataclass(frozen=True)
class Tables:
    """What streams start from.

    Attributes
    ----------
    count_ms : ndarray, shape (CONTEXTS, SYMBOLS), uint16
        Symbols of each context, as if they had been seen.
    flag_f2 : ndarray, shape (FLAGS, 2), uint16
        The share of 0 of each flag, in 1 / ONE, and how many flags it is worth.
    """

    count_ms: NDArray[np.uint16]
    flag_f2: NDArray[np.uint16]


@lru_cache(maxsize=1)
def default_tables() -> Tables:
    """Return what is expected of planes of which nothing is known."""
    middle = np.array([0.0, 1.0, *((2 + i % 2) * 2.0 ** (i // 2 - 1) * (1.25 - 0.05 * (i % 2)) for i in range(2, HINT))])
    near = np.append(middle[: NEAR - 1] / 4.0, np.nan)
    hint = middle / 16.0
    mean = np.where(np.isnan(near)[:, None], hint, 0.6 * near[:, None] + 0.4 * hint) * 0.8 + 0.02
    low = np.array([2.0 ** (k if k < 5 else 4) / 6.0 for k in range(LOWS)])
    means = np.concatenate([mean.ravel(), mean.ravel(), mean.ravel(), low])
    ratio = means / (1.0 + means)
    share = (1.0 - ratio)[:, None] * ratio[:, None] ** np.arange(SYMBOLS)
    share[:, -1] = ratio ** (SYMBOLS - 1)
    counts = np.maximum(np.rint(share * 40), 0).astype(np.uint16)
    counts[:, 0] = np.maximum(counts[:, 0], 1)
    flags = np.full((FLAGS, 2), (ONE // 2, 2), np.uint16)
    return Tables(counts, flags)


@dataclass(frozen=True)
class Coded:
    """Streams, and what was measured while they were made.

    Attributes
    ----------
    streams : list of bytes
    error_t : ndarray, shape (n_stream,), float64
        Squared error in squared steps.
    bits_j : ndarray, shape (n_plane,), float64
        About the bits that each plane took.
    symbol_ms, flag_f2 : ndarray, int64
        How often contexts saw symbols, and flags 0 and 1.
    """

    streams: list[bytes]
    error_t: NDArray[np.float64]
    bits_j: NDArray[np.float64]
    symbol_ms: NDArray[np.int64]
    flag_f2: NDArray[np.int64]

    @property
    def size(self) -> int:
        """Bytes of all streams."""
        return sum(map(len, self.streams))


@dataclass(frozen=True)
class Layout:
    """Which units of a window are coded, in which streams.

    Attributes
    ----------
    unit_uf : ndarray, shape (n_unit, 19), int32
        See `describe_units`; from coarse to fine.
    first_t2 : ndarray, shape (n_stream, 2), int32
        First unit of each stream, and the one behind its last.
    """

    unit_uf: NDArray[np.int32]
    first_t2: NDArray[np.int32]

    @cached_property
    def batches(self) -> list[tuple[int, int]]:
        """First and last but one of the streams that need none of each other, in order."""
        level_t = self.unit_uf[self.first_t2[:, 0], 0]
        rank_t = np.where(level_t == 0, LEVELS, level_t)
        starts = [0, *(np.flatnonzero(np.diff(rank_t)) + 1).tolist(), len(rank_t)]
        return list(zip(starts[:-1], starts[1:], strict=True))


def lay_out(units: list[Unit], height: int, width: int, window: Window, together: bool) -> Layout:
    """Return the layout of units, all in one stream or each in its own."""
    count = len(units)
    firsts = [[0, count]] if together else [[u, u + 1] for u in range(count)]
    return Layout(describe_units(units, height, width, window), np.array(firsts, np.int32))


def encode_streams(
    device: Device, layout: Layout, values: DeviceArray, tables: Tables, price: float, index: DeviceArray | None = None
) -> Coded:
    """Encode planes of wavelet coefficients in steps.

    Parameters
    ----------
    device : Device
    layout : Layout
        What of the planes.
    values : DeviceArray, shape (n_plane, height, pitch), float32
        In place as `list_subbands` says.
    tables : Tables
        What streams start from.
    price : float
        Squared steps of error that a bit must save.
    index : DeviceArray, same shape, int32, optional
        Where the chosen indices go.

    Returns
    -------
    Coded
        The streams, the same for the same device.
    """
    n_plane, n_stream = values.shape[0], len(layout.first_t2)
    index = index or device.empty(values.shape, np.int32)
    samples = _samples(layout) * n_plane
    workers = min(4 * device.info.compute_units, max(e - b for b, e in layout.batches))
    room = max(1 << 20, 2 * int(samples.sum()) // 16)
    items = int(samples.max()) * 5 // 4 + (1 << 12)  # samples, and flags of cells and bands
    raws = items // 2
    while True:
        stream, taken = device.empty((room,), np.uint8), np.zeros(1, np.uint32)
        place_t2, error_t = np.zeros((n_stream, 2), np.uint32), np.zeros(n_stream, np.float32)
        bits_tj = np.zeros((n_stream, n_plane), np.float32)
        seen_wn = np.zeros((workers, CONTEXTS * SYMBOLS + 2 * FLAGS), np.uint32)
        held = [device.empty(a.shape, a.dtype, a) for a in (taken, place_t2, error_t, bits_tj, seen_wn)]
        first, unit = device.upload(layout.first_t2), device.upload(layout.unit_uf)
        counts, flags = device.upload(tables.count_ms), device.upload(tables.flag_f2)
        work = device.empty((workers, _WORK_BYTES), np.uint8)
        item, raw = device.empty((workers, items), np.uint32), device.empty((workers, raws), np.uint8)
        for begin, end in layout.batches:
            device.launch(
                "codec/units_encode.cl",
                "encode_units",
                (min(workers, end - begin),),
                *(index, values, stream, *held[:4], first, unit, counts, flags, work, item, raw, held[4]),
                *(price, begin, end, room, items, raws, seen_wn.shape[1], *values.shape),
            )
        taken, place_t2, error_t, bits_tj, seen_wn = (device.download(a) for a in held)
        if not place_t2[:, 1].all():
            raws *= 8
            continue
        if int(taken[0]) > room:
            room = int(taken[0]) + (1 << 16)
            continue
        break
    content = device.download(stream)
    streams = [content[at : at + size].tobytes() for at, size in place_t2.tolist()]
    seen_n = seen_wn.sum(axis=0, dtype=np.int64)
    n_symbol = CONTEXTS * SYMBOLS
    return Coded(
        streams,
        error_t.astype(np.float64),
        bits_tj.sum(axis=0, dtype=np.float64),
        seen_n[:n_symbol].reshape(CONTEXTS, SYMBOLS),
        seen_n[n_symbol:].reshape(FLAGS, 2),
    )


def _samples(layout: Layout) -> NDArray[np.int64]:
    """Return the samples of a plane that each stream holds."""
    fields = np.maximum(layout.unit_uf, 0).astype(np.int64)
    of_unit = (fields[:, 4:7] * fields[:, 7:10]).sum(axis=1)
    ends = np.concatenate([[0], np.cumsum(of_unit)])
    return ends[layout.first_t2[:, 1]] - ends[layout.first_t2[:, 0]]


def decode_streams(
    device: Device,
    layout: Layout,
    streams: list[bytes],
    tables: Tables,
    index: DeviceArray,
    planes: int,
    sums: DeviceArray | None = None,
    weight_jc: NDArray[np.float32] | None = None,
    biases: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.int32]:
    """Decode streams into zeroed planes of indices, or into sums of their values times weights.

    Returns
    -------
    ndarray, shape (n_stream,), int32
        1 where a stream is damaged.
    """
    n_stream = len(streams)
    size_t = np.array([len(s) for s in streams], np.uint32)
    place_t2 = np.stack([np.concatenate([[0], np.cumsum(size_t[:-1], dtype=np.uint32)]), size_t], axis=1).astype(np.uint32)
    stream = device.upload(np.frombuffer(b"".join(streams) or b"\0", np.uint8))
    first, unit = device.upload(layout.first_t2), device.upload(layout.unit_uf)
    counts, flags = device.upload(tables.count_ms), device.upload(tables.flag_f2)
    most = max(end - begin for begin, end in layout.batches)
    work = device.empty((most, _WORK_BYTES), np.uint8)
    fault_t = np.zeros(n_stream, np.int32)
    fault, place = device.empty(fault_t.shape, np.int32, fault_t), device.upload(place_t2)
    n_sum = 0 if weight_jc is None else weight_jc.shape[1]
    if sums is None or weight_jc is None:  # no kernel takes nothing: memory that is never touched
        sums, weight_jc = device.empty((1, *index.shape[1:]), np.float32), np.zeros((index.shape[0], 1), np.float32)
    weight = device.upload(weight_jc)
    for begin, end in layout.batches:
        device.launch(
            "codec/units_decode.cl",
            "decode_units",
            (end - begin,),
            *(index, sums, weight, stream, place, first, unit, counts, flags, work, fault, *biases),
            *(begin, planes, n_sum, *sums.shape),
        )
    return device.download(fault)
