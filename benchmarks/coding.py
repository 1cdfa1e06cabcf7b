"""Stages of the codecs: the whole of `encode` and `decode`, checks and bytes included, and the half kernel alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.workload import Workload
from clrelight.codec import codec_class, codec_ids, decode, encode
from clrelight.codec.formats.half import STRETCH, launch_conversion
from clrelight.codec.registry import Codec
from clrelight.codec.transforms.lifting import forward_transform, inverse_transform, transform_planes
from clrelight.speed.stage import Stage

HALF_GOAL = 5.0
S3TC_GOAL = 0.4
TRANSFORM_GOAL = 0.4

TRANSFORM_LEVELS = 3

KLT_RATE = 0.1
KLT_ENCODE_GOAL, KLT_DECODE_GOAL = 1 / 10, 1 / 3
"""Speed beside JPEG 2000 at the same rate."""

_OPTIONS: dict[str, dict[str, object]] = {"uniform": {"bits": 8}, "wavelet": {"rate": 4.0}}
"""What codecs are asked for; the others get their defaults."""
_IMAGE_RMS = "image rms after decoding / peak"
_COPY = "NumPy copy of the coefficients"


def codec_stages(work: Workload) -> Iterator[Stage]:
    """Yield encoding and decoding of the CLS fit by each codec that is registered."""
    coeffs_khwc = np.ascontiguousarray(work.fitted.coeffs_khwc)
    yield _half_kernel(work, coeffs_khwc)
    yield _transform(work, coeffs_khwc)
    for codec_id in codec_ids():
        if codec_id == "klt":
            yield from _klt_beside_jpeg2000(work, coeffs_khwc, KLT_RATE)
        else:
            yield from _codec(work, coeffs_khwc, codec_id, _OPTIONS.get(codec_id, {}))


def _codec(
    work: Workload, coeffs_khwc: NDArray[np.float32], codec_id: str, config: dict[str, object]
) -> Iterator[Stage]:
    device = work.device
    codec: Codec = codec_class(codec_id).from_config(config)
    encoded = encode(coeffs_khwc, codec, device)
    copy_khwc, halves = np.empty_like(coeffs_khwc), coeffs_khwc.astype(np.float16)
    is_half = codec_id == "half"

    def errors() -> tuple[float, float | None]:
        loss = _image_rms(work, coeffs_khwc, decode(encoded, device))
        return loss, _image_rms(work, coeffs_khwc, halves) if is_half else None

    name = " ".join([codec_id, *(f"{key} {value}" for key, value in config.items())])
    yield Stage(
        f"encode {name}",
        "NumPy astype(float16)" if is_half else _COPY,
        lambda: encode(coeffs_khwc, codec, device),
        (lambda: coeffs_khwc.astype(np.float16)) if is_half else (lambda: np.copyto(copy_khwc, coeffs_khwc)),
        errors,
        _IMAGE_RMS,
        goal=S3TC_GOAL if codec_id == "s3tc" else None,
    )
    yield Stage(
        f"decode {name}",
        "NumPy astype(float32)" if is_half else f"{_COPY}, into new memory",
        lambda: decode(encoded, device),
        (lambda: halves.astype(np.float32)) if is_half else coeffs_khwc.copy,
        errors,
        _IMAGE_RMS,
    )


def _klt_beside_jpeg2000(work: Workload, coeffs_khwc: NDArray[np.float32], rate: float) -> Iterator[Stage]:
    """Yield encoding and decoding at one rate by both; of tiny pictures JPEG 2000 gets what pays for its tables."""
    device = work.device
    least = 8.0 * 12 * coeffs_khwc.shape[0] * coeffs_khwc.shape[3] / coeffs_khwc.size
    klt, peer = (
        codec_class(codec_id).from_config({"rate": asked})
        for codec_id, asked in (("klt", rate), ("jpeg2000", max(rate, 4 * least)))
    )
    encoded, peer_encoded = encode(coeffs_khwc, klt, device), encode(coeffs_khwc, peer, device)

    def errors() -> tuple[float, float]:
        ours, theirs = (_image_rms(work, coeffs_khwc, decode(each, device)) for each in (encoded, peer_encoded))
        return ours, theirs

    beside = f"JPEG 2000 at {peer.to_config()['rate']:g} bit"
    yield Stage(
        f"encode klt at {rate:g} bit",
        beside,
        lambda: encode(coeffs_khwc, klt, device),
        lambda: encode(coeffs_khwc, peer, device),
        errors,
        _IMAGE_RMS,
        goal=KLT_ENCODE_GOAL,
    )
    yield Stage(
        f"decode klt at {rate:g} bit",
        beside,
        lambda: decode(encoded, device),
        lambda: decode(peer_encoded, device),
        errors,
        _IMAGE_RMS,
        goal=KLT_DECODE_GOAL,
    )


def _transform(work: Workload, coeffs_khwc: NDArray[np.float32]) -> Stage:
    device, width = work.device, coeffs_khwc.shape[2]
    ones_k = np.ones(len(coeffs_khwc), np.float32)
    planes = forward_transform(coeffs_khwc, ones_k, 0, device)  # planes, not transformed yet
    copy_khwc = np.empty_like(coeffs_khwc)

    def there_and_back() -> None:
        transform_planes("analyse", planes, width, TRANSFORM_LEVELS, device)
        transform_planes("synthesise", planes, width, TRANSFORM_LEVELS, device)

    def copy_twice() -> None:
        np.copyto(copy_khwc, coeffs_khwc)
        np.copyto(copy_khwc, coeffs_khwc)

    def errors() -> tuple[float, None]:
        forward = forward_transform(coeffs_khwc, ones_k, TRANSFORM_LEVELS, device)
        back_khwc = inverse_transform(forward, coeffs_khwc.shape, ones_k, TRANSFORM_LEVELS, device)
        return float(np.abs(back_khwc - coeffs_khwc).max() / np.abs(coeffs_khwc).max()), None

    return Stage(
        f"9/7 transform of {TRANSFORM_LEVELS} levels and back, in place",
        "two NumPy copies of the coefficients",
        there_and_back,
        copy_twice,
        errors,
        "largest error / largest value",
        goal=TRANSFORM_GOAL,
    )


def _half_kernel(work: Workload, coeffs_khwc: NDArray[np.float32]) -> Stage:
    device = work.device
    coeffs_p = device.upload(coeffs_khwc.reshape(-1))
    halves_p, refused_j = (
        device.empty((coeffs_khwc.size,), np.float16),
        device.empty((-(-coeffs_khwc.size // STRETCH),), np.uint8),
    )
    peer_halves = np.empty(coeffs_khwc.shape, np.float16)

    return Stage(
        "encode half, kernel alone",
        "NumPy astype(float16) into ready memory",
        lambda: launch_conversion(device, "encode_half_p", halves_p, refused_j, coeffs_p, clamp=False),
        lambda: np.copyto(peer_halves, coeffs_khwc, casting="same_kind"),
        lambda: (
            _image_rms(work, coeffs_khwc, device.download(halves_p).reshape(coeffs_khwc.shape)),
            _image_rms(work, coeffs_khwc, peer_halves),
        ),
        _IMAGE_RMS,
        goal=HALF_GOAL,
    )


def _image_rms(work: Workload, coeffs_khwc: NDArray[np.float32], decoded_khwc: NDArray) -> float:
    before_ks, after_ks = (
        maps.reshape(len(maps), -1)[:, work.checked_s].astype(np.float64) for maps in (coeffs_khwc, decoded_khwc)
    )
    return float(np.sqrt(np.mean(work.image_error(after_ks, before_ks) ** 2)))
