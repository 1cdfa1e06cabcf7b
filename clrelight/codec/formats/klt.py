"""Whitened principal-axis coding: what a scene does not need costs no bits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.ballast import add_ballast, ballast_overhead, drop_ballast
from clrelight.codec.entropy.planes import Thrift, code_planes
from clrelight.codec.entropy.range_coding import BitCounter, Encoder
from clrelight.codec.entropy.symbols import zero_order_bits
from clrelight.codec.factored import Factored
from clrelight.codec.formats.klt_body import (
    BIAS_UNIT,
    HEAD_SIZE,
    LEVELS,
    MEAN_STEPS,
    STEP_RANGE,
    Head,
    decode_planes,
    parse_head,
)
from clrelight.codec.registry import Codec, register
from clrelight.codec.transforms.code_values import code_value_error, code_values_of, radiance_of
from clrelight.codec.transforms.lifting import forward_transform, list_subbands, quantise_map
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.principal import (
    MAX_ENTRY,
    Axes,
    Whitened,
    code_vectors,
    principal_axes,
    quantise_axes,
    solve_planes,
    whiten,
)
from clrelight.conventions import TRANSFERS
from clrelight.device import Device
from clrelight.errors import InputError

_ROUNDING = 0.4  # the largest index that the encoder may take; see `Thrift`
_TRIED = 0.08
"""An axis along which pixels deviate less than this part of a step is not tried."""
_THRIFT = 0.18
"""Squared steps of error that a bit must save for an index not to be taken smaller."""
_MAX_TRIED = 1 << 24
"""Values of the planes that are tried at once: what bounds memory."""
_PRICE = 0.1
"""Squared steps of error that a bit must save for an axis to be coded."""
_CODED = 4.0
"""Times the squared error of the way through a curve and back at which that way is not what to save at."""
_LEAST_USED = 0.972
_AIM = 0.986
_MAX_TRIALS = 24


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
    transfer : str, optional
        What errors are of; by default ``"linear"`` radiance. ``"srgb"`` codes the coefficients of sRGB code values,
        unless those of radiance leave less error of code values: a degree holds the bent function less well, which
        counts at fine steps and for few lights. Decoding gives linear radiance with either.

    One of rate, byte_budget and step is given; by default the rate is 0.1.
    """

    id: ClassVar[str] = "klt"
    summary: ClassVar[str] = "whitened principal axes, 9/7 wavelet and range coding: quality per byte"

    rate: float | None = None
    byte_budget: int | None = None
    step: float | None = None
    transfer: str | None = None

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
        if self.step is not None and not STEP_RANGE[0] <= self.step <= STEP_RANGE[1]:
            raise InputError(f"klt step must be {STEP_RANGE[0]:g} to {STEP_RANGE[1]:g}, got {self.step!r}")
        if self.transfer is not None and self.transfer not in TRANSFERS:
            raise InputError(f"klt transfer must be one of {', '.join(TRANSFERS)}, got {self.transfer!r}")

    def for_transfer(self, transfer: str) -> Klt:
        """See `Codec`."""
        return self if self.transfer is not None else replace(self, transfer=transfer)

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """See `Codec`; the step chosen and the number of planes are reported."""
        if self.transfer != "srgb":
            return self._encode_as("linear", coeffs_khwc, device)
        shape, values_khwc = coeffs_khwc.shape, code_values_of(coeffs_khwc, device)
        there_and_back = code_value_error(radiance_of(values_khwc, device), coeffs_khwc, device)
        bent = self._encode_as("srgb", values_khwc, device)
        del values_khwc  # as large as the map: room to decode in
        lost = code_value_error(self.decode_body(bent[0], shape, device), coeffs_khwc, device)
        if lost > _CODED * there_and_back:
            return bent
        try:
            plain = self._encode_as("linear", coeffs_khwc, device)
        except InputError:  # the step or budget is none for this way
            return bent
        left = code_value_error(self.decode_body(plain[0], shape, device), coeffs_khwc, device)
        return bent if lost < left else plain

    def _encode_as(
        self, transfer: str, coeffs_khwc: NDArray[np.float32], device: Device
    ) -> tuple[bytes, dict[str, float]]:
        shape, source = coeffs_khwc.shape, _Source(coeffs_khwc, transfer, device)
        if self.step is not None:
            body, planes = source.encode(self.step)
            return add_ballast(body, shape), {"step": float(self.step), "planes": float(planes)}
        budget = int(self.byte_budget if self.byte_budget is not None else (self.rate or 0.0) * coeffs_khwc.size / 8.0)
        body, info = source.encode_within(budget - ballast_overhead(shape))
        return add_ballast(body, shape, budget), info

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """See `Codec`."""
        view, head = decode_planes(body, shape, device)
        coeffs_khwc = view.to_coeffs(device)
        return radiance_of(coeffs_khwc, device) if head.transfer == "srgb" else coeffs_khwc

    @classmethod
    def decode_view(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> Factored | None:
        """Return the planes and the matrix that make coefficients, or images, of them; None behind a curve."""
        if parse_head(drop_ballast(body, shape), shape).transfer != "linear":
            return None
        return decode_planes(body, shape, device)[0]


class _Source:
    """A map ready to be encoded at any step."""

    def __init__(self, coeffs_khwc: NDArray[np.float32], transfer: str, device: Device) -> None:
        self._shape, self._transfer, self._device = coeffs_khwc.shape, transfer, device
        largest = float(np.abs(coeffs_khwc).max())
        self._exponent = int(np.clip(np.frexp(largest)[1], -126, 126)) if largest else 0
        self._whitened: Whitened = whiten(coeffs_khwc, self._exponent, device)
        self._vectors, self._deviation = principal_axes(self._whitened)
        largest_mean = float(np.abs(self._whitened.mean_d).max())
        # Where pixels differ little from their mean, a rate asks for steps that the table of the mean cannot hold.
        self._finest_step = max(STEP_RANGE[0], 1.01 * largest_mean * MEAN_STEPS / MAX_ENTRY)

    def encode(self, step: float) -> tuple[bytes, int]:
        """Return the body at a step, and its number of planes."""
        step = float(np.float32(step))
        if step < self._finest_step:
            raise InputError(f"klt step must be {self._finest_step:.3g} or more for this map, got {step:g}")
        encoder = Encoder()
        axes, biases = self._code(encoder, step)
        count = len(axes.scales_j)
        head = Head(self._exponent, step, count, biases, self._transfer)
        return head.pack() + self._whitened.rotation_cc.tobytes() + axes.scales_j.tobytes() + encoder.to_bytes(), count

    def encode_within(self, budget: int) -> tuple[bytes, dict[str, float]]:
        """Return the body at the step that fills a budget of bytes best, and what was found."""
        finest, coarsest = np.log2(self._finest_step), np.log2(STEP_RANGE[1])
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
        fixed = HEAD_SIZE + self._whitened.rotation_cc.size + len(axes.scales_j)
        return fixed + counter.bits / 8.0 + 4.0

    def _code(self, coder: BitCounter | Encoder, step: float) -> tuple[Axes, tuple[int, int]]:
        n_coeff, height, width, channel = self._shape
        component = len(hemisphere_metric(n_coeff).forward_jk)
        axes, index, planes = self._quantise(step)
        count = len(axes.scales_j)
        mean = np.rint(self._whitened.mean_d * (MEAN_STEPS / step)).astype(np.int64)
        code_vectors(coder, (1, channel, component), mean.reshape(1, channel, component))
        code_vectors(coder, (count, channel, component), axes.entries_jd.reshape(count, channel, component))
        if not count:
            return axes, (0, 0)
        thrift = Thrift(planes, _THRIFT)
        code_planes(coder, list_subbands(height, width, LEVELS), index.shape, index, thrift)
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
        planes = forward_transform(source, np.ones(1, np.float32), LEVELS, self._device)
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
        biases.append(int(np.clip(np.rint(excess / BIAS_UNIT), -128, 127)))
    return biases[0], biases[1]
