"""Code streams of units on a device: see `units`, ``units_encode.cl`` and ``units_decode.cl``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.units import Layout
from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray

# As in units.clh.
NEAR, HINT, SYMBOLS, LOWS = 12, 16, 16, 16
CONTEXTS = 3 * NEAR * HINT + LOWS
FLAGS = 7 * 16 + 2 * 16
ONE = 1 << 14
_WORK_BYTES = 1 << 18


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


@dataclass(frozen=True)
class Coded:
    """Streams, and what was measured while they were made.

    Attributes
    ----------
    streams : list of bytes
    error_j, bits_j : ndarray, shape (n_plane,), float64
        Squared error of each plane in squared steps, and about the bits that it took.
    symbol_ms, flag_f2 : ndarray, int64
        How often contexts saw symbols, and flags 0 and 1.
    """

    streams: list[bytes]
    error_j: NDArray[np.float64]
    bits_j: NDArray[np.float64]
    symbol_ms: NDArray[np.int64]
    flag_f2: NDArray[np.int64]

    @property
    def size(self) -> int:
        """Bytes of all streams."""
        return sum(map(len, self.streams))


def encode_streams(
    device: Device,
    layout: Layout,
    values: DeviceArray,
    index: DeviceArray,
    tables: Tables,
    price: float,
    scale: float = 1.0,
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
    price : float
        Squared steps of error that a bit must save.
    scale : float
        Steps of a unit of the values.

    Returns
    -------
    Coded
        The streams, the same for the same device.
    """
    n_plane, n_stream = values.shape[0], len(layout.first_t2)
    samples = _samples(layout) * n_plane
    workers = min(4 * device.info.compute_units, max(e - b for b, e in layout.batches))
    room = max(1 << 20, 2 * int(samples.sum()) // 16)
    items = int(samples.max()) * 5 // 4 + (1 << 12)  # samples, and flags of cells and bands
    raws = items // 2
    while True:
        stream, taken = device.empty((room,), np.uint8), np.zeros(1, np.uint32)
        place_t2, error_tj = np.zeros((n_stream, 2), np.uint32), np.zeros((n_stream, n_plane), np.float32)
        bits_tj = np.zeros((n_stream, n_plane), np.float32)
        seen_wn = np.zeros((workers, CONTEXTS * SYMBOLS + 2 * FLAGS), np.uint32)
        held = [device.empty(a.shape, a.dtype, a) for a in (taken, place_t2, error_tj, bits_tj, seen_wn)]
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
                *(price, scale, begin, end, room, items, raws, seen_wn.shape[1], *values.shape),
            )
        taken, place_t2, error_tj, bits_tj, seen_wn = (device.download(a) for a in held)
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
        error_tj.sum(axis=0, dtype=np.float64),
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
) -> NDArray[np.int32]:
    """Decode streams into zeroed planes of indices, or into sums of their values times weights.

    Returns
    -------
    ndarray, shape (n_stream,), int32
        1 where a stream is damaged.
    """
    n_stream = len(streams)
    size_t = np.array([len(s) for s in streams], np.uint32)
    place_t2 = np.stack([np.concatenate([[0], np.cumsum(size_t[:-1], dtype=np.uint32)]), size_t], axis=1).astype(
        np.uint32
    )
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
            *(index, sums, weight, stream, place, first, unit, counts, flags, work, fault),
            *(begin, planes, n_sum, *sums.shape),
        )
    return device.download(fault)
