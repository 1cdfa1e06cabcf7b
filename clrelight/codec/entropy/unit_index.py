"""Where the streams of units lie in a body: an index of lengths and checksums in front of them."""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body, expect_parts
from clrelight.codec.entropy.units import LEVELS, Unit
from clrelight.errors import PayloadError

SUM = struct.Struct("<H")
"""A checksum: CRC-16 of the kind "XMODEM"."""
LEAST_ENTRY = 1 + SUM.size
"""Bytes of an entry at the least."""


def pack_index(streams: list[bytes]) -> bytes:
    """Return where streams lie: the length and the checksum of each."""
    index = bytearray()
    for stream in streams:
        size = len(stream)
        while size >= 128:
            index.append(size & 127 | 128)
            size >>= 7
        index.append(size)
        index += SUM.pack(binascii.crc_hqx(stream, 0))
    return bytes(index)


def index_bytes(sizes: list[int]) -> int:
    """Return the bytes of an index of streams of such sizes, and of the checksum behind it."""
    return SUM.size + sum(max(-(-size.bit_length() // 7), 1) + SUM.size for size in sizes)


def seal_front(front: bytes, streams: list[bytes]) -> bytes:
    """Return a body: what stands in front, the index, the checksum of both, and the streams."""
    front += pack_index(streams)
    return b"".join([front, SUM.pack(binascii.crc_hqx(front, 0)), *streams])


@dataclass(frozen=True)
class Stored:
    """Streams of units in a body.

    Attributes
    ----------
    name : str
        The codec, for messages.
    together : bool
        Whether all units of a group of planes are one stream.
    groups : list of (int, int)
        First plane of each group, and the one behind its last.
    start_t : ndarray, shape (n_stream + 1,), int64
        Where each stream begins in the body, and where the last one ends.
    sum_t : ndarray, uint16
        Its CRC-16.
    coarse_jl : ndarray, shape (n_plane, LEVELS + 1), int32, or None
        Bits of indices that are written as they are, by plane and level.
    """

    name: str
    together: bool
    groups: list[tuple[int, int]]
    start_t: NDArray[np.int64]
    sum_t: NDArray[np.uint16]
    coarse_jl: NDArray[np.int32] | None = None

    @property
    def n_plane(self) -> int:
        """Planes in all."""
        return self.groups[-1][1] if self.groups else 0

    def numbers(self, units: list[Unit], chosen: list[int]) -> list[int]:
        """Return which streams hold chosen ones of all units, in the order of `lay_out`.

        Streams follow each other level by level, from coarse to fine; of a level group by group, and in those unit by
        unit.
        """
        count = len(self.groups)
        if self.together:
            return list(range(count))
        if count == 1:
            return list(chosen)
        level_u = np.array([unit.level or LEVELS + 1 for unit in units])
        numbers: list[int] = []
        for level in range(LEVELS + 1, 0, -1):
            here = np.flatnonzero(level_u == level)
            first = count * int(here[0])
            wanted = [t - int(here[0]) for t in chosen if level_u[t] == level]
            numbers += [first + g * len(here) + t for g in range(count) for t in wanted]
        return numbers

    def expect(self, body: Body, streams: list[int]) -> None:
        """Say which streams are read next, for bodies that are not at hand."""
        expect_parts(body, [(int(self.start_t[t]), int(self.start_t[t + 1])) for t in streams])

    def read(self, body: Body, stream: int) -> bytes:
        """Return a stream's bytes; PayloadError if they are not those that were written."""
        content = body[int(self.start_t[stream]) : int(self.start_t[stream + 1])]
        if binascii.crc_hqx(content, 0) != self.sum_t[stream]:
            if self.together:
                units = "all of its units are one stream" if len(self.groups) == 1 else "its units are no streams alone"
                raise PayloadError(f"the {self.name} body is damaged, and {units}: none can be salvaged")
            raise PayloadError(f"unit {stream} of the {self.name} body is damaged")
        return content


def read_index(name: str, body: Body, at: int, count: int) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    """Return where streams lie, by the index at a place of the body; PayloadError unless it and its front are whole."""
    index = body[at : at + (5 + SUM.size) * count + SUM.size]
    place, sizes, sums = 0, [], []
    for _ in range(count):
        size = shift = 0
        while True:
            if place + 1 + SUM.size > len(index) or shift > 28:
                raise PayloadError(f"the {name} body's index of units is damaged")
            size |= (index[place] & 127) << shift
            place, shift = place + 1, shift + 7
            if index[place - 1] < 128:
                break
        sizes.append(size)
        sums.append(SUM.unpack_from(index, place)[0])
        place += SUM.size
    end = at + place
    if len(body) < end + SUM.size or SUM.unpack(body[end : end + SUM.size])[0] != binascii.crc_hqx(body[:end], 0):
        raise PayloadError(f"the {name} body's tables or its index of units are damaged")
    start_t = end + SUM.size + np.concatenate([[0], np.cumsum(np.array(sizes, np.int64))]).astype(np.int64)
    if start_t[-1] != len(body):
        raise PayloadError(f"the {name} body should have {start_t[-1]} bytes, it has {len(body)}")
    return start_t, np.array(sums, np.uint16)
