"""Body 4 of the codec `klt`: planes in units, which stand alone."""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body, expect_parts
from clrelight.codec.entropy.range_coding import Decoder, Encoder
from clrelight.codec.entropy.units import LEVELS, list_units
from clrelight.codec.rooms import Shape
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.principal import MEAN_STEPS, STEP_RANGE, Axes, code_vectors, make_operator
from clrelight.codec.transforms.whitening import AXES
from clrelight.conventions import TRANSFERS
from clrelight.errors import PayloadError

VERSION = 4
_TOGETHER = 1 << 18
"""Pixels up to which all units are one stream: they learn from each other, one after another."""
_HEAD = struct.Struct("<BBhfHBI")
_SUM = struct.Struct("<H")


class Head(NamedTuple):
    """What a body starts with: the power of two, the step, the number of planes, the curve, and bytes of axes."""

    exponent: int
    step: float
    n_plane: int
    transfer: str
    axes_bytes: int

    def pack(self) -> bytes:
        """Return the bytes that `parse_head` takes."""
        curve = TRANSFERS.index(self.transfer)
        return _HEAD.pack(VERSION, LEVELS, self.exponent, self.step, self.n_plane, curve, self.axes_bytes)


HEAD_SIZE = _HEAD.size


def is_together(shape: Shape) -> bool:
    """Return whether all units of a map are one stream."""
    return shape[1] * shape[2] <= _TOGETHER


def count_streams(shape: Shape) -> int:
    """Return the number of streams of a map."""
    return 1 if is_together(shape) else len(list_units(shape[1], shape[2]))


@dataclass(frozen=True)
class Parsed:
    """A body in which streams can be found.

    Attributes
    ----------
    head : Head
    operator_kcj : ndarray, shape (n_coeff, channel, n_plane + 1), float64
        Makes coefficients of planes in steps; the last is of a plane that is 1 everywhere, and carries the mean.
    start_t : ndarray, shape (n_stream + 1,), int64
        Where each stream begins in the body, and where the last one ends.
    sum_t : ndarray, uint16
        Its CRC-16.
    """

    head: Head
    operator_kcj: NDArray[np.float64]
    start_t: NDArray[np.int64]
    sum_t: NDArray[np.uint16]


def pack_body(
    head: Head, rotation_cc: NDArray[np.int8], axes: Axes, mean: NDArray[np.int64], streams: list[bytes]
) -> bytes:
    """Return a body; the head's bytes of axes are filled in."""
    tables = pack_axes(rotation_cc, axes, mean)
    front = head._replace(axes_bytes=len(tables)).pack() + tables + pack_index(streams)
    return b"".join([front, _SUM.pack(binascii.crc_hqx(front, 0)), *streams])


def pack_axes(rotation_cc: NDArray[np.int8], axes: Axes, mean: NDArray[np.int64]) -> bytes:
    """Return the tables of a body."""
    channel, count = len(rotation_cc), len(axes.scales_j)
    shape = (channel, len(mean) // channel)
    encoder = Encoder()
    code_vectors(encoder, (1, *shape), mean.reshape(1, *shape))
    code_vectors(encoder, (count, *shape), axes.entries_jd.reshape(count, *shape))
    return rotation_cc.tobytes() + axes.scales_j.tobytes() + encoder.to_bytes()


def pack_index(streams: list[bytes]) -> bytes:
    """Return where streams lie: the length and the checksum of each."""
    index = bytearray()
    for stream in streams:
        size = len(stream)
        while size >= 128:
            index.append(size & 127 | 128)
            size >>= 7
        index.append(size)
        index += _SUM.pack(binascii.crc_hqx(stream, 0))
    return bytes(index)


def index_bytes(sizes: list[int]) -> int:
    """Return the bytes of an index of streams of such sizes, and of the checksum behind it."""
    return _SUM.size + sum(max(-(-size.bit_length() // 7), 1) + _SUM.size for size in sizes)


def parse_head(body: bytes, shape: Shape) -> Head:
    """Return the head of a body; PayloadError unless its tables can follow."""
    component = len(hemisphere_metric(shape[0], AXES).forward_jk)
    if len(body) < HEAD_SIZE:
        raise PayloadError(f"a klt body has at least {HEAD_SIZE} bytes, this one {len(body)}")
    _, levels, exponent, step, count, curve, size = _HEAD.unpack_from(body)
    if levels != LEVELS or abs(exponent) > 150 or not STEP_RANGE[0] <= step <= STEP_RANGE[1]:
        raise PayloadError(f"a klt body cannot have {levels} levels, exponent {exponent} and step {step}")
    if curve >= len(TRANSFERS):
        raise PayloadError(f"a klt body cannot have transfer curve {curve}")
    if count > shape[3] * component or size < shape[3] ** 2 + count:
        raise PayloadError(f"a klt body with {size} bytes of tables cannot have {count} planes")
    return Head(exponent, step, count, TRANSFERS[curve], size)


def parse_body(body: Body, shape: Shape) -> Parsed:
    """Return where a body's streams are, and what its planes mean; PayloadError if that makes no sense."""
    n_coeff, _, _, channel = shape
    head = parse_head(body[:HEAD_SIZE], shape)
    tables = body[HEAD_SIZE : HEAD_SIZE + head.axes_bytes]
    if len(tables) != head.axes_bytes:
        raise PayloadError(f"the klt body of {len(body)} bytes is cut short within its tables")
    operator_kcj = _read_tables(tables, head, n_coeff, channel)
    start_t, sum_t = _read_index(body, HEAD_SIZE + head.axes_bytes, count_streams(shape) if head.n_plane else 0)
    return Parsed(head, operator_kcj, start_t, sum_t)


def _read_tables(tables: bytes, head: Head, n_coeff: int, channel: int) -> NDArray[np.float64]:
    metric, count = hemisphere_metric(n_coeff, AXES), head.n_plane
    component = len(metric.forward_jk)
    rotation_cc = np.frombuffer(tables, "<i1", channel * channel).reshape(channel, channel)
    scales = np.frombuffer(tables, "<u1", count, channel * channel)
    decoder = Decoder(tables[channel * channel + count :])
    mean = code_vectors(decoder, (1, channel, component), None).ravel() / MEAN_STEPS
    entries = code_vectors(decoder, (count, channel, component), None).reshape(count, channel * component)
    decoder.finish()
    vectors_jd = np.concatenate([Axes(entries, scales).vectors_jd, mean[None]])
    return make_operator(np.ldexp(metric.inverse_kj, head.exponent) * head.step, rotation_cc, vectors_jd)


def _read_index(body: Body, at: int, count: int) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    index = body[at : at + (5 + _SUM.size) * count]
    place, sizes, sums = 0, [], []
    for _ in range(count):
        size = shift = 0
        while True:
            if place + 1 + _SUM.size > len(index) or shift > 28:
                raise PayloadError("the klt body's index of units is damaged")
            size |= (index[place] & 127) << shift
            place, shift = place + 1, shift + 7
            if index[place - 1] < 128:
                break
        sizes.append(size)
        sums.append(_SUM.unpack_from(index, place)[0])
        place += _SUM.size
    end = at + place
    if len(body) < end + _SUM.size or _SUM.unpack(body[end : end + _SUM.size])[0] != binascii.crc_hqx(body[:end], 0):
        raise PayloadError("the klt body's tables or its index of units are damaged")
    start_t = end + _SUM.size + np.concatenate([[0], np.cumsum(np.array(sizes, np.int64))]).astype(np.int64)
    if start_t[-1] != len(body):
        raise PayloadError(f"the klt body should have {start_t[-1]} bytes, it has {len(body)}")
    return start_t, np.array(sums, np.uint16)


def expect_streams(body: Body, parsed: Parsed, streams: list[int]) -> None:
    """Say which streams are read next, for bodies that are not at hand."""
    expect_parts(body, [(int(parsed.start_t[t]), int(parsed.start_t[t + 1])) for t in streams])


def read_stream(body: Body, parsed: Parsed, stream: int) -> bytes:
    """Return a stream's bytes; PayloadError if they are not those that were written."""
    content = body[int(parsed.start_t[stream]) : int(parsed.start_t[stream + 1])]
    if binascii.crc_hqx(content, 0) != parsed.sum_t[stream]:
        if len(parsed.sum_t) == 1:
            raise PayloadError("the klt body is damaged, and all of its units are one stream: none can be salvaged")
        raise PayloadError(f"unit {stream} of the klt body is damaged")
    return content
