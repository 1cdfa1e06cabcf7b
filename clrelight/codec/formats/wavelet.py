"""The wavelet codec: CDF 9/7, a uniform quantiser, adaptive range coding, at a rate asked for."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.ballast import add_ballast, ballast_overhead, drop_ballast
from clrelight.codec.bodies import Body, BodyWriter
from clrelight.codec.entropy.subband_kernel import decoder_for
from clrelight.codec.entropy.subbands import Statistics, code_indices
from clrelight.codec.rate.allocation import (
    ABSENT,
    BIAS_SCALE,
    TransformedMaps,
    coding_order,
    spend_alike,
    spend_by_one_step,
    statistics_for,
)
from clrelight.codec.rate.expectation import expect_codes, expect_moments
from clrelight.codec.rate.noise import Noise
from clrelight.codec.rate.step_search import step_of
from clrelight.codec.registry import PartsCodec, register
from clrelight.codec.streams import Source, Target
from clrelight.codec.transforms.lifting import (
    dequantise_map,
    empty_planes,
    forward_transform,
    inverse_transform,
    list_subbands,
    padded_width,
)
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

ALLOCATIONS = ("map", "global")
MAX_LEVELS = 5  # more would pass 31 bits at the finest step


@register
@dataclass(frozen=True)
class Wavelet(PartsCodec):
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

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """See `Codec`; `entropy_bits` is the zero-order entropy, subband by subband, of the indices coded."""
        asked, budget = self._spendable(source.shape)
        maps, exponents = self._transform(source)
        spend = spend_alike if self.allocation == "map" else spend_by_one_step
        codes, payload = spend(maps, exponents, asked, budget)
        biases, entropy = maps.measure(codes)
        coded = _Tables(self.levels, biases, exponents, codes).to_bytes() + payload
        body.write_all(add_ballast(coded, source.shape, self._bound(source.shape)))
        return {"entropy_bits": entropy / maps.size}

    def predict_noise(self, source: Source) -> Noise:
        """See `Codec`; quantiser noise and what dead zones swallow, at the steps that the rate should ask for."""
        asked, budget = self._spendable(source.shape)
        maps, exponents = self._transform(source)
        codes, spread = expect_codes(maps, exponents, asked, budget, self.allocation)
        return Noise.of_coefficients(expect_moments(maps, codes, spread, exponents))

    def _bound(self, shape: tuple[int, int, int, int]) -> int:
        """Return the bytes asked for in all."""
        return int(self.rate * math.prod(shape) / 8)

    def _spendable(self, shape: tuple[int, int, int, int]) -> tuple[int, int]:
        """Return the bits asked for in all, and what side tables leave of them."""
        available = self._bound(shape) - ballast_overhead(shape)
        tables = _Tables.size(shape[0])
        if available < tables:
            least = 8.0 * tables / math.prod(shape)
            raise InputError(
                f"{self.rate:g} bits per coefficient are too few for maps of shape {shape}: "
                f"their side tables alone take {least:.4g}"
            )
        return 8 * available, 8 * (available - tables)

    def _transform(self, source: Source) -> tuple[TransformedMaps, NDArray[np.int32]]:
        """Return the maps in subbands, and the powers of two that they were divided by."""

        def transform() -> tuple[TransformedMaps, NDArray[np.int32]]:
            n_coeff, height, width, channel = source.shape
            planes = source.room.make_planes((n_coeff, channel, height, padded_width(width)))
            exponents = np.empty(n_coeff, np.int32)
            for part in source.map_parts():
                coeffs_khwc = source.maps(part.start, part.stop)
                exponents[part] = _exponents(coeffs_khwc)
                scale_k = np.ldexp(np.float32(1.0), -exponents[part])
                transformed = forward_transform(coeffs_khwc, scale_k, self.levels, source.device)
                planes.put_maps(part.start, source.device.download(transformed).reshape(-1, *planes.shape[1:]))
            return TransformedMaps(planes, source, list_subbands(height, width, self.levels)), exponents

        return source.remember(("wavelet", self.levels), transform)

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """See `Codec`; map by map."""
        tables, payload = _Tables.from_bytes(drop_ballast(body, target.shape)[:], target.shape[0])
        n_coeff, height, width, channels = target.shape
        bands = list_subbands(height, width, tables.levels)
        biases = (tables.biases[0] / BIAS_SCALE, tables.biases[1] / BIAS_SCALE)
        decoder, shared = decoder_for(payload, device), Statistics()
        one = (1, height, width, channels)
        for done, k in enumerate(coding_order(tables.codes)):
            code = int(tables.codes[k])
            if code == ABSENT:
                target.put_maps(k, np.zeros(one, np.float32))
                continue
            index = code_indices(decoder, statistics_for(code, shared), bands, (channels, height, width), None)
            planes = empty_planes(one, device)
            dequantise_map(planes, 0, index, step_of(code), biases, device)
            scale_k = np.ldexp(np.float32(1.0), tables.exponents[k : k + 1])
            target.put_maps(k, inverse_transform(planes, one, scale_k, tables.levels, device))
            target.room.tell(done + 1, n_coeff)
        decoder.finish()
        target.finish()


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


def _exponents(coeffs_khwc: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return e of each map with ``2**e <= max|map| < 2**(e+1)``, within what float32 can scale by and back."""
    largest = np.maximum(coeffs_khwc.max(axis=(1, 2, 3)), -coeffs_khwc.min(axis=(1, 2, 3)))
    return np.clip(np.frexp(largest)[1] - 1, -126, 126).astype(np.int32)
