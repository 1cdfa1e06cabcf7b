"""The images of a relit view, one by one: under directions, or under light from everywhere that goes round."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import decode_view
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.jobs.inputs import FittedLike, Packed, decoded_of, lend_fitted, refuse_salvage
from clrelight.jobs.pictures import Rows
from clrelight.jobs.region import Part, crop, decode_part, refuse_level
from clrelight.jobs.report import Progress, Report
from clrelight.lighting.light import Light, share_below
from clrelight.lighting.relighting import automatic_exposure, relight_under
from clrelight.lighting.rotation import rotate_light, rotate_lights
from clrelight.memory import TILE_BYTES
from clrelight.relight import relight
from clrelight.surface import surface_facts
from clrelight.transfer.reflection import OPERATOR

MAX_STEPS = 1 << 16

Rotation = float | tuple[str, Sequence[float]]
"""Degrees about z, or a form of `rotation_matrix` and its numbers."""
Image = NDArray[np.float32] | Rows
_RowsOf = Callable[[NDArray[np.float64]], Iterator[tuple[slice, NDArray[np.float32]]]]
Shown = tuple[Iterator[Image], str]
"""Images one by one, in linear radiance, and the transfer of their stack."""


class Frames(Protocol):
    """What is to be shown: so many images under some light."""

    @property
    def count(self) -> int:
        """How many."""
        ...

    def only(self, first: int, end: int, exposure: float | None = None) -> Frames:
        """Return the images first..end alone, at the exposure of all where that hangs on another image."""
        ...

    def together(self, source: FittedLike) -> int:
        """Return how many are made at a time: the last digits of one may hang on how many."""
        ...

    def lend(
        self, source: FittedLike, device: Device, report: Report, progress: Progress | None
    ) -> AbstractContextManager[Shown]:
        """Lend the images."""
        ...


class DirectedFrames:
    """Images under one distant light each."""

    def __init__(
        self,
        directions_i3: NDArray[np.float64],
        exposure: float,
        part: Part | None = None,
        salvage: bool = False,
        first: int = 0,
    ) -> None:
        self._directions_i3, self._exposure, self._part = directions_i3, exposure, part or Part()
        self._salvage, self._first = salvage, first

    @property
    def count(self) -> int:
        """How many."""
        return len(self._directions_i3)

    def only(self, first: int, end: int, exposure: float | None = None) -> DirectedFrames:
        """See `Frames`."""
        chosen_i3, number = self._directions_i3[first:end], self._first + first
        return DirectedFrames(chosen_i3, self._exposure, self._part, self._salvage, number)

    def together(self, source: FittedLike) -> int:
        """See `Frames`."""
        with lend_fitted(source, Report(), parts=True, salvage=self._salvage, any_basis=True) as held:
            height, width, channel = held.encoded.shape[1:] if isinstance(held, Packed) else held.image_shape
        return _at_once((*self._part.of(height, width).shape, channel))

    @contextmanager
    def lend(self, source: FittedLike, device: Device, report: Report, progress: Progress | None) -> Iterator[Shown]:
        """See `Frames`."""
        with _lend_view(source, self._part, self._salvage, device, report, progress) as view:
            if view.is_picture:  # functions of a surface may know the whole sphere
                below = self._first + np.flatnonzero(self._directions_i3[:, 2] < 0)
                report.note(
                    *(f"light {i} is below the horizon, where a hemispherical fit knows nothing" for i in below)
                )
            yield self._images(view, report), view.transfer

    def _images(self, view: _View, report: Report) -> Iterator[Image]:
        if self.count == 1 and view.rows is not None:
            yield Rows(view.shape, self._rows(view.rows, report))
            return
        step = _at_once(view.shape)
        for first in range(0, self.count, step):
            since = time.perf_counter()
            pictures_ihwc = view.light(self._directions_i3[first : first + step])
            if self._exposure != 0.0:
                pictures_ihwc *= np.float32(2.0**self._exposure)
            report.add("relight", since)
            yield from pictures_ihwc

    def _rows(self, rows: _RowsOf, report: Report) -> Iterator[NDArray[np.float32]]:
        since = time.perf_counter()
        for _, band_ihwc in rows(self._directions_i3):
            band_hwc = band_ihwc[0]
            if self._exposure != 0.0:
                band_hwc = band_hwc * np.float32(2.0**self._exposure)
            report.add("relight", since)
            yield band_hwc
            since = time.perf_counter()


class LightFrames:
    """Images under light from everywhere, one for each step of a turntable."""

    def __init__(
        self,
        light: Light,
        exposure: float | None,
        steps: int,
        axis: Sequence[float],
        part: Part | None = None,
        salvage: bool = False,
        some: tuple[int, int] | None = None,
    ) -> None:
        if not 1 <= steps <= MAX_STEPS:
            raise InputError(f"turntable must be 1 to {MAX_STEPS}, got {steps}")
        self._steps, self._some = steps, some or (0, steps)
        self._light, self._exposure, self._axis, self._part = light, exposure, axis, part or Part()
        self._salvage = salvage

    @property
    def count(self) -> int:
        """How many."""
        return self._some[1] - self._some[0]

    def only(self, first: int, end: int, exposure: float | None = None) -> LightFrames:
        """See `Frames`."""
        some = self._some[0] + first, self._some[0] + end
        stops = self._exposure if exposure is None else exposure
        return LightFrames(self._light, stops, self._steps, self._axis, self._part, self._salvage, some)

    def together(self, source: FittedLike) -> int:
        """See `Frames`."""
        return 1

    @contextmanager
    def lend(self, source: FittedLike, device: Device, report: Report, progress: Progress | None) -> Iterator[Shown]:
        """See `Frames`."""
        since, salvage = time.perf_counter(), self._salvage
        with lend_fitted(source, report, parts=not self._part.is_all, salvage=salvage, any_basis=True) as held:
            report.add("read", since)
            _refuse_operators(held)
            coefficients = _part_of(held, source, self._part, salvage, device, report, progress)
            yield self._images(coefficients, device, report), coefficients.transfer

    def _images(self, coefficients: CoefficientMap, device: Device, report: Report) -> Iterator[NDArray[np.float32]]:
        exposure, below = self._exposure, -math.inf  # the largest share of all steps
        is_picture = surface_facts(coefficients.surface, coefficients.config) is None
        degrees = [360.0 * step / self._steps for step in range(*self._some) if step]
        turns = [rotation_matrix("axis", (*self._axis, each)) for each in degrees]
        still = [] if self._some[0] else [self._light]
        since = time.perf_counter()
        for turned in chain(still, rotate_lights(self._light, np.reshape(turns, (-1, 3, 3)))):
            # Functions of a surface know the whole sphere.
            below = max(below, share_below(turned) if is_picture else 0.0)
            image_hwc = relight_under(coefficients, turned, device=device)
            if exposure is None:
                exposure = automatic_exposure(image_hwc)  # of the first image, for all of them
            if exposure != 0.0:
                image_hwc *= np.float32(2.0**exposure)
            report.add("relight", since)
            report.facts |= {"exposure": exposure, "below": below}
            yield image_hwc
            since = time.perf_counter()
        if self.count == self._steps:
            tell_below(below, self.count, report)


def _at_once(shape: tuple[int, int, int]) -> int:
    """Return how many pictures of directions are made in one pass through the coefficients."""
    return max(1, TILE_BYTES // (4 * math.prod(shape)))


def tell_below(below: float, count: int, report: Report) -> None:
    """Note the largest share of the light of so many images that comes from below the horizon."""
    if below > 0:
        share = f"{'up to ' if count > 1 else ''}{below:.1%}"
        report.note(f"{share} of the light comes from below the horizon, where the fit knows nothing: it is cut")


@dataclass(frozen=True)
class _View:
    """What makes pictures of directions, the shape of one, the stack's transfer, and whether pixels are a picture's.

    What makes the rows of one direction's picture, from top to bottom, where they need not be there together.
    """

    light: Callable[[NDArray[np.float64]], NDArray[np.float32]]
    shape: tuple[int, int, int]
    transfer: str
    is_picture: bool
    rows: _RowsOf | None = None


@contextmanager
def _lend_view(
    source: FittedLike, part: Part, salvage: bool, device: Device, report: Report, progress: Progress | None
) -> Iterator[_View]:
    """Lend a view to relight.

    An encoding with a basis of its own relights there: only the light vector is transformed.
    """
    since = time.perf_counter()
    with lend_fitted(source, report, parts=not part.is_all, salvage=salvage, any_basis=True) as held:
        since = report.add("read", since)
        _refuse_operators(held)
        if isinstance(held, Packed):
            encoded = held.encoded
            region, light, rows = part.of(*encoded.shape[1:3]), None, None
            if (regions := held.regions()) is not None:
                light = partial(regions.relight_region, region=region, device=device)
                rows = partial(regions.relight_rows, region=region, device=device)
            elif part.is_all and (view := decode_view(encoded, device)) is not None:
                light = partial(view.relight, device=device)
            report.add("decode", since)
            if light is not None:
                is_picture = surface_facts(None, held.record.config) is None
                yield _View(light, (*region.shape, encoded.shape[3]), held.record.transfer, is_picture, rows)
                return
        coefficients = _part_of(held, source, part, salvage, device, report, progress)
        yield _View(
            lambda directions_i3: relight(coefficients, directions_i3, device=device),
            coefficients.image_shape,
            coefficients.transfer,
            surface_facts(coefficients.surface, coefficients.config) is None,
        )


def _refuse_operators(held: CoefficientMap | Packed) -> None:
    """Raise InputError where entries of matrices would be taken for coefficients."""
    if (held.record.method if isinstance(held, Packed) else held.method) == OPERATOR:
        raise InputError("these are operators, from light to views: clrelight reflect makes radiance of them")


def _part_of(
    held: CoefficientMap | Packed,
    source: FittedLike,
    part: Part,
    salvage: bool,
    device: Device,
    report: Report,
    progress: Progress | None,
) -> CoefficientMap:
    """Return a part of a fit, decoded where it is encoded; InputError where there is no such part."""
    since = time.perf_counter()
    if isinstance(held, Packed):
        if part.is_all and not salvage:
            return decoded_of(held, source, device, report, progress)
        coefficients = decode_part(held, part, device)
        report.add("decode", since)
        return coefficients
    if salvage:
        refuse_salvage("a fit")
    refuse_level(part, "a fit")
    coefficients = decoded_of(held, source, device, report, progress)
    return coefficients if part.is_all else crop(coefficients, part)


def turn_light(light: Light, rotation: Rotation) -> Light:
    """Return a light turned; InputError where the rotation is none."""
    try:
        form, numbers = rotation if isinstance(rotation, tuple) else ("axis", (0.0, 0.0, 1.0, rotation))
        matrix = rotation_matrix(form, numbers)
    except InputError:
        raise
    except (TypeError, ValueError):
        raise InputError(
            f"expected a rotation as degrees about z, or as a form and its numbers, got {rotation!r}"
        ) from None
    return rotate_light(light, matrix)
