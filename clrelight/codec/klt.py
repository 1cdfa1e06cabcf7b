"""Whitened principal-axis coding: what a scene does not need costs no bits."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.ballast import add_ballast, ballast_overhead, drop_ballast
from clrelight.codec.entropy import BitCounter, Decoder, Encoder
from clrelight.codec.factored import Factored
from clrelight.codec.lifting import (
    dequantise_map,
    empty_planes,
    forward_transform,
    list_subbands,
    quantise_map,
    transform_planes,
)
from clrelight.codec.metric import hemisphere_metric
from clrelight.codec.planes import Thrift, code_planes
from clrelight.codec.principal import (
    MAX_ENTRY,
    ROTATION_UNIT,
    Axes,
    Whitened,
    code_vectors,
    principal_axes,
    quantise_axes,
    solve_planes,
    whiten,
)
from clrelight.codec.registry import Codec, register
from clrelight.codec.subbands import Statistics, code_indices
from clrelight.codec.symbols import zero_order_bits
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

_VERSION = 3
_IN_PAIRS = 2  # the version whose planes are coded two by two
_HEAD = struct.Struct("<BBhfHbb")
_LEVELS = 5
_ROUNDING = 0.4  # the largest index that the encoder may take; see `Thrift`
_TRIED = 0.08
"""An axis along which pixels deviate less than this part of a step is not tried."""
_THRIFT = 0.18
"""Squared steps of error that a bit must save for an index not to be taken smaller."""
_MAX_TRIED = 1 << 24
"""Values of the planes that are tried at once: what bounds memory."""
_PRICE = 0.1
"""Squared steps of error that a bit must save for an axis to be coded."""
_MEAN_STEPS = 16  # the mean is quantised this much finer than the planes: its error is in every pixel
_BIAS_UNIT = 1.0 / 256.0
_LEAST_USED = 0.972
_AIM = 0.986
_MAX_TRIALS = 24
_STEP_RANGE = (2.0**-22, 2.0**3)


@register
@dataclass(frozen=True)
class Klt(Codec):
    """Whitened coordinates, their principal axes over coefficients and channels, 9/7 wavelet, range coding.

    One quantiser step for everything, in a metric where it costs the same image error everywhere. An axis is coded if
    what it saves in squared error is worth the bits of its plane and of its row in the table, however few pixels need
    it; the table is quantised and coded like the planes, which are then solved against it.

    Attributes
    ----------
    rate : float, optional
        Bits per coefficient not to be passed.
    byte_budget : int, optional
        Bytes not to be passed. At least 97% are used, unless the finest step needs less.
    step : float, optional
        Quantiser step in radiance times root steradian, relative to the largest coefficient's power of two.

    One of them is given; by default the rate is 0.1.
    """

    id: ClassVar[str] = "klt"
    summary: ClassVar[str] = "whitened principal axes, 9/7 wavelet and range coding: quality per byte"

    rate: float | None = None
    byte_budget: int | None = None
    step: float | None = None

    def __post_init__(self) -> None:
        given = [name for name in ("rate", "byte_budget", "step") if getattr(self, name) is not None]
        if len(given) > 1:
            raise InputError(f"klt takes one of rate, byte_budget and step, got {' and '.join(given)}")
        if not given:
            object.__setattr__(self, "rate", 0.1)
        for name in ("rate", "byte_budget", "step"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | float) and 0.0 < value < float("inf")):
                raise InputError(f"klt {name} must be a positive number, got {value!r}")
        if self.step is not None and not _STEP_RANGE[0] <= self.step <= _STEP_RANGE[1]:
            raise InputError(f"klt step must be {_STEP_RANGE[0]:g} to {_STEP_RANGE[1]:g}, got {self.step!r}")

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """See `Codec`; the step chosen and the number of planes are reported."""
        source, shape = _Source(coeffs_khwc, device), coeffs_khwc.shape
        if self.step is not None:
            body, planes = source.encode(self.step)
            return add_ballast(body, shape), {"step": float(self.step), "planes": float(planes)}
        budget = int(self.byte_budget if self.byte_budget is not None else (self.rate or 0.0) * coeffs_khwc.size / 8.0)
        body, info = source.encode_within(budget - ballast_overhead(shape))
        return add_ballast(body, shape, budget), info

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """See `Codec`."""
        return cls.decode_view(body, shape, device).to_coeffs(device)

    @classmethod
    def decode_view(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> Factored:
        """Return the planes and the matrix that make coefficients, or images, of them."""
        body = drop_ballast(body, shape)
        n_coeff, height, width, channel = shape
        metric = hemisphere_metric(n_coeff)
        component = len(metric.forward_jk)
        if len(body) < _HEAD.size + channel * channel:
            raise PayloadError(f"a klt body of {channel} channels has at least {_HEAD.size + channel**2} bytes")
        version, levels, exponent, step, count, *biases = _HEAD.unpack_from(body)
        if version not in (_IN_PAIRS, _VERSION):
            raise PayloadError(f"klt version {version} is not known, this program reads {_IN_PAIRS} and {_VERSION}")
        if not (1 <= levels <= _LEVELS and abs(exponent) <= 150 and _STEP_RANGE[0] <= step <= _STEP_RANGE[1]):
            raise PayloadError(f"a klt body cannot have {levels} levels, exponent {exponent} and step {step}")
        if count > channel * component or len(body) < _HEAD.size + channel * channel + count:
            raise PayloadError(f"a klt body of {len(body)} bytes cannot have {count} planes")
        at = _HEAD.size
        rotation_cc = np.frombuffer(body, "<i1", channel * channel, at).reshape(channel, channel)
        scales = np.frombuffer(body, "<u1", count, at + channel * channel)
        decoder = Decoder(body[at + channel * channel + count :])
        mean = code_vectors(decoder, (1, channel, component), None).ravel() * (step / _MEAN_STEPS)
        entries = code_vectors(decoder, (count, channel, component), None).reshape(count, channel * component)
        planes_jp = np.ones((count + 1, height * width), np.float32)
        if count:
            bands, in_planes = list_subbands(height, width, levels), (count, height, width)
            if version == _VERSION:
                index = code_planes(decoder, bands, in_planes, None)
            else:
                index = code_indices(decoder, Statistics(), bands, in_planes, None, group=2)
            planes_jp[:count] = _dequantise_planes(index, levels, step, biases, device)
        decoder.finish()
        vectors_jd = np.concatenate([Axes(entries, scales).vectors_jd, mean[None]])
        rotation = np.linalg.pinv(rotation_cc / ROTATION_UNIT)
        operator_kcj = np.einsum(
            "kn,cd,jdn->kcj",
            np.ldexp(metric.inverse_kj, exponent),
            rotation,
            vectors_jd.reshape(-1, channel, component),
            optimize=True,
        )
        if not np.abs(operator_kcj).max() <= np.finfo(np.float32).max or not np.isfinite(planes_jp).all():
            raise PayloadError("a klt body holds values beyond float32's range")
        return Factored(planes_jp, operator_kcj, height, width)


class _Source:
    """A map ready to be encoded at any step."""

    def __init__(self, coeffs_khwc: NDArray[np.float32], device: Device) -> None:
        self._shape, self._device = coeffs_khwc.shape, device
        largest = float(np.abs(coeffs_khwc).max())
        self._exponent = int(np.clip(np.frexp(largest)[1], -126, 126)) if largest else 0
        self._whitened: Whitened = whiten(coeffs_khwc, self._exponent, device)
        self._vectors, self._deviation = principal_axes(self._whitened)
        largest_mean = float(np.abs(self._whitened.mean_d).max())
        # Where pixels differ little from their mean, a rate asks for steps that the table of the mean cannot hold.
        self._finest_step = max(_STEP_RANGE[0], 1.01 * largest_mean * _MEAN_STEPS / MAX_ENTRY)

    def encode(self, step: float) -> tuple[bytes, int]:
        """Return the body at a step, and its number of planes."""
        step = float(np.float32(step))
        if step < self._finest_step:
            raise InputError(f"klt step must be {self._finest_step:.3g} or more for this map, got {step:g}")
        encoder = Encoder()
        axes, biases = self._code(encoder, step)
        count = len(axes.scales_j)
        head = _HEAD.pack(_VERSION, _LEVELS, self._exponent, step, count, *biases)
        return head + self._whitened.rotation_cc.tobytes() + axes.scales_j.tobytes() + encoder.to_bytes(), count

    def encode_within(self, budget: int) -> tuple[bytes, dict[str, float]]:
        """Return the body at the step that fills a budget of bytes best, and what was found."""
        finest, coarsest = np.log2(self._finest_step), np.log2(_STEP_RANGE[1])
        fine, coarse = finest, coarsest
        tried: list[tuple[float, float]] = []
        place = -5.0
        for _ in range(_MAX_TRIALS):
            size = self._count_bytes(2.0**place)
            tried.append((place, size))
            if size > budget:
                fine = max(fine, place)
            else:
                coarse = min(coarse, place)
                if size >= _LEAST_USED * budget:
                    break
            if coarse - fine < 1e-4:
                break
            place = _next_place(tried, fine, coarse, _AIM * max(budget, 1))
        for attempt in range(_MAX_TRIALS):
            body, planes = self.encode(2.0**coarse)
            if len(body) <= budget:
                return body, {"step": 2.0**coarse, "planes": float(planes)}
            coarse = min(coarse + 0.002 * 2**attempt, coarsest)
        raise InputError(f"klt needs {len(body)} bytes for this map even at its coarsest step, the budget is {budget}")

    def _count_bytes(self, step: float) -> float:
        counter = BitCounter()
        axes, _ = self._code(counter, float(np.float32(step)))
        fixed = _HEAD.size + self._whitened.rotation_cc.size + len(axes.scales_j)
        return fixed + counter.bits / 8.0 + 4.0

    def _code(self, coder: BitCounter | Encoder, step: float) -> tuple[Axes, tuple[int, int]]:
        n_coeff, height, width, channel = self._shape
        component = len(hemisphere_metric(n_coeff).forward_jk)
        axes, index, planes = self._quantise(step)
        count = len(axes.scales_j)
        mean = np.rint(self._whitened.mean_d * (_MEAN_STEPS / step)).astype(np.int64)
        code_vectors(coder, (1, channel, component), mean.reshape(1, channel, component))
        code_vectors(coder, (count, channel, component), axes.entries_jd.reshape(count, channel, component))
        if not count:
            return axes, (0, 0)
        thrift = Thrift(planes, _THRIFT)
        code_planes(coder, list_subbands(height, width, _LEVELS), index.shape, index, thrift)
        return axes, _measure_biases(index, planes)

    def _quantise(self, step: float) -> tuple[Axes, NDArray[np.int32], NDArray[np.float32]]:
        """Return the axes that pay, with their planes: indices, and values in steps, (n_axis, height, width)."""
        n_pixel = self._shape[1] * self._shape[2]
        tried = self._deviation > _TRIED * step
        vectors, deviation = self._vectors[tried], self._deviation[tried]
        # Each axis alone, in its exact coordinates: what its plane saves, less what its row's rounding costs.
        rough = quantise_axes(vectors, deviation, n_pixel, step)
        lost = n_pixel * (deviation / step) ** 2 * ((rough.vectors_jd - vectors) ** 2).sum(axis=1)
        worth = -lost
        at_once = max(_MAX_TRIED // n_pixel, 1)
        for some in (slice(first, first + at_once) for first in range(0, len(vectors), at_once)):
            exact = self._whitened.pixels_pd @ vectors[some].T.astype(np.float32)
            index, values = self._transform(exact, step)
            worth[some] += _saved(index, values) - _PRICE * _count_about(rough.entries_jd[some], index)
        axes = Axes(rough.entries_jd[worth > 0.0], rough.scales_j[worth > 0.0])
        index, values = self._transform(solve_planes(self._whitened, axes), step)
        pays = _saved(index, values) > _PRICE * _count_about(axes.entries_jd, index)
        return Axes(axes.entries_jd[pays], axes.scales_j[pays]), index[pays], values[pays]

    def _transform(self, planes_pj: NDArray[np.float32], step: float) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return the wavelet coefficients of planes: indices, and values in steps, (n_axis, height, width)."""
        _, height, width, _ = self._shape
        shape = (1, height, width, planes_pj.shape[1])
        if not planes_pj.size:
            return np.zeros((0, height, width), np.int32), np.zeros((0, height, width), np.float32)
        source = np.ascontiguousarray(planes_pj).reshape(shape)
        planes = forward_transform(source, np.ones(1, np.float32), _LEVELS, self._device)
        index = quantise_map(planes, 0, shape, step, _ROUNDING, self._device)
        values = self._device.download(planes)[:, :, :width]
        values *= np.float32(1.0 / step)
        return index, values


def _saved(index: NDArray[np.int32], values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return by how much each plane's indices lower the squared error of its values, both in steps."""
    return np.array([(q * (2.0 * v - q)).sum(dtype=np.float64) for q, v in zip(index, values, strict=True)])


def _count_about(entries_jd: NDArray[np.int64], index: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return about the bits of each axis: of its row in the table and of its plane."""
    pairs = zip(entries_jd, index, strict=True)
    return np.array([zero_order_bits(np.abs(row)) + zero_order_bits(np.abs(plane)) for row, plane in pairs])


def _next_place(tried: list[tuple[float, float]], fine: float, coarse: float, target: float) -> float:
    """Return the logarithm of the step to try next: secant in logarithms of step and size, kept in the bracket."""
    near = sorted(tried, key=lambda pair: abs(np.log(pair[1] / target)))[:2]
    place = near[0][0] + np.log2(near[0][1] / target)  # bytes fall about as the step grows
    if len(near) == 2 and near[0][1] != near[1][1]:
        slope = (near[1][0] - near[0][0]) / (np.log(near[1][1]) - np.log(near[0][1]))
        place = near[0][0] + slope * (np.log(target) - np.log(near[0][1]))
    if not fine < place < coarse:
        place = (fine + coarse) / 2.0
    return float(place)


def _measure_biases(index: NDArray[np.int32], planes: NDArray[np.float32]) -> tuple[int, int]:
    """Return by how much |q| = 1 and |q| > 1 lie above the mean of what they stand for, in 1/256 of a step."""
    sizes = np.abs(index)
    biases = []
    for chosen in (sizes == 1, sizes > 1):
        values = np.abs(planes[chosen])
        excess = float(sizes[chosen].mean()) - float(values.mean(dtype=np.float64)) if values.size else 0.0
        biases.append(int(np.clip(np.rint(excess / _BIAS_UNIT), -128, 127)))
    return biases[0], biases[1]


def _dequantise_planes(
    index: NDArray[np.int32], levels: int, step: float, biases: list[int], device: Device
) -> NDArray[np.float32]:
    count, height, width = index.shape
    planes = empty_planes((1, height, width, count), device)
    dequantise_map(planes, 0, index, step, (biases[0] * _BIAS_UNIT, biases[1] * _BIAS_UNIT), device)
    transform_planes("synthesise", planes, width, levels, device)
    return device.download(planes)[:, :, :width].reshape(count, height * width)
