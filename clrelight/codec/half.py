"""Codec `half`: IEEE 754 binary16, 16 bits per coefficient (Lam, Leung and Wong, section III-B-1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.noise import Noise, sample_columns
from clrelight.codec.registry import Codec, register
from clrelight.codec.slabs import slabs
from clrelight.device import Device, DeviceArray
from clrelight.errors import InputError, PayloadError

LARGEST = 65504.0
"""Largest binary16."""

OVERFLOW = 65520.0
"""Least magnitude that rounds to infinity: halfway between the largest binary16, 65504, and 2**16."""
STRETCH = 1024
"""Values that a work-item of a CPU, or a group of a GPU's, converts."""
_GROUP = 128
VANISHING = 2.0**-25
"""Largest magnitude that rounds to 0."""


@register
@dataclass(frozen=True)
class Half(Codec):
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

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """Return the halves; InputError names the first coefficient that overflows, unless clamping.

        A map of which nothing would be left is refused too.
        """
        check_not_vanishing(coeffs_khwc)
        halves_p = np.empty(coeffs_khwc.size, np.float16)
        overflows = convert("encode_half_p", halves_p, coeffs_khwc.reshape(-1), device, clamp=self.clamp)
        clamped = 0
        if overflows:
            if not self.clamp:
                raise overflow_error(coeffs_khwc, "clamp")
            clamped = int(np.count_nonzero(np.abs(coeffs_khwc) >= OVERFLOW))
        return halves_p.tobytes(), {"clamped": float(clamped)}

    def predict_noise(self, coeffs_khwc: NDArray[np.float32], device: Device) -> Noise:
        """Return the paper's relative noise: errors even over the spacing of halves at each coefficient, independent.

        From a sample of the columns.
        """
        sample_khwc = sample_columns(coeffs_khwc)
        return Noise.of_coefficients(np.diag(rounding_variance(sample_khwc).mean(axis=(1, 2, 3))))

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """Return the coefficients, exactly what was stored; PayloadError on a wrong length, infinity or NaN."""
        expected = 2 * math.prod(shape)
        if len(body) != expected:
            raise PayloadError(f"codec half: shape {shape} takes {expected} bytes, the body has {len(body)}")
        coeffs_khwc = np.empty(shape, np.float32)
        halves_p = np.require(np.frombuffer(body, np.float16), requirements="A")
        if convert("decode_half_p", coeffs_khwc.reshape(-1), halves_p, device, clamp=False):
            raise PayloadError("codec half: the body holds an infinity or a NaN")
        return coeffs_khwc


def rounding_variance(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the expected squared error of each value as a half, from nothing but its binade, float64.

    A twelfth of the squared spacing: 2**-10 of the binade's lower end, and 2**-24 below 2**-14. What rounds to 0 loses
    its square, what is clamped that of its excess.
    """
    magnitude = np.abs(values.astype(np.float64))
    spacing = np.ldexp(1.0, np.maximum(np.frexp(magnitude)[1] - 11, -24))
    variance = np.where(magnitude < 2.0**-25, magnitude, spacing / np.sqrt(12.0)) ** 2
    return np.where(magnitude >= OVERFLOW, (magnitude - LARGEST) ** 2, variance)


def check_not_vanishing(coeffs_khwc: NDArray[np.float32]) -> None:
    """Raise InputError where every coefficient rounds to 0 as binary16, though not all are 0."""
    check_largest(find_largest(coeffs_khwc))


def find_largest(coeffs_khwc: NDArray[np.float32]) -> float:
    """Return the largest magnitude, or one that binary16 holds as soon as one is found."""
    coeffs_p, largest = coeffs_khwc.reshape(-1), 0.0
    for slab in slabs(coeffs_p.size, 1 << 10):  # small ones: nearly always the first ends the search
        largest = max(largest, float(np.abs(coeffs_p[slab]).max()))
        if largest > VANISHING:
            break
    return largest


def check_largest(largest: float) -> None:
    """Raise InputError where a map's largest magnitude rounds to 0 as binary16, and is not 0."""
    if 0.0 < largest <= VANISHING:
        raise InputError(
            f"the largest coefficient is {largest:g}, and as binary16 all would be 0: give the stack a peak near its "
            "brightest sample"
        )


def overflow_error(coeffs_khwc: NDArray[np.float32], otherwise: str, first_row: int = 0) -> InputError:
    """Return what says which of these coefficients, of rows from `first_row` on, is the first to overflow."""
    k, row, column, channel = (int(i) for i in np.argwhere(np.abs(coeffs_khwc) >= OVERFLOW)[0])
    return InputError(
        f"coefficient (k, row, column, channel) = {(k, first_row + row, column, channel)} is "
        f"{coeffs_khwc[k, row, column, channel]:g}, which binary16 cannot hold (|x| must be below {OVERFLOW:g}); "
        f"fit with a constrained method, or {otherwise}"
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
        fetched = device.download(result)
        if fetched is not out:
            out[:] = fetched
        refused |= bool(device.download(refused_j).any())
    return refused


def launch_conversion(
    device: Device, kernel: str, out_p: DeviceArray, refused_j: DeviceArray, values_p: DeviceArray, *, clamp: bool
) -> None:
    """Queue ``encode_half_p`` or ``decode_half_p``; `refused_j` has one entry for each `STRETCH` values."""
    (stretches,) = refused_j.shape
    if device.style == "gpu":
        file, group, defines = "gpu/codec/half.cl", _GROUP, {"STRETCH": STRETCH, "GROUP": _GROUP}
    else:
        file, group, defines = "codec/half.cl", 1, {"VECTORS": STRETCH // 8}
    device.launch(
        file,
        kernel,
        (stretches * group,),
        out_p,
        refused_j,
        values_p,
        values_p.shape[0],
        defines={**defines, "CLAMP": int(clamp)},
        local_size=(group,),
    )
