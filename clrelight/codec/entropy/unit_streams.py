"""Code streams of units on a device: see `units`, ``units_encode.cl`` and ``units_decode.cl``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from clrelight import recycling
from clrelight.codec.entropy.units import LEVELS, Layout
from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray

# As in units.clh.
NEAR, HINT, SYMBOLS, LOWS = 12, 16, 16, 16
CONTEXTS = 3 * NEAR * HINT + LOWS
FLAGS = 7 * 16 + 2 * 16
ONE = 1 << 14
_WORK_BYTES = 1 << 18
_SEEN = CONTEXTS * SYMBOLS + 2 * FLAGS
_RAW_BYTES = 8
"""Of a sample at most: what passes the last symbol, bits below a shift, and a sign."""
_WORKERS = {"cpu": 4, "gpu": 16}
"""Streams that each compute unit decodes at once, each in memory of its own."""


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
    """Return what is expected of planes of which nothing is known: ``python -m benchmarks.unit_tables`` counted it."""
    content = np.frombuffer(files("clrelight.codec.entropy").joinpath("units.tables").read_bytes(), np.uint8)
    counts = content[: CONTEXTS * SYMBOLS].reshape(CONTEXTS, SYMBOLS).astype(np.uint16)
    flags = np.frombuffer(content[CONTEXTS * SYMBOLS :].tobytes(), "<u2").reshape(FLAGS, 2).astype(np.uint16)
    return Tables(counts, flags)


class ValuesLostError(Exception):
    """Values are to be made anew, since indices have taken their place in vain."""


@dataclass(frozen=True)
class Coded:
    """Streams, and what was measured while they were made.

    Attributes
    ----------
    streams : list of bytes
    error_tj, bits_tj : ndarray, shape (n_stream, n_plane), float32
        Squared error of each stream's planes in squared steps, and about the bits that they took.
    symbol_ms, flag_f2 : ndarray, int64
        How often contexts saw symbols, and flags 0 and 1, where that was counted.
    """

    streams: list[bytes]
    error_tj: NDArray[np.float32]
    bits_tj: NDArray[np.float32]
    symbol_ms: NDArray[np.int64]
    flag_f2: NDArray[np.int64]

    @property
    def size(self) -> int:
        """Bytes of all streams."""
        return sum(map(len, self.streams))

    @property
    def error_j(self) -> NDArray[np.float64]:
        """Squared error of each plane."""
        return self.error_tj.sum(axis=0, dtype=np.float64)

    @property
    def bits_j(self) -> NDArray[np.float64]:
        """About the bits of each plane."""
        return self.bits_tj.sum(axis=0, dtype=np.float64)


def encode_streams(
    device: Device,
    layout: Layout,
    values: DeviceArray,
    index: DeviceArray,
    tables: Tables,
    multiplier: float,
    scale: float | NDArray[np.float32] = 1.0,
    coarse_jl: NDArray[np.int32] | None = None,
    count: bool = False,
    finest: bool = True,
) -> Coded:
    """Encode planes of wavelet coefficients in steps.

    Parameters
    ----------
    device : Device
    layout : Layout
        What of the planes.
    values : DeviceArray, shape (n_plane, height, pitch), float32
        In place as `list_subbands` says.
    index : DeviceArray, same shape, int32
        Where the chosen indices go; it may be the memory of `values`.
    tables : Tables
        What streams start from.
    multiplier : float
        Squared steps of error that a bit must save.
    scale : float, or ndarray of shape (n_plane,), float32
        Steps of a unit of the values, of all planes or of each.
    coarse_jl : ndarray, shape (n_plane, LEVELS + 1), int32, optional
        Bits of each plane's indices, by level with LL first, that are written as they are; none by default.
    count : bool
        Whether symbols and flags are counted too.
    finest : bool
        Whether `index` gets indices of level 1 too, on which no other unit hangs.

    Returns
    -------
    Coded
        The streams, the same for the same device.

    Raises
    ------
    ValuesLostError
        If streams take more than a byte a sample, and indices were put in the place of values.
    """
    batches = layout.batches()
    n_plane, n_stream = values.shape[0], len(layout.part_t4)
    samples = samples_of(layout)
    most = max(end - begin for begin, end in batches)
    workers = min((1 if device.style == "cpu" else 4) * device.info.compute_units, most)
    items = int(samples.max()) * 5 // 4 + (1 << 12)  # samples, and flags of cells and bands
    place_t2, seen_wn = np.zeros((n_stream, 2), np.uint32), np.zeros((workers, _SEEN if count else 1), np.uint32)
    error_tj, bits_tj = np.zeros((n_stream, n_plane), np.float32), np.zeros((n_stream, n_plane), np.float32)
    given = [device.upload(a) for a in (layout.part_t4, layout.unit_uf, tables.count_ms, tables.flag_f2)]
    scales = device.upload(np.broadcast_to(np.asarray(scale, np.float32), n_plane).copy())
    coarse = device.upload(_coarse(coarse_jl, n_plane))
    work, item = device.empty((workers, _WORK_BYTES), np.uint8), device.empty((workers, items), np.uint32)
    raw = device.empty((workers, _RAW_BYTES * items), np.uint8)
    order = device.upload(np.lexsort((-samples, _batch_of(batches))).astype(np.int32))  # the largest first
    room = max(1 << 20, int(samples.sum()))
    while True:
        taken, stream = np.zeros(1, np.uint32), device.empty((room,), np.uint8)
        held = [device.hold(a) for a in (taken, place_t2, error_tj, bits_tj)]
        sizes = room, items, _RAW_BYTES * items, seen_wn.shape[1], *values.shape
        seen, next_a = device.hold(seen_wn), device.hold(np.zeros(len(batches), np.uint32))
        for batch, (begin, end) in enumerate(batches):
            device.launch(
                "codec/units_encode.cl",
                "encode_units",
                (min(workers, end - begin),),
                *(index, values, stream, *held, *given, work, item, raw, seen, scales, coarse, order, next_a),
                *(multiplier, int(finest), batch, begin, end, *sizes),
            )
        taken, place_t2, error_tj, bits_tj = (device.download(a) for a in held)
        if int(taken[0]) <= room:
            break
        if index.buffer is values.buffer:
            raise ValuesLostError
        room = int(taken[0])
        for a in (error_tj, bits_tj, seen_wn):
            a[...] = 0
    content = device.download(stream)
    streams = [content[at : at + size].tobytes() for at, size in place_t2.tolist()]
    seen_n = device.download(seen).sum(axis=0, dtype=np.int64) if count else np.zeros(_SEEN, np.int64)
    of_symbols, of_flags = np.split(seen_n, [CONTEXTS * SYMBOLS])
    return Coded(streams, error_tj, bits_tj, of_symbols.reshape(CONTEXTS, SYMBOLS), of_flags.reshape(FLAGS, 2))


def samples_of(layout: Layout) -> NDArray[np.int64]:
    """Return the samples that each stream holds."""
    fields = np.maximum(layout.unit_uf, 0).astype(np.int64)
    of_unit = (fields[:, 4:7] * fields[:, 7:10]).sum(axis=1)
    ends = np.concatenate([[0], np.cumsum(of_unit)])
    units, planes = layout.part_t4[:, :2], layout.part_t4[:, 2:]
    return (ends[units[:, 1]] - ends[units[:, 0]]) * (planes[:, 1] - planes[:, 0])


def _batch_of(batches: list[tuple[int, int]]) -> NDArray[np.int64]:
    return np.repeat(np.arange(len(batches)), [end - begin for begin, end in batches])


def _coarse(coarse_jl: NDArray[np.int32] | None, n_plane: int) -> NDArray[np.int32]:
    return np.zeros((n_plane, LEVELS + 1), np.int32) if coarse_jl is None else coarse_jl


def decode_streams(
    device: Device,
    layout: Layout,
    place_uf: NDArray[np.int32],
    streams: list[bytes],
    tables: Tables,
    values: DeviceArray,
    known_shape: tuple[int, int, int],
    weight_jc: NDArray[np.float32] | None = None,
    coarse_jl: NDArray[np.int32] | None = None,
) -> NDArray[np.int32]:
    """Decode streams into zeroed planes of the indices' values, or into sums of them times weights.

    Parameters
    ----------
    device : Device
    layout : Layout
        How units lie in planes that have all levels but the finest.
    place_uf : ndarray, shape (n_unit, 3, 6), int32
        Where their subbands lie in `values`: see `place_units`.
    streams : list of bytes
        Of the layout.
    tables : Tables
        What streams start from.
    values : DeviceArray, shape (n_plane, height, pitch) or (n_sum, height, pitch), float32
        Zeros.
    known_shape : tuple of int
        (n_plane, rows, pitch) of the layout.
    weight_jc : ndarray, shape (n_plane, n_sum), float32, optional
        What sums are made with; None: planes are asked for.
    coarse_jl : ndarray, shape (n_plane, LEVELS + 1), int32, optional
        See `encode_streams`.

    Returns
    -------
    ndarray, shape (n_stream,), int32
        1 where a stream is damaged.
    """
    size_t = np.array([len(s) for s in streams], np.uint32)
    place_t2 = np.stack([np.cumsum(size_t, dtype=np.uint32) - size_t, size_t], axis=1)
    stream = device.upload(np.frombuffer(b"".join(streams) or b"\0", np.uint8))
    part_t4, placed = layout.part_t4, place_uf.reshape(len(place_uf), -1)
    tables_given = (tables.count_ms, tables.flag_f2, _coarse(coarse_jl, known_shape[0]))
    given = [device.upload(a) for a in (place_t2, part_t4, layout.unit_uf, placed, *tables_given)]
    # Streams of one place must not add to the same sums at once.
    batches = layout.batches(apart=weight_jc is not None)
    most = max(end - begin for begin, end in batches)
    workers = min(most, _WORKERS[device.style] * device.info.compute_units)
    work = device.empty((workers, _WORK_BYTES), np.uint8)
    fault = device.hold(np.zeros(len(streams), np.int32))
    known = device.hold(recycling.zeros(known_shape, np.uint8))
    weight = device.upload(np.zeros((known_shape[0], 1), np.float32) if weight_jc is None else weight_jc)
    n_sum = 0 if weight_jc is None else weight_jc.shape[1]
    for begin, end in batches:
        device.launch(
            "codec/units_decode.cl",
            "decode_units",
            (min(workers, end - begin),),
            *(values, known, weight, stream, *given, work, fault),
            *(begin, end, n_sum, *values.shape[1:], *known_shape[1:]),
        )
    return device.download(fault)
