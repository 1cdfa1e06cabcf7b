"""The first bytes of an HDF5 file that was built in memory, as a file that was closed has them."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from clrelight.store.places import MAGIC

_FLAGS, _SUMMED = 11, 44
_MASK = 0xFFFFFFFF
_MIX = ((0, 2, 4), (1, 0, 6), (2, 1, 8), (0, 2, 16), (1, 0, 19), (2, 1, 4))
_FINAL = ((2, 1, 14), (0, 2, 11), (1, 0, 25), (2, 1, 16), (0, 2, 4), (1, 0, 14), (2, 1, 24))


def closed(image: bytes) -> Iterator[bytes | memoryview]:
    """Yield the parts of an open file's image, with no flag that somebody writes it and the checksum of that.

    HDF5 1.14 clears the flag itself, but leaves the checksum of before (``H5Fget_file_image``): nobody opens that.
    Nothing is copied but the superblock.
    """
    known = image[:8] == MAGIC and image[8] in (2, 3)
    if known:
        head = image[:_FLAGS] + b"\0" + image[_FLAGS + 1 : _SUMMED]
        yield head + struct.pack("<I", lookup3(head))
    yield memoryview(image)[_SUMMED + 4 if known else 0 :]


def lookup3(content: bytes) -> int:
    """Return the checksum of HDF5's metadata: ``hashlittle`` of Bob Jenkins' lookup3.c (2006), from 0."""
    words = struct.unpack(f"<{-(-len(content) // 12) * 3}I", content + bytes(-len(content) % 12))
    state = [(0xDEADBEEF + len(content)) & _MASK] * 3
    for first in range(0, len(words), 3):
        state = [(each + word) & _MASK for each, word in zip(state, words[first : first + 3], strict=True)]
        if first + 3 < len(words):
            for to, by, turn in _MIX:
                state[to] = (state[to] - state[by]) & _MASK ^ _turned(state[by], turn)
                state[by] = (state[by] + state[3 - to - by]) & _MASK
    for to, by, turn in _FINAL:
        state[to] = ((state[to] ^ state[by]) - _turned(state[by], turn)) & _MASK
    return state[2]


def _turned(word: int, turn: int) -> int:
    return (word << turn | word >> (32 - turn)) & _MASK
