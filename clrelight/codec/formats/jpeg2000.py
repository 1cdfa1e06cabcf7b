"""Codec `jpeg2000`: every coefficient map as a 16-bit JPEG 2000 plane, through OpenJPEG (ISO/IEC 15444-1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body, BodyWriter
from clrelight.codec.formats import codestream
from clrelight.codec.minimum_size import check_padding, least_bytes, pad_body, rated_bytes
from clrelight.codec.registry import PartsCodec, register
from clrelight.codec.streams import Source, Target
from clrelight.codec.workspace import Shape
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

CODE_MAX = 65535
TOLERANCE = 0.01
FLOAT32_MAX = float(np.finfo(np.float32).max)
_LEAST_STEP = np.finfo(np.float32).smallest_subnormal
_VANISHING = 3.0 * float(_LEAST_STEP)
"""OpenJPEG is off by some two codes, which are no finer than the least float."""


@register
@dataclass(frozen=True)
class Jpeg2000(PartsCodec):
    """Scale each map (coefficient and channel) to 16 bits and code it with the irreversible 9/7 wavelet.

    Every map gets the same share of the bytes; what one leaves over goes to the next. The body lies at or within 1%
    below the rate, unless all maps are coded to OpenJPEG's finest quantiser, or the body is below some 2 kB. A map
    whose share buys nothing, as one that is constant, is stored as its mean alone. Needs Pillow.

    Body: little-endian tables over the maps m = k channel + c: value of code 0 (float32), step (float32, 0 for a
    constant), bytes of the stream (uint32); the quantiser steps that all streams share (payload of a QCD marker
    segment, missing where all are constant); the packets of each stream, without the markers around them, which
    follow from the shape; zeros up to one byte for each 1024 coefficients.

    Attributes
    ----------
    rate : float
        Bits per coefficient, tables included.
    """

    id: ClassVar[str] = "jpeg2000"
    summary: ClassVar[str] = "JPEG 2000 through OpenJPEG, 16-bit planes at a given rate"

    rate: float = 4.0

    def __post_init__(self) -> None:
        number = isinstance(self.rate, int | float) and not isinstance(self.rate, bool)
        if not number or not 0.0 < self.rate < math.inf:
            raise InputError(f"codec jpeg2000: rate must be a positive number of bits, got {self.rate!r}")

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """Write tables and streams; InputError if the rate is below the tables', all would be 0, or no Pillow."""
        k, h, w, c = source.shape
        size = math.prod(source.shape)
        if h * w > codestream.MAX_PIXELS:
            raise InputError(f"codec jpeg2000: a map has at most {codestream.MAX_PIXELS} pixels, got {h} x {w}")
        codestream.require_pillow()
        tables, available, least = _tables(source.shape), rated_bytes(self.rate, size), self.least_bytes(source.shape)
        if available < least:
            raise InputError(
                f"codec jpeg2000: the tables alone take {math.ceil(8e4 * least / size) / 1e4:g} bits per coefficient "
                f"({least} bytes), got {self.rate:.4g} ({available} bytes)"
            )
        low_m, high_m = np.empty((2, k * c), np.float32)
        for part in source.map_parts():
            coeffs_khwc = source.maps(part.start, part.stop)
            maps = slice(part.start * c, part.stop * c)
            low_m[maps] = coeffs_khwc.min(axis=(1, 2)).reshape(-1)
            high_m[maps] = coeffs_khwc.max(axis=(1, 2)).reshape(-1)
        width_m = high_m.astype(np.float64) - low_m
        step_m = (width_m / CODE_MAX).astype(np.float32)
        # Subnormal steps round by much, or to 0: rather a wider interval than a clipped one.
        step_m[step_m.astype(np.float64) * CODE_MAX < width_m * (1 - 2.0**-20)] += _LEAST_STEP
        largest = max(-float(low_m.min()), float(high_m.max()))
        steps, streams = _encode_maps(source, low_m, step_m, available - tables)
        for m, stream in enumerate(streams):
            if not stream and step_m[m] > 0:
                low_m[m], step_m[m] = _plane(source, m).mean(dtype=np.float64), 0.0
        if 0.0 < largest <= _VANISHING and not _keeps_any(low_m, steps, streams, (h, w)):
            raise InputError(
                f"codec jpeg2000: the largest coefficient is {largest:g}, and of codes that fine all would be 0: give "
                "the stack a peak near its brightest sample"
            )
        sizes_m = np.array([len(stream) for stream in streams], np.uint32)
        coded = low_m.tobytes() + step_m.tobytes() + sizes_m.tobytes() + steps + b"".join(streams)
        body.write_all(pad_body(coded, size))
        return {}

    @classmethod
    def least_bytes(cls, shape: Shape) -> int:
        """See `Codec`."""
        return max(_tables(shape), least_bytes(math.prod(shape)))

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """Put the coefficients; PayloadError where tables or streams do not make sense."""
        body, shape = body[:], target.shape
        k, h, w, c = shape
        n_map = k * c
        if len(body) < max(12 * n_map, least_bytes(math.prod(shape))) or h * w > codestream.MAX_PIXELS:
            raise PayloadError(f"codec jpeg2000: {len(body)} bytes cannot hold a map of shape {shape}")
        with np.errstate(invalid="ignore"):
            low_m, step_m = np.frombuffer(body, np.float32, 2 * n_map).reshape(2, n_map).astype(np.float64)
        sizes_m = np.frombuffer(body, np.uint32, n_map, 8 * n_map).astype(np.int64)
        # The last code may pass the largest float by the rounding of the step.
        if not ((np.abs(low_m) <= FLOAT32_MAX) & (step_m >= 0) & (low_m + CODE_MAX * step_m <= 2 * FLOAT32_MAX)).all():
            raise PayloadError("codec jpeg2000: a least value or a step is not finite, or a step is negative")
        if ((sizes_m > 0) != (step_m > 0)).any():
            raise PayloadError("codec jpeg2000: a map with a step has no stream, or one without a step has one")
        streams_at = 12 * n_map + (codestream.steps_size(h, w) if sizes_m.any() else 0)
        end = streams_at + int(sizes_m.sum())
        check_padding(cls.id, body, end, math.prod(shape))
        codestream.require_pillow()
        steps = body[12 * n_map : streams_at]
        ends_m = streams_at + np.cumsum(sizes_m)
        for m in range(n_map):
            if m % c == 0:
                map_hwc = np.empty((h, w, c), np.float32)
            plane_hw = np.zeros((h, w), np.float64)
            if sizes_m[m]:
                packets = body[ends_m[m] - sizes_m[m] : ends_m[m]]
                plane_hw += codestream.decode_plane(steps, packets, h, w)
            plane_hw = np.minimum(low_m[m] + step_m[m] * plane_hw, FLOAT32_MAX)
            map_hwc[:, :, m % c] = plane_hw
            if m % c == c - 1:
                target.put_maps(m // c, map_hwc[None])
                target.workspace.tell(m // c + 1, k)
        target.finish()


def _tables(shape: Shape) -> int:
    k, h, w, c = shape
    return 12 * k * c + codestream.steps_size(h, w)


def _plane(source: Source, m: int) -> NDArray[np.float32]:
    """Return one channel of one map, C-contiguous."""
    k, channel = divmod(m, source.shape[3])
    return np.ascontiguousarray(source.maps(k, k + 1)[0, :, :, channel])


def _keeps_any(low_m: NDArray[np.float32], steps: bytes, streams: list[bytes], size: tuple[int, int]) -> bool:
    """Return whether something else than 0 comes back of maps whose step is the least float."""
    for low, stream in zip(low_m, streams, strict=True):
        codes_hw = codestream.decode_plane(steps, stream, *size).astype(np.int64) if stream else np.zeros(1, np.int64)
        if (codes_hw + round(float(low) / float(_LEAST_STEP))).any():
            return True
    return False


def _encode_maps(
    source: Source, low_m: NDArray[np.float32], step_m: NDArray[np.float32], budget: int
) -> tuple[bytes, list[bytes]]:
    """Return the shared quantiser steps and a stream for each map, empty where constant or not affordable."""
    streams = [b""] * len(step_m)
    changing = [int(m) for m in np.flatnonzero(step_m > 0)]
    shared = b""

    def improve(m: int, target: int) -> int:
        nonlocal shared
        codes_hw = (_plane(source, m) - low_m[m].astype(np.float64)) / step_m[m].astype(np.float64)
        codes_hw = np.clip(np.rint(codes_hw), 0, CODE_MAX).astype(np.uint16)
        shared, packets = codestream.encode_plane(codes_hw, target)
        streams[m] = packets if len(packets) > len(streams[m]) else streams[m]
        return len(streams[m])

    left = budget
    for done, m in enumerate(changing):
        left -= improve(m, left // (len(changing) - done))
        source.workspace.tell(done + 1, len(changing))
    # What is left over after the last map goes to whoever can use it, the largest stream first.
    for m in sorted(changing, key=lambda m: -len(streams[m])):
        if left <= TOLERANCE * budget:
            break
        before = len(streams[m])
        left -= improve(m, before + left) - before
    return (shared if any(streams) else b""), streams
