"""``encoded/1``: coefficients as a codec's bytes, with what they need to become a fit again."""

from __future__ import annotations

import os
import tempfile
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from clrelight.codec.bodies import Body
from clrelight.codec.encoded import Encoded
from clrelight.codec.rooms import Shape
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.errors import InputError, StoreFormatError
from clrelight.store.fits import read_record, write_record
from clrelight.store.opening import Opened, opening, parse_config, refusing
from clrelight.store.places import Place
from clrelight.store.schemas import ENCODED
from clrelight.store.scratch import ScratchBody, ScratchRoom
from clrelight.store.stored import StoredArray
from clrelight.store.writing import CHUNK_BYTES, COMPACT_BYTES, Draft, config_text, drafting

_CONFIG_BYTES = 64
_MARGIN = 64
"""Bytes that HDF5's own records may take more than in an example."""
_PIECE_BYTES = 4 * CHUNK_BYTES
"""Of a payload that are copied at a time."""


def write_encoded(path: str | os.PathLike, encoded: Encoded, source: CoefficientMap | None = None) -> None:
    """Write encoded coefficients and the record of the fit they come from (its lambda and rank maps are not kept).

    Parameters
    ----------
    path : path
        Where the file is to stand.
    encoded : Encoded
        Its `info` becomes attributes of the payload.
    source : CoefficientMap, optional
        What was encoded. Default: the record that the encoding comes with.

    Raises
    ------
    InputError
        If the shapes differ, there is no record, or the file cannot be written.
    """
    if source is not None and tuple(encoded.shape) != tuple(source.coeffs_khwc.shape):
        raise InputError(f"the payload is of shape {encoded.shape}, its source of {source.coeffs_khwc.shape}")
    record = FitRecord.of(source) if source is not None else encoded.record
    if record is None:
        raise InputError("these encoded bytes come without the record of their fit: say which fit was encoded")
    header = np.frombuffer(encoded.header(), np.uint8)
    with drafting(path, ENCODED, encoded.encoded_bytes + CHUNK_BYTES) as draft:
        draft.attributes({"codec": encoded.codec, "config": config_text(encoded.config)})
        draft.attributes({"encoded_bytes": encoded.encoded_bytes})
        draft.attributes({"bits_per_coefficient": float(encoded.bits_per_coefficient)})
        write_record(draft, record, "fit_config")
        draft.dataset("header", header)
        _write_payload(draft, encoded)
        draft.attributes({key: float(value) for key, value in sorted(encoded.info.items())}, of="payload")


def _write_payload(draft: Draft, encoded: Encoded) -> None:
    size = encoded.encoded_bytes
    if size <= COMPACT_BYTES:
        draft.dataset("payload", np.frombuffer(encoded.body[:], np.uint8))
        return
    sink = draft.sink("payload", (size,), np.uint8, (), (min(size, CHUNK_BYTES),))
    for start in range(0, size, _PIECE_BYTES):
        end = min(start + _PIECE_BYTES, size)
        sink[start:end] = np.frombuffer(encoded.body[start:end], np.uint8)


def read_encoded(path: str | os.PathLike) -> tuple[Encoded, FitRecord]:
    """Read encoded coefficients and the record of their fit; errors as of `open_fit`, also where the two disagree."""
    with opening(path, "encoded") as opened, refusing(opened.path):
        return encoded_of(opened)


def stage_encoded(opened: Opened, room: ScratchRoom) -> tuple[Encoded, FitRecord]:
    """Return what `encoded_of` does, a payload that is large for the room copied to a file."""
    stored, body = opened.arrays["payload"], None
    if not room.holds(stored.size):
        body = ScratchBody(room)
        body.reserve(stored.size)
        for start in range(0, stored.size, _PIECE_BYTES):
            body.write(start, stored[start : start + _PIECE_BYTES])
    with refusing(opened.path):
        return encoded_of(opened, body)


class StoredBody:
    """The payload of an open file, read as it is sliced."""

    def __init__(self, stored: StoredArray) -> None:
        self._stored = stored

    def __len__(self) -> int:
        return self._stored.size

    def __getitem__(self, part: slice) -> bytes:
        return self._stored[part].tobytes()


class PlacedBody(StoredBody):
    """The payload of an open file as it lies there: exactly what is asked for is read, or fetched.

    So blocks are not compared with their checksums: it is for payloads whose parts have their own.
    """

    def __init__(self, stored: StoredArray, place: Place, extents: list[tuple[int, int]]) -> None:
        super().__init__(stored)
        self._place, self._extents = place, extents
        self._firsts = np.cumsum([0, *(size for _, size in extents)]).tolist()

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(len(self))
        content = b"".join([self._place.read_at(*range_) for range_ in self._ranges(start, stop)])
        if len(content) != max(stop - start, 0):
            raise StoreFormatError(f"{self._place.path}: its payload lies beyond its end: it is damaged")
        return content

    def prefetch(self, parts: Sequence[tuple[int, int]]) -> None:
        """See `clrelight.codec.bodies.FarBody`."""
        self._place.prefetch([range_ for part in parts for range_ in self._ranges(*part)])

    def _ranges(self, start: int, stop: int) -> Iterator[tuple[int, int]]:
        at = bisect_right(self._firsts, start) - 1
        while start < stop:
            place, end = self._extents[at][0] + start - self._firsts[at], min(stop, self._firsts[at + 1])
            yield place, place + end - start
            start, at = end, at + 1


def body_of(opened: Opened, *, compared: bool = True) -> StoredBody:
    """Return the payload of an open file, to be read as it is sliced.

    It is `compared` with the checksums of its blocks where they are read whole: not of a file on another machine, of
    which only what is sliced is fetched.
    """
    stored, place = opened.arrays["payload"], opened.place
    if compared and place.remote is None:
        return StoredBody(stored)
    extents = stored.extents() if place.begin == 0 else []
    return PlacedBody(stored, place, extents) if extents else StoredBody(stored if compared else stored.unchecked())


def encoded_of(opened: Opened, body: Body | None = None, *, summed: bool = True) -> tuple[Encoded, FitRecord]:
    """Return what an open file holds; StoreFormatError or InputError if it is not sound.

    `body` is its payload, where that is read already or not to be read yet; `summed` as of `Encoded.from_parts`.
    """
    held = opened.attributes()
    body = opened.arrays["payload"][...].tobytes() if body is None else body
    encoded = Encoded.from_parts(opened.arrays["header"][...].tobytes(), body, summed=summed)
    for name, value in (
        ("codec", encoded.codec),
        ("encoded_bytes", encoded.encoded_bytes),
        ("bits_per_coefficient", encoded.bits_per_coefficient),
    ):
        if held[name] != value:
            raise StoreFormatError(f"attribute {name} is {held[name]!r}, but its payload says {value!r}")
    record = read_record(opened, held, "fit_config")
    record.to_map(np.broadcast_to(np.float32(0), encoded.shape))  # checks the record, takes no memory
    config, info = parse_config(held["config"], "config"), opened.floats("payload")
    return replace(encoded, config=config, info=info, record=record), record


def container_bytes(record: FitRecord, shape: Shape) -> int:
    """Return how many bytes, or a few more, a file will have beside the payload of an encoding that is to come."""
    config = {"a setting of the codec": "x" * _CONFIG_BYTES}
    encoded = Encoded("klt", config, shape, bytes(2 * COMPACT_BYTES), {"step": 1.0, "planes": 1.0}, record)
    with tempfile.TemporaryDirectory(prefix="clrelight.") as folder:
        path = Path(folder, "empty.h5")
        write_encoded(path, encoded)
        return path.stat().st_size - encoded.encoded_bytes + _MARGIN
