"""Bodies 2 and 3 of the codec `klt`, which it wrote before: what stands in them, and how they are decoded."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.planes import code_planes
from clrelight.codec.entropy.range_coding import Decoder
from clrelight.codec.entropy.subbands import Statistics, code_indices
from clrelight.codec.factored import Factored
from clrelight.codec.transforms.lifting import dequantise_map, empty_planes, list_subbands, transform_planes
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.principal import MEAN_STEPS, STEP_RANGE, Axes, code_vectors, make_operator
from clrelight.codec.workspace import Shape
from clrelight.conventions import TRANSFERS
from clrelight.device import Device
from clrelight.errors import PayloadError

LEVELS = 5
BIAS_UNIT = 1.0 / 256.0

_VERSION = 3
_IN_PAIRS = 2
"""The version whose planes are coded two by two, and whose head names no transfer curve."""
_HEAD = struct.Struct("<BBhfHbb")


class Head(NamedTuple):
    """What a body starts with.

    Attributes
    ----------
    exponent : int
        Power of two that coefficients were divided by.
    step : float
        Quantiser step of the divided coefficients.
    n_plane : int
        Number of planes.
    biases : tuple of int
        How far indices of 1, and larger ones, lie above what they stand for, in `BIAS_UNIT` steps.
    transfer : str
        Curve behind which the coefficients are coded.
    levels, version : int
        Of the wavelet transform, and of the body.
    """

    exponent: int
    step: float
    n_plane: int
    biases: tuple[int, int]
    transfer: str
    levels: int
    version: int

    @property
    def size(self) -> int:
        """Bytes in front of the tables."""
        return _HEAD.size + (self.version != _IN_PAIRS)


def parse_head(body: bytes, shape: Shape) -> Head:
    """Return the head of a body without its padding; PayloadError unless its tables can follow."""
    n_coeff, _, _, channel = shape
    component = len(hemisphere_metric(n_coeff).forward_jk)
    if len(body) < _HEAD.size + channel * channel:
        raise PayloadError(f"a klt body of {channel} channels has at least {_HEAD.size + channel**2} bytes")
    version, levels, exponent, step, count, *biases = _HEAD.unpack_from(body)
    if version not in (_IN_PAIRS, _VERSION):
        raise PayloadError(f"klt version {version} is not known, this program reads {_IN_PAIRS} and {_VERSION}")
    if not (1 <= levels <= LEVELS and abs(exponent) <= 150 and STEP_RANGE[0] <= step <= STEP_RANGE[1]):
        raise PayloadError(f"a klt body cannot have {levels} levels, exponent {exponent} and step {step}")
    curve = 0 if version == _IN_PAIRS else body[_HEAD.size]
    if curve >= len(TRANSFERS):
        raise PayloadError(f"a klt body cannot have transfer curve {curve}")
    head = Head(exponent, step, count, (biases[0], biases[1]), TRANSFERS[curve], levels, version)
    if count > channel * component or len(body) < head.size + channel * channel + count:
        raise PayloadError(f"a klt body of {len(body)} bytes cannot have {count} planes")
    return head


def decode_planes(body: bytes, shape: Shape, device: Device) -> tuple[Factored, Head]:
    """Return the maps that are coded, and the head; PayloadError if the body does not make sense."""
    n_coeff, height, width, channel = shape
    metric = hemisphere_metric(n_coeff)
    component = len(metric.forward_jk)
    head = parse_head(body, shape)
    count, step, at = head.n_plane, head.step, head.size
    rotation_cc = np.frombuffer(body, "<i1", channel * channel, at).reshape(channel, channel)
    scales = np.frombuffer(body, "<u1", count, at + channel * channel)
    decoder = Decoder(body[at + channel * channel + count :])
    mean = code_vectors(decoder, (1, channel, component), None).ravel() * (step / MEAN_STEPS)
    entries = code_vectors(decoder, (count, channel, component), None).reshape(count, channel * component)
    planes_jp = np.ones((count + 1, height * width), np.float32)
    if count:
        bands, in_planes = list_subbands(height, width, head.levels), (count, height, width)
        if head.version == _VERSION:
            index = code_planes(decoder, bands, in_planes, None)
        else:
            index = code_indices(decoder, Statistics(), bands, in_planes, None, group=2)
        planes_jp[:count] = _dequantise_planes(index, head.levels, step, head.biases, device)
    decoder.finish()
    vectors_jd = np.concatenate([Axes(entries, scales).vectors_jd, mean[None]])
    operator_kcj = make_operator(np.ldexp(metric.inverse_kj, head.exponent), rotation_cc, vectors_jd)
    if not np.isfinite(planes_jp).all():
        raise PayloadError("a klt body holds values beyond float32's range")
    return Factored(planes_jp, operator_kcj, height, width), head


def _dequantise_planes(
    index: NDArray[np.int32], levels: int, step: float, biases: tuple[int, int], device: Device
) -> NDArray[np.float32]:
    count, height, width = index.shape
    planes = empty_planes((1, height, width, count), device)
    dequantise_map(planes, 0, index, step, (biases[0] * BIAS_UNIT, biases[1] * BIAS_UNIT), device)
    transform_planes("synthesise", planes, width, levels, device)
    return device.download(planes)[:, :, :width].reshape(count, height * width)
