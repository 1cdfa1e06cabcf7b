"""Codecs of single planes: JPEG 2000, HTJ2K, JPEG XL and SPERR through imagecodecs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

NAMES = ("JPEG 2000", "HTJ2K", "JPEG XL", "SPERR")
SCALES = 8
"""Bytes of what a plane's codes mean: value of code 0 and step, float32."""
_CODES = 65535
_LENGTH = 4
_EFFORT = 5


@dataclass(frozen=True)
class PlaneCoder:
    """A codec of planes (height, width), float32.

    Attributes
    ----------
    name : str
    encode : callable
        Takes a plane and about the root mean square error that it may have; returns the bytes and what
        `decode` needs beside them, which takes `SCALES` bytes.
    decode : callable
        Takes both and the shape.
    count : callable
        The bytes of a stream that count for each plane.
    shared : callable
        The bytes of a stream that all planes share, and which count once.
    """

    name: str
    encode: Callable[[NDArray[np.float32], float], tuple[bytes, tuple[float, float]]]
    decode: Callable[[bytes, tuple[float, float]], NDArray[np.float32]]
    count: Callable[[bytes], int] = len
    shared: Callable[[bytes], int] = lambda stream: 0


def plane_coders() -> list[PlaneCoder]:
    """Return the codecs; ImportError without imagecodecs."""
    import imagecodecs

    made = (
        (*_jpeg2000(imagecodecs), _after_headers, _headers),
        (*_htj2k(imagecodecs), _after_headers, _headers),
        _jpeg_xl(imagecodecs),
        _sperr(imagecodecs),
    )
    return [PlaneCoder(name, *functions) for name, functions in zip(NAMES, made, strict=True)]


def _headers(stream: bytes) -> int:
    """Return the bytes of main and tile-part headers, which follow from the first plane's, its shape and its step."""
    return stream.index(b"\xff\x93") + 2


def _after_headers(stream: bytes) -> int:
    """Return the bytes of packets, and those of a length, of what follows from it and no marker of the end."""
    return len(stream) - _headers(stream) - 2 + _LENGTH


def _to_codes(plane_hw: NDArray[np.float32], low: float, step: float) -> NDArray[np.uint16]:
    return np.clip(np.rint((plane_hw - np.float32(low)) / np.float32(step)), 0, _CODES).astype(np.uint16)


def _from_codes(codes_hw: NDArray, scales: tuple[float, float]) -> NDArray[np.float32]:
    low, step = scales
    return np.float32(low) + codes_hw.squeeze().astype(np.float32) * np.float32(step)


def _range(plane_hw: NDArray[np.float32]) -> tuple[float, float]:
    low, high = float(plane_hw.min()), float(plane_hw.max())
    return low, max(high - low, 1e-20)


def _jpeg2000(codecs: Any) -> tuple[Callable, Callable]:
    """OpenJPEG, irreversible 9/7, by the PSNR of the plane."""

    def encode(plane_hw: NDArray[np.float32], error: float) -> tuple[bytes, tuple[float, float]]:
        low, span = _range(plane_hw)
        codes_hw = _to_codes(plane_hw, low, span / _CODES)
        resolutions = min(6, int(math.log2(min(plane_hw.shape))))
        level = max(20.0 * math.log10(span / error), 1.0)
        options = {"codecformat": "j2k", "reversible": False, "resolutions": resolutions, "numthreads": 1}
        return codecs.jpeg2k_encode(codes_hw, level=level, **options), (low, span / _CODES)

    return encode, lambda stream, scales: _from_codes(codecs.jpeg2k_decode(stream, numthreads=1), scales)


def _htj2k(codecs: Any) -> tuple[Callable, Callable]:
    """OpenJPH, irreversible 9/7, by the quantiser's step."""

    def encode(plane_hw: NDArray[np.float32], error: float) -> tuple[bytes, tuple[float, float]]:
        low, span = _range(plane_hw)
        codes_hw = _to_codes(plane_hw, low, span / _CODES)
        step = min(max(4.5 * error / span, 2e-5), 0.5)
        return codecs.htj2k_encode(codes_hw, level=step, reversible=False), (low, span / _CODES)

    return encode, lambda stream, scales: _from_codes(codecs.htj2k_decode(stream), scales)


def _jpeg_xl(codecs: Any) -> tuple[Callable, Callable]:
    """The DCT of variable size of libjxl, around a middle grey; all planes near distance 1, which the scale goes with.

    Scaled so, the curve that JPEG XL takes to be an eye's is nearly straight over the plane; at larger distances its
    models of visibility cost mean squared error. Effort 7 gained nothing over 5.
    """

    def encode(plane_hw: NDArray[np.float32], error: float) -> tuple[bytes, tuple[float, float]]:
        low, span = _range(plane_hw)
        step = max(span / (0.9 * _CODES), error / (0.0026 * _CODES))
        first = low + span / 2.0 - step * (_CODES + 1) / 2.0
        distance = min(max((error / (0.0026 * _CODES * step)) ** 1.25, 0.01), 25.0)
        codes_hw = _to_codes(plane_hw, first, step)
        options = {"distance": distance, "effort": _EFFORT, "numthreads": 1, "usecontainer": False}
        return codecs.jpegxl_encode(codes_hw, **options), (first, step)

    return encode, lambda stream, scales: _from_codes(codecs.jpegxl_decode(stream, numthreads=1), scales)


def _sperr(codecs: Any) -> tuple[Callable, Callable]:
    """SPERR's 9/7 wavelet and set partitioning, by the PSNR of the plane; floats, which need no scale."""

    def encode(plane_hw: NDArray[np.float32], error: float) -> tuple[bytes, tuple[float, float]]:
        _, span = _range(plane_hw)
        level = max(20.0 * math.log10(span / (2.0 * error)), 1.0)
        return codecs.sperr_encode(np.ascontiguousarray(plane_hw), level, "psnr", numthreads=1), (0.0, 1.0)

    # Its decoder may read behind a stream's end.
    return encode, lambda stream, scales: codecs.sperr_decode(stream + bytes(64), numthreads=1).squeeze()
