"""``encoded/4``, and ``encoded/1`` to ``encoded/3`` of before: a codec's bytes as a fit."""

from __future__ import annotations

import json
import math
import os
import zlib
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body
from clrelight.codec.encoded import MAX_HEADER_BYTES, Encoded, header_size
from clrelight.codec.workspace import Shape
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.errors import InputError, StoreFormatError
from clrelight.light_codes import MOST_PACKED, pack_directions, unpack_directions, unpack_directions_of_5
from clrelight.store.attributes import MAX_TEXT_BYTES
from clrelight.store.fits import check_version, read_record
from clrelight.store.nexus import view_picture
from clrelight.store.opening import Opened, opening, parse_config, refusing
from clrelight.store.places import Place
from clrelight.store.schemas import ENCODED, ENCODED_1, ENCODED_2
from clrelight.store.scratch import ScratchBody, ScratchWorkspace
from clrelight.store.stored import StoredArray
from clrelight.store.usual import USUAL
from clrelight.store.writing import (
    CHUNK_BYTES,
    COMPACT_BYTES,
    Draft,
    config_text,
    drafted_bytes,
    drafting,
    even_part,
)

_SETTING = "8f1c3be97a52"
"""For other settings than klt has: what cannot be compressed."""
_MARGIN = 48
"""Bytes that HDF5's own records, and packed settings, may take more than in an example."""
_MAX_RECORD_BYTES = 1 << 20
_RECORD_TYPES: dict[str, type | tuple[type, ...]] = {
    "method": str,
    "degree": int,
    "peak": (float, int),
    "transfer": str,
    "name": str,
    "fit_config": dict,
    "config": dict,
    "info": dict,
}
_PIECE_BYTES = 4 * CHUNK_BYTES
"""Of a payload that are copied at a time."""


def write_encoded(
    path: str | os.PathLike,
    encoded: Encoded,
    source: CoefficientMap | None = None,
    *,
    picture_hwc: NDArray[np.uint8] | None = None,
) -> None:
    """Write encoded coefficients and the record of the fit they come from (its lambda and rank maps are not kept).

    Parameters
    ----------
    path : path
        Where the file is to stand.
    encoded : Encoded
        Its `info` becomes attributes of the payload.
    source : CoefficientMap, optional
        What was encoded. Default: the record that the encoding comes with.
    picture_hwc : ndarray, shape (height, width, 1 or 3), uint8, optional
        What other programs are to open the file on. No reader of ours looks at it.

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
    with drafting(path, ENCODED, encoded.encoded_bytes + CHUNK_BYTES) as draft:
        _fill(draft, encoded, record.without_surface())
        if picture_hwc is not None:
            view_picture(draft.file, picture_hwc, record.name)


def _fill(draft: Draft, encoded: Encoded, record: FitRecord) -> None:
    many = len(record.directions_i3) > MOST_PACKED
    blob = _pack_record(encoded, record) + (b"" if many else pack_directions(record.directions_i3))
    if len(blob) > MAX_TEXT_BYTES:
        raise InputError(f"the options and names of a fit must take at most {MAX_TEXT_BYTES} bytes, got {len(blob)}")
    draft.attributes({"record": blob})
    if many:
        draft.dataset("directions", record.directions_i3, ("light", "xyz"))
    _write_payload(draft, encoded)


def _pack_record(encoded: Encoded, record: FitRecord) -> bytes:
    """Return all that is not in the payload, but for directions."""
    facts = {
        "method": record.method,
        "degree": int(record.degree),
        "peak": float(record.peak),
        "transfer": record.transfer,
        "name": record.name,
        "fit_config": dict(record.config),
        "config": dict(encoded.config),
        "info": {key: _plain(float(value)) for key, value in sorted(encoded.info.items())},
    }
    text = json.dumps(json.loads(config_text(facts)), separators=(",", ":"), sort_keys=True)
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS, 9, zlib.Z_DEFAULT_STRATEGY, USUAL)
    return packer.compress(text.encode()) + packer.flush()


def _plain(value: float) -> float | str:
    return value if math.isfinite(value) else str(value)


def _write_payload(draft: Draft, encoded: Encoded) -> None:
    header, size = encoded.header(), encoded.encoded_bytes
    whole = len(header) + size
    if whole <= COMPACT_BYTES:
        draft.dataset("payload", np.frombuffer(header + encoded.body[:], np.uint8))
        return
    # HDF5 stores the last chunk whole.
    sink = draft.sink("payload", (whole,), np.uint8, (), (even_part(whole, CHUNK_BYTES),))
    sink[: len(header)] = np.frombuffer(header, np.uint8)
    for start in range(0, size, _PIECE_BYTES):
        end = min(start + _PIECE_BYTES, size)
        sink[len(header) + start : len(header) + end] = np.frombuffer(encoded.body[start:end], np.uint8)


def read_encoded(path: str | os.PathLike) -> tuple[Encoded, FitRecord]:
    """Read encoded coefficients and the record of their fit; errors as of `open_fit`, also where the two disagree."""
    with opening(path, "encoded") as opened, refusing(opened.path):
        return whole_of(opened)


def whole_of(opened: Opened, workspace: ScratchWorkspace | None = None) -> tuple[Encoded, FitRecord]:
    """Return what `encoded_of` does with the payload read: to a file where it is large for a workspace."""
    header, stored = parts_of(opened)
    if workspace is None or workspace.holds(len(stored)):
        return encoded_of(opened, header, stored[:])
    body = ScratchBody(workspace)
    body.reserve(len(stored))
    for start in range(0, len(stored), _PIECE_BYTES):
        body.write(start, np.frombuffer(stored[start : start + _PIECE_BYTES], np.uint8))
    return encoded_of(opened, header, body)


class StoredBody:
    """The payload of an open file behind its first bytes, read as it is sliced."""

    def __init__(self, stored: StoredArray, first: int = 0) -> None:
        self._stored, self._first = stored, min(first, stored.size)

    def __len__(self) -> int:
        return self._stored.size - self._first

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(len(self))
        return self._stored[self._first + start : self._first + stop].tobytes()

    def behind(self, first: int) -> StoredBody:
        """Return what of it stands behind its first bytes."""
        return StoredBody(self._stored, self._first + first)


class PlacedBody(StoredBody):
    """The payload of an open file as it lies there: exactly what is asked for is read, or fetched.

    So blocks are not compared with their checksums: it is for payloads whose parts have their own.
    """

    def __init__(self, stored: StoredArray, place: Place, extents: list[tuple[int, int]], first: int = 0) -> None:
        super().__init__(stored, first)
        self._place, self._extents = place, extents
        self._firsts = np.cumsum([0, *(size for _, size in extents)]).tolist()

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(len(self))
        content = b"".join([self._place.read_at(*range_) for range_ in self._ranges(start, stop)])
        if len(content) != max(stop - start, 0):
            raise StoreFormatError(f"{self._place.path}: its payload lies beyond its end: it is damaged")
        return content

    def behind(self, first: int) -> StoredBody:
        """See `StoredBody`."""
        return PlacedBody(self._stored, self._place, self._extents, self._first + first)

    def prefetch(self, parts: Sequence[tuple[int, int]]) -> None:
        """See `clrelight.codec.bodies.FarBody`."""
        self._place.prefetch([range_ for part in parts for range_ in self._ranges(*part)])

    def _ranges(self, start: int, stop: int) -> Iterator[tuple[int, int]]:
        start, stop = start + self._first, stop + self._first
        at = bisect_right(self._firsts, start) - 1
        while start < stop:
            place, end = self._extents[at][0] + start - self._firsts[at], min(stop, self._firsts[at + 1])
            yield place, place + end - start
            start, at = end, at + 1


def parts_of(opened: Opened, *, compared: bool = True) -> tuple[bytes, StoredBody]:
    """Return the header of what an open file holds, and the payload behind it, to be read as it is sliced.

    It is `compared` with the checksums of its blocks where they are read whole: not of a file on another machine, of
    which only what is sliced is fetched.
    """
    payload = _payload_of(opened, compared)
    if opened.schema is ENCODED_1:
        return opened.arrays["header"][...].tobytes(), payload
    start = payload[:MAX_HEADER_BYTES]
    size = header_size(start)
    return start[:size], payload.behind(size)


def _payload_of(opened: Opened, compared: bool) -> StoredBody:
    stored, place = opened.arrays["payload"], opened.place
    if compared and place.remote is None:
        return StoredBody(stored)
    extents = stored.extents() if place.begin == 0 else []
    return PlacedBody(stored, place, extents) if extents else StoredBody(stored if compared else stored.unchecked())


def encoded_of(opened: Opened, header: bytes, body: Body, *, summed: bool = True) -> tuple[Encoded, FitRecord]:
    """Return what an open file holds; StoreFormatError or InputError if it is not sound.

    `summed` is as of `Encoded.from_parts`.
    """
    held = opened.attributes()
    encoded = Encoded.from_parts(header, body, summed=summed)
    if opened.schema is not ENCODED_1:
        facts, directions_i3 = _parse_record(held["record"], opened)
        about = {name: facts[name] for name in ("degree", "method", "peak", "transfer", "name")}
        record = FitRecord(**about, directions_i3=directions_i3, config=facts["fit_config"])
        config, info = facts["config"], {key: float(value) for key, value in facts["info"].items()}
    else:
        record = _record_of_1(opened, held, encoded)
        config, info = parse_config(held["config"], "config"), opened.floats("payload")
    if opened.schema is not ENCODED:
        check_version(opened, record, ENCODED_2)
    record.to_map(np.broadcast_to(np.float32(0), encoded.shape))  # checks the record, takes no memory
    return replace(encoded, config=config, info=info, record=record), record


def _parse_record(blob: bytes, opened: Opened) -> tuple[dict[str, Any], NDArray[np.float64]]:
    """Return the facts of a record, each of its type, and the directions."""
    is_new = opened.schema is ENCODED
    unpacker = zlib.decompressobj(-zlib.MAX_WBITS, USUAL if is_new else b"")
    text = unpacker.decompress(blob, _MAX_RECORD_BYTES)
    if not unpacker.eof:
        raise StoreFormatError(f"attribute record is cut short, or inflates to more than {_MAX_RECORD_BYTES} bytes")
    facts = parse_config(text.decode(), "record")
    for name, kinds in _RECORD_TYPES.items():
        if not isinstance(facts.get(name), kinds) or isinstance(facts[name], bool):
            raise StoreFormatError(f"attribute record must have {name}, got {facts.get(name)!r:.80}")
    if "directions" in opened.arrays:
        return facts, opened.arrays["directions"][...]
    return facts, (unpack_directions if is_new else unpack_directions_of_5)(unpacker.unused_data)


def _record_of_1(opened: Opened, held: Mapping[str, Any], encoded: Encoded) -> FitRecord:
    for name, value in (
        ("codec", encoded.codec),
        ("encoded_bytes", encoded.encoded_bytes),
        ("bits_per_coefficient", encoded.bits_per_coefficient),
    ):
        if held[name] != value:
            raise StoreFormatError(f"attribute {name} is {held[name]!r}, but its payload says {value!r}")
    return read_record(opened, held, "fit_config")


def container_bytes(record: FitRecord, shape: Shape) -> int:
    """Return how many bytes, or a few more, a file will have beside the payload of an encoding that is to come."""
    config = {"byte_budget": 1234567890, "metric": "perceptual", "rate": None, "transfer": "linear", "other": _SETTING}
    encoded = Encoded(
        "klt", config, shape, bytes(2 * COMPACT_BYTES), {"step": 0.12345678901234567, "planes": 123.0}, record
    )
    return (
        drafted_bytes(ENCODED, lambda draft: _fill(draft, encoded, record.without_surface()))
        - encoded.encoded_bytes
        + _MARGIN
    )
