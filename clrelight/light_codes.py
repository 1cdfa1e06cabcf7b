"""Directions of lights in few bytes, as an encoded file keeps them."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

MOST_PACKED = 4096
"""Lights whose directions an encoded file packs."""
WITHIN = 8e-5
"""By how much, in radians, a direction that is packed may be off."""
_OCTAHEDRON = 1 << 15
"""Steps from the middle of the octahedron's map to its corners."""
_HEAD = struct.Struct("<BBBH")
_MOST_TIMES, _MOST_LAG, _MOST_LOW = 2, 64, 18

_OCTAHEDRON_OF_5 = (1 << 19) - 1
_BYTES_OF_5 = 5


def kept_directions(directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return directions as an encoded file gives them back: of up to 4096 lights, rounded."""
    return directions_i3 if len(directions_i3) > MOST_PACKED else unpack_directions(pack_directions(directions_i3))


def pack_directions(directions_i3: NDArray[np.float64]) -> bytes:
    """Return unit vectors in some 3.3 bytes each, within 8e-5 radian; axes are exact, none falls below the horizon.

    Coordinates on the octahedron that is unfolded to a square (Meyer et al. 2010), in whole steps; or what they, or
    these differences once more, differ by from those of the light some places before: of the last on a path, of the
    one beside it in the ring or the turn before. All as Rice codes (Rice 1971), the low bits of all in front.

    Parameters
    ----------
    directions_i3 : ndarray, shape (n_light, 3), float64
        At most 4096.

    Returns
    -------
    bytes
        How often differences are taken (0 to 2), of lights how many places apart, the number of low bits, each uint8,
        that of lights, uint16; then bits, the first of them the lowest of a byte.
    """
    step_i2 = _steps_of(directions_i3)
    ways = [(*_least(step_i2), 0, 1, step_i2)]
    for lag in range(1, min(_MOST_LAG + 1, len(step_i2))):
        differ_i2 = step_i2
        for times in range(1, _MOST_TIMES + 1):
            differ_i2 = np.concatenate([differ_i2[:lag], differ_i2[lag:] - differ_i2[:-lag]])
            ways.append((*_least(differ_i2), times, lag, differ_i2))
    _, low, times, lag, differ_i2 = min(ways, key=lambda way: way[:-1])
    code_n = _unsigned(differ_i2)
    high_n = code_n >> low
    ends = np.zeros(int(high_n.sum()) + len(high_n), np.uint8)
    ends[np.cumsum(high_n + 1) - 1] = 1
    lows = (code_n[:, None] >> np.arange(low)).astype(np.uint8) & 1
    bits = np.packbits(np.concatenate([lows.ravel(), ends]), bitorder="little")
    return _HEAD.pack(times, lag, low, len(directions_i3)) + bits.tobytes()


def unpack_directions(packed: bytes) -> NDArray[np.float64]:
    """Return what `pack_directions` was given, (n_light, 3); InputError where bytes are not of whole lights."""
    if len(packed) < _HEAD.size:
        raise InputError(f"directions have {_HEAD.size} bytes in front, got {len(packed)} bytes")
    times, lag, low, count = _HEAD.unpack_from(packed)
    if times > _MOST_TIMES or not 1 <= lag <= _MOST_LAG or low > _MOST_LOW or count > MOST_PACKED:
        raise InputError(f"directions cannot be of {count} lights, {times} times differences at {lag}, {low} low bits")
    bits = np.unpackbits(np.frombuffer(packed, np.uint8, offset=_HEAD.size), bitorder="little")
    n_low = 2 * count * low
    ends = np.flatnonzero(bits[n_low:])[: 2 * count]
    used = n_low + (int(ends[-1]) + 1 if len(ends) else 0)
    if len(ends) < 2 * count or len(bits) != -(-used // 8) * 8:
        raise InputError(f"directions of {count} lights do not end where their {len(packed)} bytes do")
    lows = bits[:n_low].reshape(2 * count, low).astype(np.int64) << np.arange(low)
    code_n = (np.diff(ends, prepend=-1) - 1 << low) + lows.sum(axis=1)
    step_i2 = (code_n >> 1 ^ -(code_n & 1)).reshape(count, 2)
    for _ in range(times):
        turns = np.concatenate([step_i2, np.zeros((-count % lag, 2), np.int64)]).reshape(-1, lag, 2)
        step_i2 = np.cumsum(turns, axis=0).reshape(-1, 2)[:count]
    if (np.abs(step_i2) > _OCTAHEDRON).any():
        raise InputError("directions lie beyond the octahedron's map")
    return _vectors_of(step_i2, _OCTAHEDRON)


def unpack_directions_of_5(packed: bytes) -> NDArray[np.float64]:
    """Return directions of 5 bytes each, 20 bits a coordinate, as files of before have them; errors as before."""
    if len(packed) % _BYTES_OF_5:
        raise InputError(f"directions take {_BYTES_OF_5} bytes each, got {len(packed)} bytes")
    wide = np.zeros((len(packed) // _BYTES_OF_5, 8), np.uint8)
    wide[:, :_BYTES_OF_5] = np.frombuffer(packed, np.uint8).reshape(-1, _BYTES_OF_5)
    code_i = wide.reshape(-1).view("<u8").astype(np.int64)
    step_i2 = np.stack([code_i >> 20, code_i & (1 << 20) - 1], axis=1) - (_OCTAHEDRON_OF_5 + 1)
    return _vectors_of(step_i2, _OCTAHEDRON_OF_5)


def _steps_of(directions_i3: NDArray[np.float64]) -> NDArray[np.int64]:
    flat_i2 = directions_i3[:, :2] / np.abs(directions_i3).sum(axis=1, keepdims=True)
    below = directions_i3[:, 2] < 0
    flat_i2[below] = (1.0 - np.abs(flat_i2[below][:, ::-1])) * np.where(flat_i2[below] < 0, -1.0, 1.0)
    step_i2 = np.rint(flat_i2 * _OCTAHEDRON).astype(np.int64)
    over = ~below & (np.abs(step_i2).sum(axis=1) > _OCTAHEDRON)  # rounded across the horizon
    step_i2[over, 0] -= np.sign(step_i2[over, 0])
    return step_i2


def _vectors_of(step_i2: NDArray[np.int64], corner: int) -> NDArray[np.float64]:
    above_i = corner - np.abs(step_i2).sum(axis=1)
    folded_i2 = (corner - np.abs(step_i2[:, ::-1])) * np.where(step_i2 < 0, -1, 1)
    flat_i2 = np.where((above_i < 0)[:, None], folded_i2, step_i2)
    vector_i3 = np.column_stack([flat_i2, above_i]).astype(np.float64)
    return vector_i3 / np.linalg.norm(vector_i3, axis=1, keepdims=True)


def _unsigned(value_i2: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return whole numbers in a row as such from zero: 0, -1, 1, -2 ... as 0, 1, 2, 3 ..."""
    return np.where(value_i2 < 0, -2 * value_i2 - 1, 2 * value_i2).ravel()


def _least(value_i2: NDArray[np.int64]) -> tuple[int, int]:
    """Return how many bits whole numbers take, but one for each, and the number of low bits at which they do."""
    code_n = _unsigned(value_i2)
    usual = int(code_n.mean()).bit_length() if code_n.size else 0
    lows = range(max(usual - 2, 0), min(usual + 1, _MOST_LOW) + 1)
    return min((int((code_n >> low).sum()) + low * code_n.size, low) for low in lows)
