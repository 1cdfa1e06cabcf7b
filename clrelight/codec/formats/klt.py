"""Whitened principal-axis coding: what a scene does not need costs no bits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body, BodyWriter
from clrelight.codec.damage import Damage
from clrelight.codec.entropy.units import MARGIN, PRECINCT
from clrelight.codec.formats import klt_body
from clrelight.codec.formats.klt_decode import UnitView, bytes_at_once
from clrelight.codec.formats.klt_encode import Encoder
from clrelight.codec.formats.klt_units import HEAD_SIZE, VERSION, parse_body, parse_head
from clrelight.codec.minimum_size import drop_padding, minimum_overhead, pad_to_minimum
from clrelight.codec.registry import PartsCodec, refuse_infinite, register
from clrelight.codec.streams import ArraySource, Source, Target
from clrelight.codec.transforms.code_values import code_value_error, code_values_of, radiance_of
from clrelight.codec.transforms.colour import METRICS, RADIANCE, check_metric
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.principal import STEP_RANGE
from clrelight.codec.views import Region, View
from clrelight.codec.workspace import Shape, Workspace
from clrelight.conventions import TRANSFERS
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.threads import on_one_thread

_CODED = 4.0
"""Times the squared error of code values that are no function of the degree at which those are not what to save at."""
_BRIGHTEST = 2.0**120
"""Mean radiance, about, up to which what comes back through the curve is finite for certain."""
_WHOLE_BYTES = 1 << 29
"""Bytes of a map that is coded behind a curve and without it; of a larger one, pieces are."""
_PIECE, _PIECE_VALUES = 128, 1 << 23


@register
@dataclass(frozen=True)
class Klt(PartsCodec):
    """Whitened coordinates, their principal axes over coefficients and channels, 9/7 wavelet, and units of rANS.

    One quantiser step for everything, in a metric where it costs the same image error near all lights of the fit (all
    over the hemisphere, where none are known). An axis is coded if what it saves in squared error is worth the bits of
    its plane and of its row in the table, however few pixels need it; the planes are solved against the table as it is
    coded. Indices are chosen by what they cost.

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

    metric : str
        ``"radiance"``: errors cost the same in every channel, as PSNR counts them. ``"perceptual"``: they cost what
        they are in CIELAB, where colours are worth twice as much, which at low rates keeps them.

    One of rate, byte_budget and step is given; by default the rate is 0.1.
    """

    id: ClassVar[str] = "klt"
    hemisphere: ClassVar[bool] = True
    decodes_finite: ClassVar[bool] = True
    summary: ClassVar[str] = (
        "whitened principal axes, 9/7 wavelet and units of rANS: quality per byte, regions and levels"
    )

    rate: float | None = None
    byte_budget: int | None = None
    step: float | None = None
    transfer: str | None = None
    metric: str = RADIANCE

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
        if self.metric not in METRICS:
            raise InputError(f"klt metric must be one of {', '.join(METRICS)}, got {self.metric!r}")

    def for_transfer(self, transfer: str) -> Klt:
        """See `Codec`."""
        return self if self.transfer is not None else replace(self, transfer=transfer)

    def bytes_to_encode(self, shape: Shape) -> int:
        """See `Codec`: the planes of one tile, of which a map may need as many as it has values a pixel."""
        side = PRECINCT + 2 * MARGIN
        return 8 * shape[0] * shape[3] * min(shape[1], side) * min(shape[2], side)

    @classmethod
    def bytes_to_decode(cls, body: Body, shape: Shape) -> int:
        """See `Codec`."""
        front = drop_padding(body, shape)
        if not _is_in_units(front):
            return 12 * math.prod(shape)
        return bytes_at_once(shape, parse_head(front[:HEAD_SIZE], shape).n_plane)

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """See `Codec`; the step chosen and the number of planes are reported."""
        shape = source.shape
        check_metric(self.metric, shape[3])
        if self.transfer != "srgb":
            content, info = self._encode_as(Pixels(source), source.workspace)
        elif 4 * math.prod(shape) <= _WHOLE_BYTES:
            content, info = self._encode_either(_held(source), source.workspace)
        else:
            transfer = self._choose_transfer(source)
            content, info = self._encode_as(Pixels(source, transfer), source.workspace)
        body.write_all(content)
        return info

    def _encode_either(self, source: ArraySource, workspace: Workspace) -> tuple[bytes, dict[str, float]]:
        """Return a map behind the curve, or without it, whichever shows less error of code values when it is relit."""
        coeffs_khwc, device, basis, lights_i3 = source.whole(), source.device, source.basis, source.lights_i3
        if np.abs(coeffs_khwc[0]).max() > _BRIGHTEST:
            return self._encode_as(Pixels(source), workspace)
        shape, values_khwc = coeffs_khwc.shape, code_values_of(coeffs_khwc, device, basis)

        def error(shown_khwc: NDArray[np.float32], curve: str) -> float:
            return code_value_error(shown_khwc, coeffs_khwc, device, basis, lights_i3, as_code_values=curve == "srgb")

        def lost_in(content: bytes) -> float:
            found = self.decode_regions(content, shape)
            assert found is not None
            return error(found.shown(Region(0, 0, *shape[1:3]), device), found.curve)

        uncoded = error(values_khwc, "srgb")
        # The coefficients of code values are there already.
        bent = self._encode_as(Pixels(ArraySource(values_khwc, device, basis, lights_i3)), workspace, "srgb")
        lost = lost_in(bent[0])
        if lost > _CODED * uncoded:
            return bent
        try:
            plain = self._encode_as(Pixels(source), workspace)
        except InputError:  # the step or budget is none for this way
            return bent
        # At a step bytes differ: about so much error is worth them.
        return bent if lost * len(bent[0]) < lost_in(plain[0]) * len(plain[0]) else plain

    def _choose_transfer(self, source: Source) -> str:
        """Return the curve that is better for pieces of a large map."""
        n_coeff, height, width, channel = source.shape
        side = min(_PIECE, max(math.isqrt(_PIECE_VALUES // (n_coeff * channel)) // 32, 2) * 32)
        side_h, side_w = min(side, height), min(side, width)
        pieces, pixels = [], Pixels(source)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            top, left = (height - side_h) * (2 * i + 1) // 4, (width - side_w) * (2 * j + 1) // 4
            pieces.append(pixels.coefficients((top, top + side_h), (left, left + side_w)).copy())
        mosaic_khwc = np.concatenate(pieces, axis=1)
        share = mosaic_khwc.size / math.prod(source.shape)
        codec = self if self.byte_budget is None else replace(self, byte_budget=max(int(self.byte_budget * share), 1))
        mosaic = ArraySource(mosaic_khwc, source.device, source.basis, source.lights_i3)
        content, _ = codec._encode_either(mosaic, Workspace())
        return parse_body(drop_padding(content, mosaic_khwc.shape), mosaic_khwc.shape).head.transfer

    def _encode_as(
        self, pixels: Pixels, workspace: Workspace, transfer: str | None = None
    ) -> tuple[bytes, dict[str, float]]:
        """Return the body; `transfer` is what it says of its values where they are bent already."""
        shape, budget = pixels.shape, self._budget(pixels.shape)

        def encode(beside: Sequence[tuple[int, int]] = ()) -> tuple[Encoder, bytes, dict[str, float]]:
            memory, tell = workspace.memory_bytes, workspace.tell
            with on_one_thread():  # those of a product spin for a while after it, in the way of the device
                encoder = Encoder(pixels, transfer or pixels.transfer, self.metric, memory, tell, beside)
                if budget is None:
                    return encoder, *encoder.encode(self.step or 0.0)
                return encoder, *encoder.encode_within(budget - minimum_overhead(shape))

        encoder, body, info = encode()
        # Axes are those of some of the pixels: where they are all alike, the others are looked at.
        if not info["planes"] and (missed := encoder.missed(info["step"])):
            encoder, body, info = encode(missed)
        encoder.check_kept(info)
        encoder.check_decodes(body)
        return pad_to_minimum(body, shape, budget), info

    def _budget(self, shape: Shape) -> int | None:
        """Return the bytes that are not to be passed; None where there is a step."""
        if self.step is not None:
            return None
        rated = (self.rate or 0.0) * math.prod(shape) / 8.0
        return int(rated if self.byte_budget is None else self.byte_budget)

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """See `Codec`."""
        regions = cls.decode_regions(body, target.shape)
        if regions is not None:
            regions.put_rows(target, device)
            return
        view, head = klt_body.decode_planes(drop_padding(body, target.shape)[:], target.shape, device)
        coeffs_khwc = view.to_coeffs(device)
        coeffs_khwc = radiance_of(coeffs_khwc, device) if head.transfer == "srgb" else coeffs_khwc
        refuse_infinite(coeffs_khwc, cls.id, device)
        target.put_rows(0, coeffs_khwc)

    @classmethod
    def decode_view(cls, body: Body, shape: Shape, device: Device) -> View | None:
        """Return what relights without coefficients; of old bodies None behind a curve."""
        regions = cls.decode_regions(body, shape)
        if regions is not None:
            return regions
        content = drop_padding(body, shape)[:]
        if klt_body.parse_head(content, shape).transfer != "linear":
            return None
        return klt_body.decode_planes(content, shape, device)[0]

    @classmethod
    def decode_regions(cls, body: Body, shape: Shape, damage: Damage | None = None) -> UnitView | None:
        """See `Codec`; None of old bodies."""
        body = drop_padding(body, shape)
        return UnitView(body, parse_body(body, shape), shape, damage) if _is_in_units(body) else None


def _held(source: Source) -> ArraySource:
    return ArraySource(source.whole(), source.device, source.basis, source.lights_i3)


def _is_in_units(body: Body) -> bool:
    return body[:1] == bytes([VERSION])
