"""Codec `uniform`: fixed-length codes of one uniform quantiser per map (Lam, Leung and Wong, III-B-3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body, BodyWriter
from clrelight.codec.entropy.bitpack import packed_size
from clrelight.codec.formats import uniform_search as search
from clrelight.codec.rate.noise import Noise, sample_columns, second_moments
from clrelight.codec.registry import PartsCodec, register
from clrelight.codec.slabs import slabs
from clrelight.codec.streams import Source, Target
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

MAX_BITS = 16
FLOAT32_MAX = float(np.finfo(np.float32).max)


@register
@dataclass(frozen=True)
class Uniform(PartsCodec):
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

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """Write bits, table and codes; the estimate is ``entropy_bits``."""
        n_coeff, n_value = source.shape[0], math.prod(source.shape[1:])
        quantiser = self._choose_quantiser(source)
        table = bytes([self.bits]) + quantiser.low_k.tobytes() + quantiser.step_k.tobytes()
        body.reserve(len(table) + packed_size(n_coeff * n_value, self.bits))
        body.write(0, np.frombuffer(table, np.uint8))
        at, entropy, left_p = len(table), 0.0, np.empty(0, np.uint16)
        for part in source.map_parts():
            coeffs_kp = source.maps(part.start, part.stop).reshape(-1, n_value)
            codes_kp = np.empty(coeffs_kp.shape, np.uint16)
            _map_values("quantise_uniform_kp", codes_kp, coeffs_kp, quantiser[part], self.bits, source.device)
            for codes_p in codes_kp:
                entropy += _entropy(codes_p)
            codes_p = np.concatenate([left_p, codes_kp.reshape(-1)]) if left_p.size else codes_kp.reshape(-1)
            # What does not fill whole bytes waits for the next part.
            whole = codes_p.size if part.stop == n_coeff else codes_p.size // 8 * 8
            if whole:
                packed_b = np.empty(packed_size(whole, self.bits), np.uint8)
                _repack("pack_uniform_b", packed_b, codes_p[:whole], self.bits, source.device)
                body.write(at, packed_b)
                at += packed_b.size
            left_p = codes_p[whole:].copy()
            source.workspace.tell(part.stop, n_coeff)
        return {"entropy_bits": entropy / n_coeff + 8.0 * (len(table) - 1) / (n_coeff * n_value)}

    def _choose_quantiser(self, source: Source) -> search.Quantiser:
        def choose() -> search.Quantiser:
            parts = []
            for part in source.map_parts():
                coeffs_kp = source.maps(part.start, part.stop).reshape(part.stop - part.start, -1)
                parts.append(search.choose_quantiser(coeffs_kp, self.bits, source.device))
                source.workspace.tell(part.stop, source.shape[0])
            return search.Quantiser.joined(parts)

        return source.remember(("uniform", self.bits), choose)

    def predict_noise(self, source: Source) -> Noise:
        """See `Codec`; the levels are the ones that will be used, the noise is that of a sample of the columns.

        Inside the interval that is about a twelfth of the squared step; what is clipped adds its excess.
        """
        quantiser = self._choose_quantiser(source)
        sample_kp = sample_columns(source).reshape(source.shape[0], -1).astype(np.float64)
        low_k, step_k = (values.astype(np.float64)[:, None] for values in (quantiser.low_k, quantiser.step_k))
        codes_kp = np.rint((sample_kp - low_k) / np.where(step_k > 0.0, step_k, 1.0))
        levels_kp = low_k + np.clip(codes_kp, 0, 2**self.bits - 1) * step_k
        return Noise.of_coefficients(second_moments(levels_kp - sample_kp))

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """Put the coefficients; PayloadError on a wrong length, bit count, level or step."""
        n_coeff, height, width, channel = target.shape
        bits = body[:1][0] if len(body) else 0
        if not 1 <= bits <= MAX_BITS:
            raise PayloadError(f"codec uniform: the body must start with a bit count from 1 to {MAX_BITS}")
        expected = 1 + 8 * n_coeff + packed_size(math.prod(target.shape), bits)
        if len(body) != expected:
            raise PayloadError(
                f"codec uniform: {bits} bits and shape {target.shape} take {expected} bytes, got {len(body)}"
            )
        low_k, step_k = np.frombuffer(body[1 : 1 + 8 * n_coeff], np.float32).reshape(2, n_coeff)
        with np.errstate(invalid="ignore"):
            last_k = low_k.astype(np.float64) + step_k.astype(np.float64) * (2**bits - 1)
        # The last level may pass the largest float by rounding, or by half a step where 0 was made a level.
        if not ((np.abs(low_k) <= FLOAT32_MAX) & (step_k >= 0) & (last_k <= 2 * FLOAT32_MAX)).all():
            raise PayloadError("codec uniform: a first level or a step is not finite, or a step is negative")
        reach_k = np.maximum(np.abs(low_k).astype(np.float64), np.abs(last_k))
        quantiser = search.Quantiser.of(low_k, step_k, reach_k)
        for rows in target.row_parts():
            codes_kp = np.empty((n_coeff, (rows.stop - rows.start) * width * channel), np.uint16)
            if rows == slice(0, height):
                codes_kp = _read_codes(body, n_coeff, 0, codes_kp.size, bits, device).reshape(codes_kp.shape)
            else:
                for k, codes_p in enumerate(codes_kp):
                    start = (k * height + rows.start) * width * channel
                    codes_p[:] = _read_codes(body, n_coeff, start, start + codes_p.size, bits, device)
            coeffs_kp = np.empty(codes_kp.shape, np.float32)
            _map_values("dequantise_uniform_kp", coeffs_kp, codes_kp, quantiser, bits, device)
            target.put_rows(rows.start, coeffs_kp.reshape(n_coeff, -1, width, channel))
        target.finish()


def _map_values(
    kernel: str, out_kp: NDArray, values_kp: NDArray, quantiser: search.Quantiser, bits: int, device: Device
) -> NDArray:
    """Fill and return `out_kp` with codes from coefficients, or the other way."""
    scale_k = quantiser.scale_k if kernel.startswith("quantise") else quantiser.unscale_k
    for maps in slabs(len(values_kp), 4 * values_kp.shape[1]):
        out = device.empty(out_kp[maps].shape, out_kp.dtype, out_kp[maps])
        arrays = [device.upload(a[maps]) for a in (values_kp, quantiser.scaled_low_k, quantiser.scaled_step_k, scale_k)]
        search.launch(device, kernel, bits, values_kp.shape[1], len(values_kp[maps]), out, *arrays, values_kp.shape[1])
        device.fetch(out, out_kp[maps])
    return out_kp


def _repack(kernel: str, out: NDArray, source: NDArray, bits: int, device: Device) -> NDArray:
    """Fill and return `out` with packed bytes from codes, or the other way."""

    def part(array: NDArray, eights: slice) -> NDArray:
        each = bits if array.dtype == np.uint8 else 8
        return array[each * eights.start : each * eights.stop]

    count = max(out, source, key=lambda array: array.itemsize).size
    for eights in slabs(-(-count // 8), 16):
        arrays = target, held = part(out, eights), part(source, eights)
        n_byte, n_code = (array.size for array in sorted(arrays, key=lambda array: array.itemsize))
        made = device.empty(target.shape, target.dtype, target)
        search.launch(device, kernel, bits, n_code, 1, made, device.upload(held), n_byte, n_code)
        device.fetch(made, target)
    return out


def _read_codes(body: Body, n_coeff: int, first: int, end: int, bits: int, device: Device) -> NDArray[np.uint16]:
    """Return codes `first` to `end` of all that a body holds behind its table."""
    start = first // 8 * 8  # there a byte begins
    table = 1 + 8 * n_coeff
    packed = body[table + start * bits // 8 : table + packed_size(end, bits)]
    codes_p = np.empty(end - start, np.uint16)
    return _repack("unpack_uniform_p", codes_p, np.frombuffer(packed, np.uint8), bits, device)[first - start :]


def _entropy(codes_p: NDArray[np.uint16]) -> float:
    """Return the zero-order entropy of a map's codes, in bits."""
    share = np.bincount(codes_p) / codes_p.size
    share = share[share > 0]
    return 0.0 - float(share @ np.log2(share))  # no -0.0
