"""Codes of a fixed number of bits in bytes, lowest bit first, without gaps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

STRETCH = 1 << 16
"""Codes that are unfolded to bits at once; a multiple of 8, so that stretches start at whole bytes."""


def packed_size(count: int, bits: int) -> int:
    """Return the bytes of `count` codes."""
    return -(-count * bits // 8)


def pack_codes(codes_p: NDArray[np.integer], bits: int) -> bytes:
    """Return codes below ``2**bits`` as bytes, `bits` from 0 to 16; the last byte is filled up with zeros."""
    parts = []
    for start in range(0, codes_p.size, STRETCH):
        low_high_pb = codes_p[start : start + STRETCH].astype("<u2").view(np.uint8).reshape(-1, 2)
        bits_pb = np.unpackbits(low_high_pb, axis=1, count=bits, bitorder="little")
        parts.append(np.packbits(bits_pb.ravel(), bitorder="little").tobytes())
    return b"".join(parts)


def unpack_codes(packed: bytes, count: int, bits: int) -> NDArray[np.uint16]:
    """Return the `count` codes of `pack_codes`."""
    codes_p = np.zeros(count, np.uint16)
    packed_b = np.frombuffer(packed, np.uint8)
    for start in range(0, count if bits else 0, STRETCH):
        n = min(STRETCH, count - start)
        bits_p = np.unpackbits(packed_b[start * bits // 8 :], count=n * bits, bitorder="little")
        low_high_pb = np.zeros((n, 16), np.uint8)
        low_high_pb[:, :bits] = bits_p.reshape(n, bits)
        codes_p[start : start + n] = np.packbits(low_high_pb, axis=1, bitorder="little").view("<u2").ravel()
    return codes_p
