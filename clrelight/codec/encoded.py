"""A coefficient map as bytes, and the header that they have in front."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from clrelight.codec.bodies import Body
from clrelight.dataset import FitRecord
from clrelight.described import Described
from clrelight.errors import PayloadError
from clrelight.harmonics.index import degree_of
from clrelight.light_codes import kept_directions

MAGIC = b"CLRE"
WRAPPER_VERSION = 1
MAX_EXTENT = 1 << 20
MAX_CHANNELS = 1 << 10
MAX_COEFFICIENTS = 1 << 40
MAX_HEADER_BYTES = 6 + 255 + 28
_PIECE_BYTES = 1 << 22
"""Of a body that are summed up at a time."""


@dataclass(frozen=True, repr=False)
class Encoded(Described):
    """A coefficient map as bytes.

    Attributes
    ----------
    codec : str
        Id of the codec.
    config : mapping
        The codec's options, for the record; decoding does not need them.
    shape : tuple of int
        (n_coeff, height, width, channel).
    body : bytes, or what gives bytes when sliced
        Payload and every side table: all that grows with the data, and what sizes count.
    info : mapping
        What else the codec measured, such as ``entropy_bits`` (an estimate, bits per coefficient).
    record : FitRecord, optional
        What becomes a fit again with the coefficients; arrays alone have none, and no two encodings differ by it. As
        of a file, its directions are rounded, and it holds no surface: its ``config["surface"]`` says in whose frames
        functions are, and of which directions.
    due_sum : int, optional
        The checksum that header and body should have, where they were not compared with it yet: `summed` does that.
    """

    codec: str
    config: Mapping[str, Any]
    shape: tuple[int, int, int, int]
    body: Body
    info: Mapping[str, float] = field(default_factory=dict)
    record: FitRecord | None = field(default=None, repr=False, compare=False)
    due_sum: int | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.record is not None:
            bare = self.record.without_surface()
            kept = replace(bare, directions_i3=kept_directions(bare.directions_i3))
            object.__setattr__(self, "record", kept)

    @property
    def encoded_bytes(self) -> int:
        """Payload and every side table in bytes."""
        return len(self.body)

    @property
    def bits_per_coefficient(self) -> float:
        """``8 encoded_bytes / (n_coeff height width channel)``."""
        return 8.0 * len(self.body) / float(np.prod(self.shape, dtype=np.int64))

    def header(self) -> bytes:
        """Return the few fixed bytes in front of the body: magic, version, codec, shape, length, checksum."""
        return self._front() + struct.pack("<I", _checksum(self._front(), self.body))

    def _front(self) -> bytes:
        name = self.codec.encode("ascii")
        head = MAGIC + struct.pack("<BB", WRAPPER_VERSION, len(name)) + name
        return head + struct.pack("<4IQ", *self.shape, len(self.body))

    def summed(self) -> Self:
        """Return the encoding with its body in memory where its checksum is due; PayloadError if that does not fit."""
        if self.due_sum is None:
            return self
        body = bytes(self.body[:])
        if _checksum(self._front(), body) != self.due_sum:
            raise PayloadError("the payload's checksum does not fit: it is damaged")
        return replace(self, body=body, due_sum=None)

    def to_bytes(self) -> bytes:
        """Return header and body: these bytes alone decode."""
        return self.header() + self.body[:]

    @classmethod
    def from_bytes(cls, payload: bytes) -> Self:
        """Take apart what `to_bytes` made; PayloadError if it is damaged, cut, or not ours."""
        payload = bytes(payload)  # no copy of bytes; a memoryview or bytearray is taken too
        return cls.from_parts(payload[: header_size(payload)], payload[header_size(payload) :])

    @classmethod
    def from_parts(cls, payload: bytes, body: Body, *, summed: bool = True) -> Self:
        """Return what a header and its body are; PayloadError if they are damaged, cut, or not ours.

        The whole body is read for its checksum, unless that is not to be `summed` now.
        """
        if payload[:4] != MAGIC:
            raise PayloadError(f"not a clrelight payload: it starts with {payload[:4]!r}, expected {MAGIC!r}")
        if len(payload) < 6 or len(payload) < 6 + payload[5] + 28:
            raise PayloadError(f"the payload is cut short within its header, at {len(payload)} bytes")
        if payload[4] != WRAPPER_VERSION:
            raise PayloadError(f"payload version {payload[4]} is not known, this program reads {WRAPPER_VERSION}")
        at = 6 + payload[5]
        if len(payload) > at + 28:
            raise PayloadError(f"the payload's header should have {at + 28} bytes, it has {len(payload)}")
        *shape, length = struct.unpack_from("<4IQ", payload, at)
        (checksum,) = struct.unpack_from("<I", payload, at + 24)
        if len(body) != length:
            raise PayloadError(f"the payload should have {length} bytes behind its header, it has {len(body)}")
        if summed and _checksum(payload[: at + 24], body) != checksum:
            raise PayloadError("the payload's checksum does not fit: it is damaged")
        # Checked although the sum fits: a foreign writer may compute checksums too.
        try:
            check_shape(tuple(shape))
            codec = payload[6:at].decode("ascii")
        except ValueError as error:
            raise PayloadError(f"the payload's header is not valid: {error}") from None
        return cls(codec, {}, tuple(shape), body, due_sum=None if summed else checksum)


def header_size(payload: bytes) -> int:
    """Return the bytes of a header, which may have been cut short."""
    return 6 + payload[5] + 28 if len(payload) > 5 else len(payload)


def _checksum(head: bytes, body: Body) -> int:
    checksum = zlib.crc32(head)
    for start in range(0, len(body), _PIECE_BYTES):
        checksum = zlib.crc32(body[start : start + _PIECE_BYTES], checksum)
    return checksum


def check_shape(shape: tuple[int, ...]) -> None:
    """Raise ValueError unless (n_coeff, height, width, channel) is a shape that a payload may have."""
    if len(shape) != 4 or min(shape) < 1:
        raise ValueError(f"coefficients must be (coefficient, height, width, channel), none empty, got shape {shape}")
    if max(shape) > MAX_EXTENT or math.prod(shape) > MAX_COEFFICIENTS:
        raise ValueError(
            f"a coefficient map has at most {MAX_COEFFICIENTS} values and {MAX_EXTENT} along an axis, got {shape}"
        )
    # Coders go from channel to channel: a million of them, claimed by a few bytes, would take hours.
    if shape[3] > MAX_CHANNELS:
        raise ValueError(f"a coefficient map has at most {MAX_CHANNELS} channels, got {shape[3]}")
    degree_of(shape[0])
