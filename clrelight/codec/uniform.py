"""Codec `uniform`: fixed-length codes of one uniform quantiser per map (Lam, Leung and Wong, III-B-3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import uniform_search as search
from clrelight.codec.noise import Noise, sample_columns, second_moments
from clrelight.codec.registry import Codec, register
from clrelight.codec.slabs import slabs
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

MAX_BITS = 16
FLOAT32_MAX = float(np.finfo(np.float32).max)


@register
@dataclass(frozen=True)
class Uniform(Codec):
    """Quantise each coefficient's map to ``2**bits`` evenly spaced levels.

    First level and step are chosen per map by the squared error measured at that number of levels, so outliers may
    be clipped; never worse than levels from the least to the greatest value. A constant map decodes exactly.

    Body: one byte `bits`; n_coeff first levels and n_coeff steps, little-endian float32; then the codes in khwc
    order, `bits` bits each, lowest bit first, filled up to a whole byte once at the end.
    ``info["entropy_bits"]`` is what an ideal entropy coder would need instead, in bits per coefficient: the
    zero-order entropy of each map's codes and the table of levels and steps (an estimate, without model tables).

    Attributes
    ----------
    bits : int
        1 to 16.
    """

    id: ClassVar[str] = "uniform"
    summary: ClassVar[str] = "fixed-length codes, levels per map by measured distortion"

    bits: int = 8

    def __post_init__(self) -> None:
        if isinstance(self.bits, bool) or not isinstance(self.bits, int) or not 1 <= self.bits <= MAX_BITS:
            raise InputError(f"codec uniform: bits must be an integer from 1 to {MAX_BITS}, got {self.bits!r}")

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """Return bits, table and codes, and the estimate ``entropy_bits``."""
        coeffs_kp = coeffs_khwc.reshape(coeffs_khwc.shape[0], -1)
        quantiser = search.choose_quantiser(coeffs_kp, self.bits, device)
        codes_kp = _map_values(
            "quantise_uniform_kp", np.empty(coeffs_kp.shape, np.uint16), coeffs_kp, quantiser, self.bits, device
        )
        table = quantiser.low_k.tobytes() + quantiser.step_k.tobytes()
        info = {"entropy_bits": _entropy_bits(codes_kp) + 8.0 * len(table) / coeffs_kp.size}
        return bytes([self.bits]) + table + _pack(codes_kp.reshape(-1), self.bits, device).tobytes(), info

    def predict_noise(self, coeffs_khwc: NDArray[np.float32], device: Device) -> Noise:
        """See `Codec`; the levels are the ones that will be used, the noise is that of a sample of the columns.

        Inside the interval that is about a twelfth of the squared step; what is clipped adds its excess.
        """
        quantiser = search.choose_quantiser(coeffs_khwc.reshape(len(coeffs_khwc), -1), self.bits, device)
        sample_kp = sample_columns(coeffs_khwc).reshape(len(coeffs_khwc), -1).astype(np.float64)
        low_k, step_k = (values.astype(np.float64)[:, None] for values in (quantiser.low_k, quantiser.step_k))
        codes_kp = np.rint((sample_kp - low_k) / np.where(step_k > 0.0, step_k, 1.0))
        levels_kp = low_k + np.clip(codes_kp, 0, 2**self.bits - 1) * step_k
        return Noise.of_coefficients(second_moments(levels_kp - sample_kp))

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """Return the coefficients; PayloadError on a wrong length, bit count, level or step."""
        n_coeff, bits = shape[0], body[0] if body else 0
        if not 1 <= bits <= MAX_BITS:
            raise PayloadError(f"codec uniform: the body must start with a bit count from 1 to {MAX_BITS}")
        expected = 1 + 8 * n_coeff + -(-math.prod(shape) * bits // 8)
        if len(body) != expected:
            raise PayloadError(f"codec uniform: {bits} bits and shape {shape} take {expected} bytes, got {len(body)}")
        low_k, step_k = np.frombuffer(body[1 : 1 + 8 * n_coeff], np.float32).reshape(2, n_coeff)
        with np.errstate(invalid="ignore"):
            last_k = low_k.astype(np.float64) + step_k.astype(np.float64) * (2**bits - 1)
        # The last level may pass the largest float by rounding, or by half a step where 0 was made a level.
        if not ((np.abs(low_k) <= FLOAT32_MAX) & (step_k >= 0) & (last_k <= 2 * FLOAT32_MAX)).all():
            raise PayloadError("codec uniform: a first level or a step is not finite, or a step is negative")
        reach_k = np.maximum(np.abs(low_k).astype(np.float64), np.abs(last_k))
        quantiser = search.Quantiser.of(low_k, step_k, reach_k)
        codes_p = _unpack(np.frombuffer(body[1 + 8 * n_coeff :], np.uint8), math.prod(shape), bits, device)
        coeffs_kp = np.empty((n_coeff, math.prod(shape[1:])), np.float32)
        _map_values("dequantise_uniform_kp", coeffs_kp, codes_p.reshape(coeffs_kp.shape), quantiser, bits, device)
        return coeffs_kp.reshape(shape)


def _map_values(
    kernel: str, out_kp: NDArray, values_kp: NDArray, quantiser: search.Quantiser, bits: int, device: Device
) -> NDArray:
    """Fill and return `out_kp` with codes from coefficients, or the other way."""
    scale_k = quantiser.scale_k if kernel.startswith("quantise") else quantiser.unscale_k
    for maps in slabs(len(values_kp), 4 * values_kp.shape[1]):
        out = device.empty(out_kp[maps].shape, out_kp.dtype, out_kp[maps])
        arrays = [device.upload(a[maps]) for a in (values_kp, quantiser.scaled_low_k, quantiser.scaled_step_k, scale_k)]
        search.launch(device, kernel, bits, values_kp.shape[1], len(values_kp[maps]), out, *arrays, values_kp.shape[1])
        fetched = device.download(out)
        if not device.shares_memory:
            out_kp[maps] = fetched
    return out_kp


def _pack(codes_p: NDArray[np.uint16], bits: int, device: Device) -> NDArray[np.uint8]:
    packed_b = np.empty(-(-codes_p.size * bits // 8), np.uint8)
    for eights in slabs(-(-codes_p.size // 8), 16):
        codes = codes_p[8 * eights.start : 8 * eights.stop]
        target = packed_b[bits * eights.start : bits * eights.stop]
        out = device.empty(target.shape, np.uint8, target)
        source = device.upload(codes)
        search.launch(device, "pack_uniform_b", bits, codes.size, 1, out, source, target.size, codes.size)
        fetched = device.download(out)
        if not device.shares_memory:
            target[:] = fetched
    return packed_b


def _unpack(packed_b: NDArray[np.uint8], count: int, bits: int, device: Device) -> NDArray[np.uint16]:
    codes_p = np.empty(count, np.uint16)
    for eights in slabs(-(-count // 8), 16):
        target = codes_p[8 * eights.start : 8 * eights.stop]
        packed = packed_b[bits * eights.start : bits * eights.stop]
        out = device.empty(target.shape, np.uint16, target)
        source = device.upload(packed)
        search.launch(device, "unpack_uniform_p", bits, target.size, 1, out, source, packed.size, target.size)
        fetched = device.download(out)
        if not device.shares_memory:
            target[:] = fetched
    return codes_p


def _entropy_bits(codes_kp: NDArray[np.uint16]) -> float:
    """Return the mean over maps of the zero-order entropy of the codes, in bits."""
    total = 0.0
    for codes in codes_kp:
        share = np.bincount(codes) / codes.size
        share = share[share > 0]
        total -= float(share @ np.log2(share))
    return total / len(codes_kp) + 0.0  # no -0.0
