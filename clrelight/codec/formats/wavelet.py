"""The wavelet codec: CDF 9/7, a uniform quantiser and units of rANS, at a rate asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from clrelight.codec.bodies import Body, BodyWriter
from clrelight.codec.damage import Damage
from clrelight.codec.entropy.units import MARGIN, PRECINCT
from clrelight.codec.formats.wavelet_encode import Encoder
from clrelight.codec.formats.wavelet_few import MOST_BYTES, decode_few, encode_few, is_few
from clrelight.codec.formats.wavelet_few import least_bytes as least_few
from clrelight.codec.formats.wavelet_old import decode_maps
from clrelight.codec.formats.wavelet_units import LEAST_STREAM, is_in_units, parse_body, table_bytes
from clrelight.codec.formats.wavelet_view import WaveletView
from clrelight.codec.minimum_size import drop_padding, minimum_bytes, minimum_overhead, pad_to_minimum, rated_bytes
from clrelight.codec.rate.noise import Noise
from clrelight.codec.registry import PartsCodec, register
from clrelight.codec.streams import Source, Target
from clrelight.codec.workspace import Shape
from clrelight.device import Device
from clrelight.errors import InputError

ALLOCATIONS = ("map", "global")


@register
@dataclass(frozen=True)
class Wavelet(PartsCodec):
    """Principal axes of each map's channels, CDF 9/7 subbands, one quantiser step per map, units of rANS.

    Attributes
    ----------
    rate : float
        Bits per coefficient asked for; what is made lies within 1% below, side tables included.
    allocation : str
        ``"map"``: every map gets the same rate (noise-resistant-fitting, section III-B). Maps that cannot use theirs
        even at float32's own precision hand the rest equally to the others. ``"global"``: one step for all maps.

    Notes
    -----
    The 1% holds from about 1 kB of body up; below that whole bytes and words of streams are coarser. Where all maps are
    coded to full precision (step 2**-20 of the largest magnitude or finer) the size stays below the rate. Side tables
    too large for the rate are an InputError.

    Indices are chosen by what they cost, as in `klt`; units hold some maps each, so that regions are decoded alone.
    Up to half a kilobyte each number may be written alone instead, where that leaves less error: tables and the
    states of streams take tens of bytes.
    """

    id: ClassVar[str] = "wavelet"
    summary: ClassVar[str] = "9/7 wavelet, uniform quantiser and units of rANS at a given rate of every map"

    rate: float = 4.0
    allocation: str = "map"

    def __post_init__(self) -> None:
        if not (isinstance(self.rate, int | float) and 0.0 < self.rate < float("inf")):
            raise InputError(f"the wavelet rate must be a positive number of bits per coefficient, got {self.rate!r}")
        if self.allocation not in ALLOCATIONS:
            raise InputError(f"the wavelet allocation must be one of {', '.join(ALLOCATIONS)}, got {self.allocation!r}")

    def bytes_to_encode(self, shape: Shape) -> int:
        """See `Codec`."""
        return _tile_bytes(shape)

    @classmethod
    def bytes_to_decode(cls, body: Body, shape: Shape) -> int:
        """See `Codec`."""
        return _tile_bytes(shape)

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """See `Codec`."""
        few = self._encode_few(source)
        try:
            content = self._encoder(source).encode()
        except InputError:
            if few is None:
                raise
            content = few
        if few is not None and self._loss(few, source) < self._loss(content, source):
            content = few
        body.write_all(pad_to_minimum(content, source.shape, self._bound(source.shape)))
        return {}

    def _bound(self, shape: Shape) -> int:
        """Return the bytes asked for."""
        return rated_bytes(self.rate, math.prod(shape))

    def _encode_few(self, source: Source) -> bytes | None:
        """Return the body that holds each number alone, where so few are asked for that it may be better."""
        budget = self._bound(source.shape)
        return encode_few(source.whole(), budget, self.allocation == "map") if budget <= MOST_BYTES else None

    def _loss(self, body: bytes, source: Source) -> float:
        """Return squared errors of a body; those of every map as parts of its largest number, if maps are alike."""
        exact_khwc = source.whole().astype(np.float64)
        errors_kp = (self.decode_body(body, source.shape, source.device) - exact_khwc).reshape(len(exact_khwc), -1)
        if self.allocation == "map":
            largest_k = np.abs(exact_khwc).reshape(len(exact_khwc), -1).max(axis=1, keepdims=True)
            errors_kp = errors_kp / np.where(largest_k > 0, largest_k, 1.0)
        return float((errors_kp**2).sum())

    def predict_noise(self, source: Source) -> Noise:
        """See `Codec`; what is lost of a sample at the steps that trials find."""
        n_coeff = source.shape[0]
        try:
            errors_mcp, present_m = self._encoder(source).expect()
        except InputError:
            if (few := self._encode_few(source)) is None:
                raise
            errors_mcp = decode_few(few, source.shape).astype(np.float64) - source.whole()
            present_m = np.arange(n_coeff)
        moments_kk = np.zeros((n_coeff, n_coeff))
        if len(present_m):
            errors_mq = errors_mcp.reshape(len(present_m), -1)
            moments_kk[np.ix_(present_m, present_m)] = errors_mq @ errors_mq.T / errors_mq.shape[1]
        return Noise.of_coefficients(moments_kk)

    def _encoder(self, source: Source) -> Encoder:
        """Return an encoder; InputError where tables alone pass the rate."""
        shape = source.shape
        budget = self._bound(shape) - minimum_overhead(shape)
        tables = table_bytes(shape[0]) + LEAST_STREAM
        if budget < tables:
            least, size = self.least_bytes(shape), math.prod(shape)
            raise InputError(
                f"{self.rate:g} bits per coefficient ({self._bound(shape)} bytes) are too few for maps of {shape}: "
                f"their side tables alone take {math.ceil(8e4 * least / size) / 1e4:g} ({least} bytes)"
            )
        return Encoder(source, budget, self.allocation == "map")

    @classmethod
    def least_bytes(cls, shape: Shape) -> int:
        """See `Codec`."""
        tables = min(table_bytes(shape[0]) + LEAST_STREAM, least_few(shape))
        return max(tables + minimum_overhead(shape), minimum_bytes(shape))

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """See `Codec`."""
        regions = cls.decode_regions(body, target.shape)
        if regions is not None:
            regions.put_rows(target, device)
        elif is_few(body):
            target.put_rows(0, decode_few(drop_padding(body, target.shape)[:], target.shape))
        else:
            decode_maps(drop_padding(body, target.shape)[:], target, device)

    @classmethod
    def decode_view(cls, body: Body, shape: Shape, device: Device) -> WaveletView | None:
        """See `Codec`; None of old bodies."""
        return cls.decode_regions(body, shape)

    @classmethod
    def decode_regions(cls, body: Body, shape: Shape, damage: Damage | None = None) -> WaveletView | None:
        """See `Codec`; None of old bodies."""
        content = drop_padding(body, shape)
        return WaveletView(content, *parse_body(content, shape), shape, damage) if is_in_units(content) else None


def _tile_bytes(shape: Shape) -> int:
    """Return the bytes of the planes of one tile, before and behind the transform."""
    side = PRECINCT + 2 * MARGIN
    return 8 * shape[0] * shape[3] * min(shape[1], side) * min(shape[2], side)
