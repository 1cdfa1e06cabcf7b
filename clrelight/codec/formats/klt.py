"""Whitened principal-axis coding: what a scene does not need costs no bits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.ballast import add_ballast, ballast_overhead, drop_ballast
from clrelight.codec.formats import klt_body
from clrelight.codec.formats.klt_decode import UnitView, decode_rows
from clrelight.codec.formats.klt_encode import Encoder
from clrelight.codec.formats.klt_units import STEP_RANGE, VERSION, parse_body
from clrelight.codec.registry import Codec, View, register
from clrelight.codec.streams import ArrayTarget
from clrelight.codec.transforms.code_values import code_value_error, code_values_of, radiance_of
from clrelight.conventions import TRANSFERS
from clrelight.device import Device
from clrelight.errors import InputError

_CODED = 4.0
"""Times the squared error of the way through a curve and back at which that way is not what to save at."""
_MEMORY = 1 << 30
"""Bytes of planes at once."""


@register
@dataclass(frozen=True)
class Klt(Codec):
    """Whitened coordinates, their principal axes over coefficients and channels, 9/7 wavelet, and units of rANS.

    One quantiser step for everything, in a metric where it costs the same image error everywhere. An axis is coded if
    what it saves in squared error is worth the bits of its plane and of its row in the table, however few pixels need
    it; the planes are solved against the table as it is coded. Indices are chosen by what they cost.

    Attributes
    ----------
    rate : float, optional
        Bits per coefficient not to be passed.
    byte_budget : int, optional
        Bytes not to be passed. At least 99% are used, unless the finest step needs less.
    step : float, optional
        Quantiser step in radiance times root steradian, relative to the largest coefficient's power of two.
    transfer : str, optional
        What errors are of; by default ``"linear"`` radiance. ``"srgb"`` codes the coefficients of sRGB code values,
        unless those of radiance leave less error of code values: a degree holds the bent function less well, which
        counts at fine steps and for few lights. Decoding gives linear radiance with either.

    One of rate, byte_budget and step is given; by default the rate is 0.1.
    """

    id: ClassVar[str] = "klt"
    summary: ClassVar[str] = "whitened principal axes, 9/7 wavelet and range coding: quality per byte"

    rate: float | None = None
    byte_budget: int | None = None
    step: float | None = None
    transfer: str | None = None

    def __post_init__(self) -> None:
        given = [name for name in ("rate", "byte_budget", "step") if getattr(self, name) is not None]
        if len(given) > 1:
            raise InputError(f"klt takes one of rate, byte_budget and step, got {' and '.join(given)}")
        if not given:
            object.__setattr__(self, "rate", 0.1)
        for name in ("rate", "byte_budget", "step"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | float) and 0.0 < value < float("inf")):
                raise InputError(f"klt {name} must be a positive number, got {value!r}")
        if self.step is not None and not STEP_RANGE[0] <= self.step <= STEP_RANGE[1]:
            raise InputError(f"klt step must be {STEP_RANGE[0]:g} to {STEP_RANGE[1]:g}, got {self.step!r}")
        if self.transfer is not None and self.transfer not in TRANSFERS:
            raise InputError(f"klt transfer must be one of {', '.join(TRANSFERS)}, got {self.transfer!r}")

    def for_transfer(self, transfer: str) -> Klt:
        """See `Codec`."""
        return self if self.transfer is not None else replace(self, transfer=transfer)

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """See `Codec`; the step chosen and the number of planes are reported."""
        if self.transfer != "srgb":
            return self._encode_as("linear", coeffs_khwc, device)
        shape, values_khwc = coeffs_khwc.shape, code_values_of(coeffs_khwc, device)
        there_and_back = code_value_error(radiance_of(values_khwc, device), coeffs_khwc, device)
        bent = self._encode_as("srgb", values_khwc, device)
        del values_khwc  # as large as the map: room to decode in
        lost = code_value_error(self.decode_body(bent[0], shape, device), coeffs_khwc, device)
        if lost > _CODED * there_and_back:
            return bent
        try:
            plain = self._encode_as("linear", coeffs_khwc, device)
        except InputError:  # the step or budget is none for this way
            return bent
        left = code_value_error(self.decode_body(plain[0], shape, device), coeffs_khwc, device)
        return bent if lost < left else plain

    def _encode_as(
        self, transfer: str, coeffs_khwc: NDArray[np.float32], device: Device
    ) -> tuple[bytes, dict[str, float]]:
        shape = coeffs_khwc.shape
        encoder = Encoder(shape, lambda first, end: coeffs_khwc[:, first:end], transfer, device, _MEMORY)
        if self.step is not None:
            body, info = encoder.encode(self.step)
            return add_ballast(body, shape), info
        budget = int(self.byte_budget if self.byte_budget is not None else (self.rate or 0.0) * coeffs_khwc.size / 8.0)
        body, info = encoder.encode_within(budget - ballast_overhead(shape))
        return add_ballast(body, shape, budget), info

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """See `Codec`."""
        body = drop_ballast(body, shape)
        if body[:1] == bytes([VERSION]):
            target = ArrayTarget(shape)
            decode_rows(body, parse_body(body, shape), target, device, _MEMORY)
            return target.coeffs()
        view, head = klt_body.decode_planes(body, shape, device)
        coeffs_khwc = view.to_coeffs(device)
        return radiance_of(coeffs_khwc, device) if head.transfer == "srgb" else coeffs_khwc

    @classmethod
    def decode_view(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> View | None:
        """Return the planes and the matrix that make coefficients, or images, of them; of old bodies, None behind a curve."""
        body = drop_ballast(body, shape)
        if body[:1] == bytes([VERSION]):
            return UnitView(body, parse_body(body, shape), shape)
        if klt_body.parse_head(body, shape).transfer != "linear":
            return None
        return klt_body.decode_planes(body, shape, device)[0]
