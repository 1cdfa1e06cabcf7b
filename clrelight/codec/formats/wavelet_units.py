"""Body 6 of the codec `wavelet`: maps in units, each with a step of its own."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body
from clrelight.codec.entropy.unit_index import LEAST_ENTRY, Stored, read_index, seal_front
from clrelight.codec.entropy.units import LEVELS, PRECINCT, count_units
from clrelight.codec.transforms.channels import count_angles, rotations_of
from clrelight.codec.workspace import Shape
from clrelight.errors import PayloadError

VERSION = 6
"""Bodies before begin with their number of levels, 1 to 5."""
MOST_TOGETHER = 1 << 18
"""Pixels up to which all units of a group of planes may be one stream."""
STEPS_PER_OCTAVE, _ZERO = 200, 180 * 200
"""The step of a code is 2 ** ((code - _ZERO) / STEPS_PER_OCTAVE)."""
ABSENT = 65535
"""Step code of a map that is zero."""
MOST_CHANNELS = 8
"""Channels up to which they may be rotated."""
MOST_COARSE = 12
LEAST_STREAM = 21
"""Bytes that a stream takes with its entry in the index, and the checksum behind that."""
_HEAD = struct.Struct("<BBBH")
_TOGETHER, _COARSE, _ROTATED, _EACH, _FINE = 1, 2, 4, 8, 16


@dataclass(frozen=True)
class Tables:
    """What stands in front of the index of streams.

    Attributes
    ----------
    code_k : ndarray, shape (n_coeff,), int64
        Step codes.
    angle_ma : ndarray, shape (n, n_angle), uint8 or uint16
        Rotations of the channels: none, one for all maps, or one for each that is not zero.
    together : bool
        Whether all units of a group are one stream.
    group : int
        Maps of a group.
    coarse_ml : ndarray, shape (n_present, channel, LEVELS), uint8, or None
        Bits of indices that are written as they are, from level 1 on.
    """

    code_k: NDArray[np.int64]
    angle_ma: NDArray[np.unsignedinteger]
    together: bool
    group: int
    coarse_ml: NDArray[np.uint8] | None = None

    @property
    def present_m(self) -> NDArray[np.int64]:
        """Numbers of the maps that are not zero."""
        return np.flatnonzero(self.code_k != ABSENT)

    def spans(self, channel: int) -> list[tuple[int, int]]:
        """Return the first plane of each group, and the one behind its last."""
        count = len(self.present_m)
        return [(first * channel, min(first + self.group, count) * channel) for first in range(0, count, self.group)]

    def places(self, channel: int) -> NDArray[np.int32]:
        """Return the plane of each component of each map, (n_coeff, channel), -1 where there is none.

        Of a group, first components of all its maps come first, then the second ones.
        """
        count = len(self.present_m)
        number_m = np.arange(count)
        group_m, within_m = np.divmod(number_m, self.group)
        size_m = np.minimum(count - group_m * self.group, self.group)
        first_m = group_m * self.group * channel + within_m
        place_kd = np.full((len(self.code_k), channel), -1, np.int32)
        place_kd[self.present_m] = first_m[:, None] + size_m[:, None] * np.arange(channel)
        return place_kd

    def rotations(self, channel: int) -> NDArray[np.float64] | None:
        """Return the rotation of each map's channels, (n_coeff, component, channel); None where there is none."""
        if not len(self.angle_ma):
            return None
        rotation_mdc = rotations_of(self.angle_ma, channel)
        found = np.broadcast_to(np.eye(channel), (len(self.code_k), channel, channel)).copy()
        found[self.present_m] = rotation_mdc
        return found

    def coarse(self, channel: int) -> NDArray[np.int32] | None:
        """Return the same bits by plane and level, (n_plane, LEVELS + 1), with LL first."""
        if self.coarse_ml is None:
            return None
        coarse_jl = np.zeros((self.coarse_ml.shape[0] * channel, LEVELS + 1), np.int32)
        coarse_jl[self.places(channel)[self.present_m].ravel(), 1:] = self.coarse_ml.reshape(-1, LEVELS)
        return coarse_jl

    def pack(self) -> bytes:
        """Return the bytes that `parse_body` takes."""
        flags = _TOGETHER * self.together + _COARSE * (self.coarse_ml is not None)
        if len(self.angle_ma):
            each = len(self.angle_ma) != 1 or len(self.present_m) == 1
            flags |= _ROTATED | _EACH * each | _FINE * (self.angle_ma.dtype.itemsize == 2)
        head = _HEAD.pack(VERSION, LEVELS, flags, self.group)
        parts = [
            head,
            self.code_k.astype("<u2").tobytes(),
            self.angle_ma.astype(f"<u{self.angle_ma.dtype.itemsize}").tobytes(),
        ]
        return b"".join([*parts, b"" if self.coarse_ml is None else self.coarse_ml.tobytes()])


def table_bytes(n_coeff: int) -> int:
    """Return the bytes of tables at the least."""
    return _HEAD.size + 2 * n_coeff


def step_of(code: NDArray[np.integer] | int) -> NDArray[np.float64]:
    """Return the steps of codes."""
    return np.exp2((np.asarray(code, np.float64) - _ZERO) / STEPS_PER_OCTAVE)


def code_of(step_log: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the codes next to logarithms of steps, to base 2."""
    return np.clip(np.rint(step_log * STEPS_PER_OCTAVE + _ZERO), 0, ABSENT - 1).astype(np.int64)


def is_in_units(body: Body) -> bool:
    """Return whether a body is one of these."""
    return body[:1] == bytes([VERSION])


def count_streams(shape: Shape, tables: Tables) -> int:
    """Return the number of streams of a map."""
    groups = -(-len(tables.present_m) // tables.group)
    return groups if tables.together else groups * count_units(shape[1], shape[2])


def pack_body(tables: Tables, streams: list[bytes]) -> bytes:
    """Return a body."""
    return seal_front(tables.pack(), streams)


def parse_body(body: Body, shape: Shape) -> tuple[Tables, Stored]:
    """Return what a body's planes mean, and where its streams are; PayloadError if that makes no sense."""
    n_coeff, height, width, channel = shape
    if len(body) < table_bytes(n_coeff):
        raise PayloadError(f"the wavelet tables of {n_coeff} maps take more than the {len(body)} bytes of the body")
    _, levels, flags, group = _HEAD.unpack(body[: _HEAD.size])
    at = table_bytes(n_coeff)
    code_k = np.frombuffer(body[_HEAD.size : at], "<u2").astype(np.int64)
    n_present = int((code_k != ABSENT).sum())
    together = bool(flags & _TOGETHER)
    if levels != LEVELS or flags >= 32 or not group or (together and height * width > MOST_TOGETHER):
        raise PayloadError(f"a wavelet body cannot have {levels} levels, flags {flags} and groups of {group} maps")
    if (not flags & _ROTATED and flags & (_EACH | _FINE)) or (flags & _ROTATED and channel > MOST_CHANNELS):
        raise PayloadError(f"a wavelet body of {channel} channels cannot have flags {flags}")
    n_rotation = 0 if not flags & _ROTATED else n_present if flags & _EACH else min(n_present, 1)
    angle_type = "<u2" if flags & _FINE else "<u1"
    n_angle, n_coarse = count_angles(channel), n_present * channel * LEVELS * bool(flags & _COARSE)
    end = at + n_rotation * n_angle * np.dtype(angle_type).itemsize
    angles, coarse = body[at:end], body[end : end + n_coarse]
    if len(coarse) != n_coarse or end > len(body):
        raise PayloadError(f"the wavelet body of {len(body)} bytes is cut short within its tables")
    angle_ma = np.frombuffer(angles, angle_type).reshape(n_rotation, n_angle if n_rotation else 0)
    coarse_ml = np.frombuffer(coarse, np.uint8).reshape(n_present, channel, LEVELS) if n_coarse else None
    if coarse_ml is not None and coarse_ml.max() > MOST_COARSE:
        raise PayloadError(f"a wavelet body cannot leave {coarse_ml.max()} bits as they are")
    tables = Tables(code_k, angle_ma, together, group, coarse_ml)
    least = math.ceil(n_present / group) * (1 if together else -(-height // PRECINCT) * -(-width // PRECINCT) * LEVELS)
    if least * LEAST_ENTRY > len(body):
        raise PayloadError(f"the wavelet body of {len(body)} bytes is cut short within its index of units")
    start_t, sum_t = read_index("wavelet", body, end + n_coarse, count_streams(shape, tables))
    stored = Stored("wavelet", together, tables.spans(channel), start_t, sum_t, tables.coarse(channel))
    return tables, stored
