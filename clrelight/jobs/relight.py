"""Show a view under any light: one direction, several, or light from everywhere."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.codec import decode_view
from clrelight.conventions import TRANSFERS
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.jobs.inputs import (
    FittedLike,
    is_encoded,
    lend_coefficients,
    open_on,
    paths_among,
    take_encoded,
    whole,
)
from clrelight.jobs.pictures import (
    check_animation,
    holds_floats,
    is_animation,
    name_pictures,
    show,
    write_animation,
    write_view,
)
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_stops
from clrelight.lighting.hemisphere import share_below
from clrelight.lighting.light import Light
from clrelight.lighting.relighting import TONEMAPS, automatic_exposure, relight_under
from clrelight.lighting.rotation import rotate_light, rotation_matrix
from clrelight.lights import read_directions, read_lp
from clrelight.relight import relight as relight_directions
from clrelight.store import check_output, read_light

MAX_STEPS = 1 << 16
_PICTURE_BYTES = 1 << 26
"""So many bytes of pictures, and one at least, are made in one pass through the coefficients."""

Rotation = float | tuple[str, Sequence[float]]
"""Degrees about z, or a form of `rotation_matrix` and its numbers."""


@overload
def relight(
    source: FittedLike,
    light: ArrayLike | Light | str | os.PathLike[str] | None = None,
    *,
    lights: str | os.PathLike[str] | None = None,
    out: None = None,
    exposure: float | str = 0.0,
    rotate: Rotation | None = None,
    turntable: int | None = None,
    about: Sequence[float] | None = None,
    tonemap: str | None = None,
    transfer: str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> NDArray[np.float32]: ...


@overload
def relight(
    source: FittedLike,
    light: ArrayLike | Light | str | os.PathLike[str] | None = None,
    *,
    lights: str | os.PathLike[str] | None = None,
    out: str | os.PathLike[str],
    exposure: float | str = 0.0,
    rotate: Rotation | None = None,
    turntable: int | None = None,
    about: Sequence[float] | None = None,
    tonemap: str | None = None,
    transfer: str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report: ...


def relight(
    source: FittedLike,
    light: ArrayLike | Light | str | os.PathLike[str] | None = None,
    *,
    lights: str | os.PathLike[str] | None = None,
    out: str | os.PathLike[str] | None = None,
    exposure: float | str = 0.0,
    rotate: Rotation | None = None,
    turntable: int | None = None,
    about: Sequence[float] | None = None,
    tonemap: str | None = None,
    transfer: str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> NDArray[np.float32] | Report:
    """Return, or write, the view under a direction, under several, or under light from everywhere.

    Parameters
    ----------
    source : path, CoefficientMap or Encoded
    light : array_like, Light or path, optional
        Three numbers, or rows of them: directions from the surface to the light, of any length. Or light from
        everywhere: a `Light`, or the path of a light file.
    lights : path, optional
        Directions from a file instead, an ``.lp`` or a table.
    out : path, optional
        Where to write. The name decides the format: ``.exr``, ``.hdr`` and ``.tif`` hold linear radiance as floats,
        ``.png``, ``.jpg`` and others 8-bit display values. For several images it holds a number field such as
        ``%03d``; a turntable may be a ``.gif``.
    exposure : float or str
        Stops: values are scaled by ``2**exposure``. ``"auto"`` (light from everywhere): so that hardly anything is
        clipped.
    rotate : float or (str, numbers), optional
        Turn light from everywhere: degrees about z, or a form and numbers of `rotation_matrix`.
    turntable : int, optional
        So many images, light from everywhere going round once.
    about : three numbers, optional
        Axis of the turntable; default: z.
    tonemap : str, optional
        ``"clip"`` or ``"reinhard"``: of 8-bit images under light from everywhere.
    transfer : str, optional
        ``"linear"`` or ``"srgb"``: curve of 8-bit files; default: the stack's.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    ndarray, float32
        Linear radiance in units of the peak, not clipped: (height, width, channel) for three numbers and for light
        from everywhere, (n, height, width, channel) for rows of numbers, a file of directions and a turntable. With
        `out` instead the report.

    Raises
    ------
    InputError
        If a direction has no length, a file is damaged or none of ours, or `out` cannot be written.
    """
    target = None if out is None else os.fsdecode(out)
    how = _How(count_stops(exposure), rotate, turntable, about, tonemap, transfer)
    how.check(target)
    kept = report_for(report)
    frames: _Frames
    if isinstance(light, Light | str | os.PathLike):
        if lights is not None:
            raise InputError("a light file is light from everywhere: give one --light, and no --lights beside it")
        how.check_turntable()
        frames, flat = _TurnedLight(light, how), turntable is None
    else:
        how.refuse_turns()
        flat = light is not None and np.ndim(light) == 1  # type: ignore[arg-type]
        frames = _Directions(_directions(light, lights), how.exposure or 0.0)
    names = _name(target, frames, paths_among(source, light, lights))
    opened = open_on(device)
    kept.device = opened.info.label
    images_ihwc = _show(frames, source, names, how, opened, kept, progress)
    if target is not None:
        kept.facts = {"files": names, **kept.facts}
        return kept
    return images_ihwc[0] if flat else images_ihwc


@dataclass(frozen=True)
class _How:
    """How images are asked for: stops (None is auto), turns, and what becomes of them in 8-bit files."""

    exposure: float | None
    rotate: Rotation | None
    turntable: int | None
    about: Sequence[float] | None
    tonemap: str | None
    transfer: str | None

    def check(self, target: str | None) -> None:
        """Raise InputError if the file that is written, if any, is none for these options, or one is unknown."""
        if self.transfer is not None and self.transfer not in TRANSFERS:
            raise InputError(f"transfer must be one of {', '.join(TRANSFERS)}, got {self.transfer!r}")
        if self.tonemap is not None and self.tonemap not in TONEMAPS:
            raise InputError(f"tone mapping must be one of {', '.join(TONEMAPS)}, got {self.tonemap!r}")
        for option, value in (("--transfer", self.transfer), ("--tonemap", self.tonemap)):
            if value is not None and (target is None or holds_floats(target)):
                told = "what is returned" if target is None else target
                raise InputError(f"{option} is for 8-bit files, but {told} holds linear radiance: leave it out")

    def check_turntable(self) -> None:
        """Raise InputError if an axis comes without a turntable, or is none."""
        if self.about is not None and (self.turntable is None or not np.any(_numbers(self.about))):
            raise InputError("--about X,Y,Z is the axis of --turntable N, and not all zero")

    def refuse_turns(self) -> None:
        """Raise InputError if something is asked for that directions do not have."""
        if self.exposure is None or any(v is not None for v in (self.rotate, self.turntable, self.about, self.tonemap)):
            raise InputError(
                "--exposure auto, --rotate, --turntable, --about and --tonemap are for light files (--light LIGHT.h5)"
            )


class _Frames(Protocol):
    """What is to be shown: so many images under some light."""

    @property
    def count(self) -> int: ...

    def lend(self, source: FittedLike, device: Device, report: Report, progress: Progress | None) -> Any:
        """Lend (a context manager) the images one by one, in linear radiance, and the stack's transfer."""


class _Directions:
    """Images under one distant light each."""

    def __init__(self, directions_i3: NDArray[np.float64], exposure: float) -> None:
        self._directions_i3, self._exposure = directions_i3, exposure

    @property
    def count(self) -> int:
        return len(self._directions_i3)

    @contextmanager
    def lend(
        self, source: FittedLike, device: Device, report: Report, progress: Progress | None
    ) -> Iterator[tuple[Iterator[NDArray[np.float32]], str]]:
        below = np.flatnonzero(self._directions_i3[:, 2] < 0)
        report.note(*(f"light {i} is below the horizon, where a hemispherical fit knows nothing" for i in below))
        with _lend_view(source, device, report, progress) as view:
            yield self._images(view, report), view.transfer

    def _images(self, view: _View, report: Report) -> Iterator[NDArray[np.float32]]:
        step = max(1, _PICTURE_BYTES // view.picture_bytes)
        for first in range(0, self.count, step):
            since = time.perf_counter()
            pictures_ihwc = view.light(self._directions_i3[first : first + step])
            pictures_ihwc *= np.float32(2.0**self._exposure)
            report.add("relight", since)
            yield from pictures_ihwc


class _TurnedLight:
    """Images under light from everywhere, one for each step of a turntable."""

    def __init__(self, light: Light | str | os.PathLike[str], how: _How) -> None:
        self.count = 1 if how.turntable is None else whole(how.turntable, "turntable")
        if not 1 <= self.count <= MAX_STEPS:
            raise InputError(f"turntable must be 1 to {MAX_STEPS}, got {self.count}")
        lit = light if isinstance(light, Light) else read_light(light)
        self._light, self._how = lit if how.rotate is None else _turn(lit, how.rotate), how

    @contextmanager
    def lend(
        self, source: FittedLike, device: Device, report: Report, progress: Progress | None
    ) -> Iterator[tuple[Iterator[NDArray[np.float32]], str]]:
        with lend_coefficients(source, device, report, progress) as coefficients:
            yield self._images(coefficients, device, report), coefficients.transfer

    def _images(self, coefficients: CoefficientMap, device: Device, report: Report) -> Iterator[NDArray[np.float32]]:
        exposure, below = self._how.exposure, -math.inf  # the largest share of all steps
        for step in range(self.count):
            since = time.perf_counter()
            turn = ("axis", (*(self._how.about or (0.0, 0.0, 1.0)), 360.0 * step / self.count))
            turned = _turn(self._light, turn) if step else self._light
            below = max(below, share_below(turned))
            image_hwc = relight_under(coefficients, turned, device=device)
            if exposure is None:
                exposure = automatic_exposure(image_hwc)  # of the first image, for all of them
            image_hwc *= np.float32(2.0**exposure)
            report.add("relight", since)
            yield image_hwc
        report.facts |= {"exposure": exposure, "below": below}
        if below > 0:
            share = f"{'up to ' if self.count > 1 else ''}{below:.1%}"
            report.note(f"{share} of the light comes from below the horizon, where the fit knows nothing: it is cut")


def _show(
    frames: _Frames,
    source: FittedLike,
    names: list[str],
    how: _How,
    device: Device,
    report: Report,
    progress: Progress | None,
) -> NDArray[np.float32]:
    """Write all images where they have names; return them where they have none."""
    kept_ihwc, pictures = np.empty((0,), np.float32), []
    with frames.lend(source, device, report, progress) as (images, transfer), stage(progress, "relighting") as tell:
        for index, image_hwc in enumerate(images):
            since = time.perf_counter()
            if not names:
                if index == 0:
                    kept_ihwc = np.empty((frames.count, *image_hwc.shape), np.float32)
                kept_ihwc[index] = image_hwc
            elif is_animation(names[0]):
                pictures.append(show(image_hwc, how.tonemap, how.transfer or transfer))
            else:
                write_view(names[index], image_hwc, how.tonemap, how.transfer or transfer)
            if names:
                report.add("write", since)
            tell(index + 1, frames.count)
        if pictures:
            since = time.perf_counter()
            write_animation(names[0], pictures)
            report.add("write", since)
    return kept_ihwc


@dataclass(frozen=True)
class _View:
    """What makes pictures of directions, the bytes of one, and the stack's transfer."""

    light: Callable[[NDArray[np.float64]], NDArray[np.float32]]
    picture_bytes: int
    transfer: str


@contextmanager
def _lend_view(source: FittedLike, device: Device, report: Report, progress: Progress | None) -> Iterator[_View]:
    """Lend a view to relight.

    An encoding with a basis of its own relights there: only the light vector is transformed.
    """
    if is_encoded(source):
        since = time.perf_counter()
        encoded, record = take_encoded(source)  # type: ignore[arg-type]
        view = decode_view(encoded, device)
        report.add("decode", since)
        if view is not None:
            picture_bytes = 4 * math.prod(encoded.shape[1:])
            yield _View(lambda directions_i3: view.relight(directions_i3, device), picture_bytes, record.transfer)
            return
    with lend_coefficients(source, device, report, progress) as coefficients:
        yield _View(
            lambda directions_i3: relight_directions(coefficients, directions_i3, device=device),
            4 * math.prod(coefficients.image_shape),
            coefficients.transfer,
        )


def _turn(light: Light, rotation: Rotation) -> Light:
    form, numbers = rotation if isinstance(rotation, tuple) else ("axis", (0.0, 0.0, 1.0, rotation))
    try:
        matrix = rotation_matrix(form, numbers)
    except TypeError:
        raise InputError(
            f"expected a rotation as degrees about z, or as a form and its numbers, got {rotation!r}"
        ) from None
    return rotate_light(light, matrix)


def _directions(light: ArrayLike | None, lights: str | os.PathLike[str] | None) -> NDArray[np.float64]:
    """Return unit vectors from numbers of any length, or from a file."""
    if (light is None or np.size(light) == 0) == (lights is None):
        raise InputError("give the light by --light X,Y,Z or by --lights FILE")
    if lights is None:
        directions_i3 = _numbers(light)
    elif os.fsdecode(lights).lower().endswith(".lp"):
        directions_i3 = read_lp(Path(os.fsdecode(lights)))[1]
    else:
        directions_i3 = read_directions(Path(os.fsdecode(lights)))
    # Scaled by the largest component first, whose square could be beyond float64's range.
    largest = np.max(np.abs(directions_i3), axis=1, keepdims=True)
    bad = np.flatnonzero(~(np.isfinite(largest[:, 0]) & (largest[:, 0] > 0)))
    if bad.size:
        raise InputError(
            f"light {bad[0]} has the direction {directions_i3[bad[0]]}, expected finite numbers that are not all zero"
        )
    directions_i3 = directions_i3 / largest
    return directions_i3 / np.linalg.norm(directions_i3, axis=1, keepdims=True)


def _numbers(light: ArrayLike | None) -> NDArray[np.float64]:
    """Return directions as rows of float64, whatever real numbers they come in."""
    wanted = "expected a direction as three numbers, or rows of three"
    try:
        given = np.asarray(light)
    except ValueError:
        raise InputError(f"{wanted}, got rows of different lengths") from None
    if given.dtype.kind not in "fiu" or given.ndim not in (1, 2) or given.shape[-1] != 3:
        raise InputError(f"{wanted}, got {given.dtype} of shape {given.shape}")
    return given.reshape(-1, 3).astype(np.float64)


def _name(target: str | None, frames: _Frames, inputs: list[Any]) -> list[str]:
    """Return the files to write, each of which can be; none where images are returned."""
    if target is None:
        return []
    if isinstance(frames, _TurnedLight) and is_animation(target):
        check_animation()
        names = [target]
    else:
        names = name_pictures(target, frames.count)
    for name in names:
        check_output(name, inputs)
    return names
