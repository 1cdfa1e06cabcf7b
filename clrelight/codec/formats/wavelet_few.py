"""Body 7 of the codec `wavelet`: maps of few numbers, each alone, where tables of body 6 take the bytes."""

from __future__ import annotations

import math
import struct

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body
from clrelight.codec.workspace import Shape
from clrelight.errors import PayloadError

VERSION = 7
MOST_BYTES = 512
"""Budget up to which these bodies are tried."""
_HEAD = struct.Struct("<BB")
_BITS = (2, 25)
"""Least and most bits of a number: with one more, the largest would pass float32."""
_MOST_VALUES = 8 * MOST_BYTES
"""Numbers of a map at most."""
_ABSENT, _LEAST = -128, -126
"""What stands for the exponent of a map that is zero, and the least exponent."""


def least_bytes(shape: Shape) -> int:
    """Return the bytes of a body of maps that are not zero."""
    return _HEAD.size + shape[0] + -(-math.prod(shape) * _BITS[0] // 8)


def encode_few(coeffs_khwc: NDArray[np.float32], budget: int, alike: bool) -> bytes | None:
    """Return the body of maps, in as many bits a number as so many bytes have room for; None where those are too few.

    None, too, of more than `MOST_BYTES`. Every map has a power of two of its own, or where they are not `alike` all
    have one.
    """
    n_coeff = len(coeffs_khwc)
    flat_kp = coeffs_khwc.reshape(n_coeff, -1).astype(np.float64)
    largest_k = np.abs(flat_kp).max(axis=1)
    present = np.flatnonzero(largest_k)
    count = len(present) * flat_kp.shape[1]
    bits = min(8 * (budget - _HEAD.size - n_coeff) // max(count, 1), _BITS[1])
    if bits < _BITS[0] or budget > MOST_BYTES or flat_kp.shape[1] > _MOST_VALUES:
        return None
    exponent_k = np.maximum(np.frexp(largest_k if alike else np.full(n_coeff, largest_k.max()))[1] - 1, _LEAST)
    exponent_k[largest_k == 0] = _ABSENT
    most = (1 << bits - 1) - 1
    index_mp = np.rint(np.ldexp(flat_kp[present], bits - 2 - exponent_k[present, None]))
    index_q = np.clip(index_mp, -most, most).astype(np.int64).ravel() + most
    packed = np.packbits((index_q[:, None] >> np.arange(bits - 1, -1, -1) & 1).astype(np.uint8))
    return _HEAD.pack(VERSION, bits) + exponent_k.astype("<i1").tobytes() + packed.tobytes()


def is_few(body: Body) -> bool:
    """Return whether a body is one of these."""
    return body[:1] == bytes([VERSION])


def decode_few(body: Body, shape: Shape) -> NDArray[np.float32]:
    """Return the coefficients (n_coeff, height, width, channel); PayloadError if the body makes no sense."""
    start = _HEAD.size + shape[0]
    if len(body) < start:
        raise PayloadError(f"the wavelet tables of {shape[0]} maps take more than the {len(body)} bytes of the body")
    _, bits = _HEAD.unpack(body[: _HEAD.size])
    exponent_k = np.frombuffer(body[_HEAD.size : start], "<i1").astype(np.int64)
    present = np.flatnonzero(exponent_k != _ABSENT)
    count = len(present) * math.prod(shape[1:])
    if not _BITS[0] <= bits <= _BITS[1] or (exponent_k == _ABSENT + 1).any():
        raise PayloadError(f"a wavelet body cannot have numbers of {bits} bits and exponents of {exponent_k.min()}")
    if len(body) != start + -(-count * bits // 8) or math.prod(shape[1:]) > _MOST_VALUES:
        raise PayloadError(f"a wavelet body of {len(body)} bytes cannot hold {count} numbers of {bits} bits")
    bits_b = np.unpackbits(np.frombuffer(body[start : len(body)], np.uint8))
    if bits_b[count * bits :].any():
        raise PayloadError("a wavelet body of few numbers has bits left that no number needs")
    index_q = bits_b[: count * bits].reshape(count, bits) @ (1 << np.arange(bits - 1, -1, -1, dtype=np.int64))
    most = (1 << bits - 1) - 1
    if (index_q > 2 * most).any():
        raise PayloadError(f"a wavelet body has a number beyond {2 * most}")
    coeffs_kp = np.zeros((shape[0], math.prod(shape[1:])))
    index_mp = (index_q - most).astype(np.float64).reshape(len(present), coeffs_kp.shape[1])
    coeffs_kp[present] = np.ldexp(index_mp, exponent_k[present, None] + 2 - bits)
    return coeffs_kp.reshape(shape).astype(np.float32)
