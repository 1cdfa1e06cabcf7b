"""Codec `half`: IEEE 754 binary16, 16 bits per coefficient (noise-resistant-fitting, section III-B-1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body, BodyWriter, columns_of
from clrelight.codec.rate.noise import Noise, sample_columns
from clrelight.codec.registry import PartsCodec, register
from clrelight.codec.slabs import slabs
from clrelight.codec.streams import Source, Target
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError
from clrelight.opencl.arguments import DeviceArray

LARGEST = 65504.0
"""Largest binary16."""

OVERFLOW = 65520.0
"""Least magnitude that rounds to infinity: halfway between the largest binary16, 65504, and 2**16."""
STRETCH = 1024
"""Values that a work-item of a CPU, or a group of a GPU's, converts."""
_GROUP = 128
_VANISHING = 2.0**-25
"""Largest magnitude that rounds to 0."""


@register
@dataclass(frozen=True)
class Half(PartsCodec):
    """Round every coefficient to the nearest binary16, ties to even. Body: little-endian halves in khwc order.

    Attributes
    ----------
    clamp : bool
        Store ±65504 for what binary16 cannot hold, and count it as ``info["clamped"]``, instead of refusing it.
    """

    id: ClassVar[str] = "half"
    summary: ClassVar[str] = "IEEE 754 binary16, 16 bits per coefficient"

    clamp: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.clamp, bool):
            raise InputError(f"codec half: clamp must be true or false, got {self.clamp!r}")

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """Write the halves; InputError names the first coefficient of a part that overflows, unless clamping.

        A map of which nothing would be left is refused too.
        """
        _, height, width, channel = source.shape
        body.reserve(2 * math.prod(source.shape))
        clamped, largest = 0, 0.0
        with source.rows() as parts:
            for first, coeffs_khwc in parts:
                largest = largest_at_first(coeffs_khwc, largest)
                halves_kp = np.empty((len(coeffs_khwc), coeffs_khwc[0].size), np.float16)
                values_p = coeffs_khwc.reshape(-1)
                if convert("encode_half_p", halves_kp.reshape(-1), values_p, source.device, clamp=self.clamp):
                    clamped += count_overflows(coeffs_khwc, first, "binary16", clamp=self.clamp)
                body.write_columns(2 * height * width * channel, 2 * first * width * channel, halves_kp)
        check_not_vanishing(largest)
        return {"clamped": float(clamped)}

    def predict_noise(self, source: Source) -> Noise:
        """Return the paper's relative noise: errors even over the spacing of halves at each coefficient, independent.

        From a sample of the columns.
        """
        sample_khwc = sample_columns(source)
        return Noise.of_coefficients(np.diag(rounding_variance(sample_khwc).mean(axis=(1, 2, 3))))

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """Put the coefficients, exactly what was stored; PayloadError on a wrong length, infinity or NaN."""
        n_coeff, _, width, channel = target.shape
        expected = 2 * math.prod(target.shape)
        if len(body) != expected:
            raise PayloadError(f"codec half: shape {target.shape} takes {expected} bytes, the body has {len(body)}")
        for rows in target.row_parts():
            ends = (2 * row * width * channel for row in (rows.start, rows.stop))
            halves_p = columns_of(body, n_coeff, *ends).reshape(-1).view(np.float16)
            coeffs_khwc = np.empty((n_coeff, rows.stop - rows.start, width, channel), np.float32)
            if convert("decode_half_p", coeffs_khwc.reshape(-1), halves_p, device, clamp=False):
                raise PayloadError("codec half: the body holds an infinity or a NaN")
            target.put_rows(rows.start, coeffs_khwc)
        target.finish()


def rounding_variance(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the expected squared error of each value as a half, from nothing but its binade, float64.

    A twelfth of the squared spacing: 2**-10 of the binade's lower end, and 2**-24 below 2**-14. What rounds to 0 loses
    its square, what is clamped that of its excess.
    """
    magnitude = np.abs(values.astype(np.float64))
    spacing = np.ldexp(1.0, np.maximum(np.frexp(magnitude)[1] - 11, -24))
    variance = np.where(magnitude < 2.0**-25, magnitude, spacing / np.sqrt(12.0)) ** 2
    return np.where(magnitude >= OVERFLOW, (magnitude - LARGEST) ** 2, variance)


def largest_at_first(coeffs_khwc: NDArray[np.float32], known: float) -> float:
    """Return the largest magnitude, or the first found, or known, that is enough for `check_not_vanishing`."""
    coeffs_p = coeffs_khwc.reshape(-1)
    for slab in slabs(coeffs_p.size, 1 << 10):  # small ones: nearly always the first ends the search
        if known > _VANISHING:
            break
        known = max(known, float(np.abs(coeffs_p[slab]).max()))
    return known


def count_overflows(
    coeffs_khwc: NDArray[np.float32], first_row: int, holder: str, *, clamp: bool, otherwise: str = "clamp"
) -> int:
    """Return how many coefficients binary16 cannot hold; InputError names the first of them, unless clamping.

    It says that `holder` cannot hold it, and what could be done otherwise.
    """
    large = np.abs(coeffs_khwc) >= OVERFLOW
    if large.any() and not clamp:
        k, row, column, channel = (int(i) for i in np.unravel_index(int(large.argmax()), large.shape))
        raise InputError(
            f"coefficient (k, row, column, channel) = {(k, first_row + row, column, channel)} is "
            f"{coeffs_khwc[k, row, column, channel]:g}, which {holder} cannot hold (|x| must be below {OVERFLOW:g}); "
            f"fit with a constrained method, or {otherwise}"
        )
    return int(np.count_nonzero(large))


def check_not_vanishing(largest: float) -> None:
    """Raise InputError where every coefficient rounds to 0 as binary16, though not all are 0."""
    if 0.0 < largest <= _VANISHING:
        raise InputError(
            f"the largest coefficient is {largest:g}, and as binary16 all would be 0: give the stack a peak near its "
            "brightest sample"
        )


def convert(kernel: str, out_p: NDArray, values_p: NDArray, device: Device, *, clamp: bool) -> bool:
    """Fill `out_p` from `values_p` with a kernel; return whether it refused a value."""
    refused = False
    for slab in slabs(values_p.size, 4):
        values, out = values_p[slab], out_p[slab]
        refused_j = device.empty((-(-values.size // STRETCH),), np.uint8)
        result = device.empty(out.shape, out.dtype, out)
        source = device.upload(values)
        launch_conversion(device, kernel, result, refused_j, source, clamp=clamp)
        device.fetch(result, out)
        refused |= bool(device.download(refused_j).any())
    return refused


def launch_conversion(
    device: Device, kernel: str, out_p: DeviceArray, refused_j: DeviceArray, values_p: DeviceArray, *, clamp: bool
) -> None:
    """Queue ``encode_half_p`` or ``decode_half_p``; `refused_j` has one entry for each `STRETCH` values."""
    (stretches,) = refused_j.shape
    if device.style == "gpu":
        group, defines = _GROUP, {"STRETCH": STRETCH, "GROUP": _GROUP}
    else:
        group, defines = 1, {"VECTORS": STRETCH // 8}
    device.launch(
        "codec/half.cl",
        kernel,
        (stretches * group,),
        out_p,
        refused_j,
        values_p,
        values_p.shape[0],
        defines={**defines, "CLAMP": int(clamp)},
        local_size=(group,),
    )
