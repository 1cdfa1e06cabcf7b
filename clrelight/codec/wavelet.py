"""The wavelet codec: CDF 9/7, a uniform quantiser, adaptive range coding, at a rate asked for."""

from __future__ import annotations

import functools
import struct
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy import BitCounter, Decoder, Encoder, zero_order_bits
from clrelight.codec.lifting import (
    Subband,
    dequantise_map,
    empty_planes,
    forward_transform,
    inverse_transform,
    list_subbands,
    quantise_map,
)
from clrelight.codec.rate import COARSEST_CODE, STEPS_PER_OCTAVE, Sample, find_code, step_of
from clrelight.codec.registry import Codec, register
from clrelight.codec.subbands import Statistics, code_indices
from clrelight.device import Device, DeviceArray
from clrelight.errors import InputError, PayloadError

ALLOCATIONS = ("map", "global")
MAX_LEVELS = 5  # more would pass 31 bits at the finest step

_ROUNDING = 0.4  # a dead zone of 1.2 steps: best at 0.1 to 1 bit, and 0.02 dB from the best at 4
_ABSENT = 65535  # step code of a map that is zero
_AIM, _TOLERANCE = 0.996, 0.003  # of the bytes asked: near the middle of what is allowed, and how near is enough
_MAP_TOLERANCE, _MAP_SLACK = 0.006, 12.0  # of one map's share, and bits; the next maps make up for it
_ATTEMPTS = 6  # to stay below the bytes asked, though words are coarser than the bits counted
_BIAS_SCALE = 256.0


@register
@dataclass(frozen=True)
class Wavelet(Codec):
    """CDF 9/7 subbands, one quantiser step per map, context-modelled range coding.

    Attributes
    ----------
    rate : float
        Bits per coefficient asked for; what is made lies within 1% below, side tables included.
    allocation : str
        ``"map"``: every map gets the same rate (the paper's setting, section III-B). Maps that cannot use theirs
        even at float32's own precision hand the rest equally to the others. ``"global"``: one step for all maps.
    levels : int
        Wavelet levels, 1 to 5; 3 make the paper's 10 subbands.

    Notes
    -----
    The 1% holds from about 1 kB of body up; below that the range coder's 4-byte words are coarser. Where all maps are
    coded to full precision (step 2**-22 of the largest magnitude; with one step for all: of the largest map) the
    size stays below the rate. Side tables too large for the rate are an InputError.

    Body: levels (1 byte), two reconstruction biases (2); an exponent of each map (1 each), their step codes (2 each);
    range-coded indices. Maps with the finest step come first, then the others, both in index order.
    """

    id: ClassVar[str] = "wavelet"
    summary: ClassVar[str] = "9/7 wavelet, uniform quantiser and range coding at a given rate"

    rate: float = 4.0
    allocation: str = "map"
    levels: int = 3

    def __post_init__(self) -> None:
        if not (isinstance(self.rate, int | float) and 0.0 < self.rate < float("inf")):
            raise InputError(f"the wavelet rate must be a positive number of bits per coefficient, got {self.rate!r}")
        if self.allocation not in ALLOCATIONS:
            raise InputError(f"the wavelet allocation must be one of {', '.join(ALLOCATIONS)}, got {self.allocation!r}")
        if not (isinstance(self.levels, int) and 1 <= self.levels <= MAX_LEVELS):
            raise InputError(f"wavelet levels must be 1 to {MAX_LEVELS}, got {self.levels!r}")

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """See `Codec`; `entropy_bits` is the zero-order entropy, subband by subband, of the indices coded."""
        shape = coeffs_khwc.shape
        available = int(self.rate * coeffs_khwc.size / 8)
        tables = _Tables.size(shape[0])
        if available < tables:
            least = 8.0 * tables / coeffs_khwc.size
            raise InputError(
                f"{self.rate:g} bits per coefficient are too few for maps of shape {shape}: "
                f"their side tables alone take {least:.4g}"
            )
        exponents = _exponents(coeffs_khwc)
        planes = forward_transform(coeffs_khwc, np.ldexp(np.float32(1.0), -exponents), self.levels, device)
        maps = _TransformedMaps(planes, shape, list_subbands(shape[1], shape[2], self.levels), device)
        budget = 8 * (available - tables)
        search = _search_map_steps if self.allocation == "map" else _search_global_step
        codes, payload = search(maps, exponents, _present(coeffs_khwc), 8 * available, budget)
        biases, entropy = maps.measure(codes)
        body = _Tables(self.levels, biases, exponents, codes).to_bytes() + payload
        return body, {"entropy_bits": entropy / coeffs_khwc.size}

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """See `Codec`."""
        tables, payload = _Tables.from_bytes(body, shape[0])
        _, height, width, channels = shape
        bands = list_subbands(height, width, tables.levels)
        biases = (tables.biases[0] / _BIAS_SCALE, tables.biases[1] / _BIAS_SCALE)
        decoder, shared = Decoder(payload), Statistics()
        planes = empty_planes(shape, device)
        zeros = np.zeros((channels, height, width), np.int32)
        for k in _coding_order(tables.codes):
            code = int(tables.codes[k])
            if code == _ABSENT:
                dequantise_map(planes, k, zeros, 0.0, (0.0, 0.0), device)
                continue
            index = code_indices(decoder, _statistics_for(code, shared), bands, (channels, height, width), None)
            dequantise_map(planes, k, index, step_of(code), biases, device)
        decoder.finish()
        return inverse_transform(planes, shape, np.ldexp(np.float32(1.0), tables.exponents), tables.levels, device)


@dataclass(frozen=True)
class _Tables:
    """What stands in front of the range-coded bytes."""

    levels: int
    biases: tuple[int, int]
    exponents: NDArray[np.integer]
    codes: NDArray[np.integer]

    @staticmethod
    def size(n_coeff: int) -> int:
        return 3 + 3 * n_coeff

    def to_bytes(self) -> bytes:
        head = struct.pack("<Bbb", self.levels, *self.biases)
        return head + self.exponents.astype("<i1").tobytes() + self.codes.astype("<u2").tobytes()

    @classmethod
    def from_bytes(cls, body: bytes, n_coeff: int) -> tuple[_Tables, bytes]:
        if len(body) < cls.size(n_coeff):
            raise PayloadError(f"the wavelet side tables need {cls.size(n_coeff)} bytes, the body has {len(body)}")
        levels, *biases = struct.unpack_from("<Bbb", body)
        if not 1 <= levels <= MAX_LEVELS:
            raise PayloadError(f"wavelet levels must be 1 to {MAX_LEVELS}, the body says {levels}")
        exponents = np.frombuffer(body, "<i1", n_coeff, 3).astype(np.int32)
        codes = np.frombuffer(body, "<u2", n_coeff, 3 + n_coeff).astype(np.int64)
        if exponents.min() < -126:
            raise PayloadError(f"wavelet exponents must be -126 to 127, the body has {exponents.min()}")
        return cls(levels, (biases[0], biases[1]), exponents, codes), body[cls.size(n_coeff) :]


class _TransformedMaps:
    """Wavelet coefficients of all maps, quantised as asked."""

    def __init__(
        self, planes: DeviceArray, shape: tuple[int, int, int, int], bands: list[Subband], device: Device
    ) -> None:
        self._planes, self._shape, self._bands, self._device = planes, shape, bands, device
        self._host = device.download(planes)[:, :, : shape[2]]

    def sample(self, k: int) -> Sample:
        return Sample(self._values(k), _ROUNDING)

    def run(self, coder: BitCounter | Encoder, statistics: Statistics, k: int, code: int) -> None:
        """Code one map."""
        index = quantise_map(self._planes, k, self._shape, step_of(code), _ROUNDING, self._device)
        code_indices(coder, statistics, self._bands, index.shape, index)

    def measure(self, codes: NDArray[np.integer]) -> tuple[tuple[int, int], float]:
        """Return the biases in 1/256 step, and the zero-order entropy of all indices in bits."""
        excess, counts, entropy = np.zeros(2), np.zeros(2), 0.0
        for k in np.flatnonzero(codes != _ABSENT).tolist():
            step = step_of(int(codes[k]))
            magnitudes = np.abs(quantise_map(self._planes, k, self._shape, step, _ROUNDING, self._device))
            for plane in magnitudes:
                entropy += sum(zero_order_bits(plane[band.rows, band.columns]) for band in self._bands)
            difference = magnitudes - np.abs(self._values(k)) * np.float32(1.0 / step)
            for i, chosen in enumerate((magnitudes == 1, magnitudes > 1)):
                excess[i] += float(difference.sum(where=chosen, dtype=np.float64))
                counts[i] += np.count_nonzero(chosen)
        biases = np.clip(np.rint(_BIAS_SCALE * excess / np.maximum(counts, 1.0)), -128, 127).astype(int)
        return (int(biases[0]), int(biases[1])), entropy

    def _values(self, k: int) -> NDArray[np.float32]:
        channels = self._shape[3]
        return self._host[k * channels : (k + 1) * channels]


def _exponents(coeffs_khwc: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return e of each map with ``2**e <= max|map| < 2**(e+1)``, within what float32 can scale by and back."""
    largest = np.maximum(coeffs_khwc.max(axis=(1, 2, 3)), -coeffs_khwc.min(axis=(1, 2, 3)))
    return np.clip(np.frexp(largest)[1] - 1, -126, 126).astype(np.int32)


def _present(coeffs_khwc: NDArray[np.float32]) -> list[int]:
    return [k for k, plane in enumerate(coeffs_khwc) if plane.any()]


def _coding_order(codes: NDArray[np.integer]) -> list[int]:
    return np.argsort(codes != 0, kind="stable").tolist()


def _statistics_for(code: int, shared: Statistics) -> Statistics:
    """Return what a map learns into: at the finest step it is unlike the others, and learns alone."""
    return Statistics() if code == 0 else shared


def _count(maps: _TransformedMaps, statistics: Statistics, k: int, code: int) -> float:
    counter = BitCounter()
    maps.run(counter, statistics.copy(), k, code)
    return counter.bits


def _search_map_steps(
    maps: _TransformedMaps, exponents: NDArray[np.integer], present: list[int], asked: int, budget: int
) -> tuple[NDArray[np.int64], bytes]:
    """Spend alike on every map: each aims at an equal share of what is left."""
    codes = np.full(len(exponents), _ABSENT, np.int64)
    samples = {k: maps.sample(k) for k in present}
    limited = _find_limited(maps, samples, budget)
    codes[limited] = 0
    encoder, statistics, ratio = Encoder(), Statistics(), 0.8
    for k in limited:
        maps.run(encoder, Statistics(), k, 0)
    others = [k for k in present if k not in limited]
    for done, k in enumerate(others):
        spent = 8 * encoder.byte_count
        target = (budget - (1.0 - _AIM) * asked - spent) / (len(others) - done)
        tolerance = min(_MAP_TOLERANCE * asked / len(others) + _MAP_SLACK, _TOLERANCE * asked)
        for margin in range(0, 32 * _ATTEMPTS, 32):
            code, ratio = find_code(
                functools.partial(_count, maps, statistics, k),
                samples[k].bits,
                target,
                budget - spent - margin,
                tolerance,
                ratio,
                1,
            )
            if code is None:
                break
            attempt, learnt = encoder.copy(), statistics.copy()
            maps.run(attempt, learnt, k, code)
            if 8 * attempt.byte_count <= budget:
                codes[k], encoder, statistics = code, attempt, learnt
                break
    return codes, encoder.to_bytes()


def _find_limited(maps: _TransformedMaps, samples: dict[int, Sample], budget: int) -> list[int]:
    """Return the maps that cannot use an equal share, what they leave being shared by the others."""
    full = {k: sample.bits(0) for k, sample in samples.items()}
    counted: set[int] = set()
    limited: list[int] = []
    left = float(budget)
    for k in sorted(full, key=lambda k: (full[k], k)):
        share = left / (len(full) - len(limited))
        if full[k] > 3.0 * share:
            break
        counted.add(k)
        bits = _count(maps, Statistics(), k, 0)
        if bits <= share:
            limited.append(k)
            left -= bits
    return sorted(limited)


def _search_global_step(
    maps: _TransformedMaps, exponents: NDArray[np.integer], present: list[int], asked: int, budget: int
) -> tuple[NDArray[np.int64], bytes]:
    """One step, in the coefficients' own unit, for all maps."""
    samples = {k: maps.sample(k) for k in present}
    largest = max((int(exponents[k]) for k in present), default=0)

    def codes_of(code: int) -> NDArray[np.int64]:
        """Return the codes of the maps' own scales for the code of the largest map."""
        own = code + STEPS_PER_OCTAVE * (largest - exponents.astype(np.int64))
        own = np.where(own > COARSEST_CODE, _ABSENT, own)
        absent = np.setdiff1d(np.arange(len(own)), present)
        own[absent] = _ABSENT
        return own

    def run(coder: BitCounter | Encoder, code: int) -> None:
        codes, shared = codes_of(code), Statistics()
        for k in _coding_order(codes):
            if codes[k] != _ABSENT:
                maps.run(coder, _statistics_for(int(codes[k]), shared), k, int(codes[k]))

    def count(code: int) -> float:
        counter = BitCounter()
        run(counter, code)
        return counter.bits

    def guess(code: int) -> float:
        codes = codes_of(code)
        return sum(sample.bits(int(codes[k])) for k, sample in samples.items() if codes[k] != _ABSENT)

    for margin in range(0, 32 * _ATTEMPTS, 32):
        target = budget - (1.0 - _AIM) * asked
        code, _ = find_code(count, guess, target, budget - margin, _TOLERANCE * asked, 0.8, 0)
        if code is None:
            break
        encoder = Encoder()
        run(encoder, code)
        if 8 * encoder.byte_count <= budget:
            return codes_of(code), encoder.to_bytes()
    return np.full(len(exponents), _ABSENT, np.int64), b""
