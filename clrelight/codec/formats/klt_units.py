"""Body 4 of the codec `klt`: planes in units, which stand alone."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH
from clrelight.codec.bodies import Body
from clrelight.codec.entropy.range_coding import Decoder, Encoder
from clrelight.codec.entropy.unit_index import Stored, read_index, seal_front
from clrelight.codec.entropy.units import LEVELS, count_units
from clrelight.codec.transforms.metric import Metric, hemisphere_metric, metric_degree
from clrelight.codec.transforms.principal import (
    STEP_RANGE,
    Axes,
    code_by_shells,
    code_vectors,
    make_operator,
    mean_steps,
)
from clrelight.codec.transforms.whitening import AXES
from clrelight.codec.workspace import Shape
from clrelight.conventions import TRANSFERS
from clrelight.errors import InputError, PayloadError

VERSION = 4
BASES = ("sh", "hsh", "gram-schmidt", "zernike", "makhotkin", "haar")
"""What coefficients may be of, in the order of their numbers in bodies."""
_TOGETHER = 1 << 18
"""Pixels up to which all units are one stream: they learn from each other, one after another."""
_HEAD = struct.Struct("<BBhfHBI")
_LAST_TABLES = 2
"""Bodies whose operators are kept: 54 kB each at degree 6 with 45 planes, 33 MB at degree 25 with all."""
_BY_SHELLS = 8
"""Of the byte of curve and basis: mean and axes are coded by `code_by_shells`."""
_FINER_MEAN = 2
"""Of the same byte: the unit of the mean's fineness, which is 0 to 3."""


class Head(NamedTuple):
    """What a body starts with: the power of two, the step, the number of planes, the curve, bytes of axes, basis.

    `by_shells` says how mean and axes are coded; old bodies have them otherwise, and none of them a finer mean, which
    `clrelight.codec.transforms.principal.mean_steps` tells of.
    """

    exponent: int
    step: float
    n_plane: int
    transfer: str
    axes_bytes: int
    basis: str = SH
    by_shells: bool = True
    fineness: int = 0

    def pack(self) -> bytes:
        """Return the bytes that `parse_head` takes."""
        curve = TRANSFERS.index(self.transfer) + _FINER_MEAN * self.fineness
        curve += _BY_SHELLS * self.by_shells + 16 * BASES.index(self.basis)
        return _HEAD.pack(VERSION, LEVELS, self.exponent, self.step, self.n_plane, curve, self.axes_bytes)


HEAD_SIZE = _HEAD.size


def is_together(shape: Shape) -> bool:
    """Return whether all units of a map are one stream."""
    return shape[1] * shape[2] <= _TOGETHER


def count_streams(shape: Shape) -> int:
    """Return the number of streams of a map."""
    return 1 if is_together(shape) else count_units(shape[1], shape[2])


@dataclass(frozen=True)
class Parsed:
    """A body in which streams can be found.

    Attributes
    ----------
    head : Head
    operator_kcj : ndarray, shape (n_coeff, channel, n_plane + 1), float64
        Makes coefficients of planes in steps; the last is of a plane that is 1 everywhere, and carries the mean.
    stored : Stored
        Where streams lie.
    """

    head: Head
    operator_kcj: NDArray[np.float64]
    stored: Stored


def pack_body(head: Head, tables: bytes, streams: list[bytes]) -> bytes:
    """Return a body of what `pack_axes` gives and streams; the head's bytes of axes are filled in."""
    return seal_front(head._replace(axes_bytes=len(tables)).pack() + tables, streams)


def pack_axes(rotation_cc: NDArray[np.int8], axes: Axes, mean: NDArray[np.int64]) -> bytes:
    """Return the tables of a body."""
    channel, count = len(rotation_cc), len(axes.scales_j)
    shape = (channel, len(mean) // channel)
    encoder = Encoder()
    code_by_shells(encoder, (1, *shape), mean.reshape(1, *shape))
    code_by_shells(encoder, (count, *shape), axes.entries_jd.reshape(count, *shape))
    return rotation_cc.tobytes() + axes.scales_j.tobytes() + encoder.to_bytes()


def parse_head(body: bytes, shape: Shape) -> Head:
    """Return the head of a body; PayloadError unless its tables can follow."""
    metric_degree(shape[0])
    if len(body) < HEAD_SIZE:
        raise PayloadError(f"a klt body has at least {HEAD_SIZE} bytes, this one {len(body)}")
    _, levels, exponent, step, count, curve, size = _HEAD.unpack_from(body)
    if levels != LEVELS or abs(exponent) > 150 or not STEP_RANGE[0] <= step <= STEP_RANGE[1]:
        raise PayloadError(f"a klt body cannot have {levels} levels, exponent {exponent} and step {step}")
    number, curve = divmod(curve, 16)
    by_shells, curve = divmod(curve, _BY_SHELLS)
    fineness, curve = divmod(curve, _FINER_MEAN)
    if number >= len(BASES):
        raise PayloadError(f"a klt body cannot have transfer curve {curve} and basis {number}")
    component = len(_metric(shape[0], BASES[number]).forward_jk)
    if count > shape[3] * component or size < shape[3] ** 2 + count:
        raise PayloadError(f"a klt body with {size} bytes of tables cannot have {count} planes")
    return Head(exponent, step, count, TRANSFERS[curve], size, BASES[number], bool(by_shells), fineness)


def _metric(n_coeff: int, basis: str) -> Metric:
    try:
        return hemisphere_metric(n_coeff, AXES, basis)
    except InputError as error:
        raise PayloadError(f"a klt body cannot be of that basis: {error}") from None


def parse_body(body: Body, shape: Shape) -> Parsed:
    """Return where a body's streams are, and what its planes mean; PayloadError if that makes no sense."""
    n_coeff, _, _, channel = shape
    head = parse_head(body[:HEAD_SIZE], shape)
    tables = body[HEAD_SIZE : HEAD_SIZE + head.axes_bytes]
    if len(tables) != head.axes_bytes:
        raise PayloadError(f"the klt body of {len(body)} bytes is cut short within its tables")
    operator_kcj = _read_tables(tables, head, n_coeff, channel)
    n_stream = count_streams(shape) if head.n_plane else 0
    start_t, sum_t = read_index("klt", body, HEAD_SIZE + head.axes_bytes, n_stream)
    groups = [(0, head.n_plane)] if head.n_plane else []
    return Parsed(head, operator_kcj, Stored("klt", is_together(shape), groups, start_t, sum_t))


@lru_cache(maxsize=_LAST_TABLES)
def _read_tables(tables: bytes, head: Head, n_coeff: int, channel: int) -> NDArray[np.float64]:
    """Return the operator, which is not to be written: regions and pictures of a file ask for it again and again."""
    metric, count = _metric(n_coeff, head.basis), head.n_plane
    component = len(metric.forward_jk)
    rotation_cc = np.frombuffer(tables, "<i1", channel * channel).reshape(channel, channel)
    scales = np.frombuffer(tables, "<u1", count, channel * channel)
    decoder = Decoder(tables[channel * channel + count :])
    code = code_by_shells if head.by_shells else code_vectors
    mean = code(decoder, (1, channel, component), None).ravel() / mean_steps(head.fineness)
    entries = code(decoder, (count, channel, component), None).reshape(count, channel * component)
    decoder.finish()
    vectors_jd = np.concatenate([Axes(entries, scales).vectors_jd, mean[None]])
    operator_kcj = make_operator(np.ldexp(metric.inverse_kj, head.exponent) * head.step, rotation_cc, vectors_jd)
    operator_kcj.setflags(write=False)
    return operator_kcj
