"""Images that are asked for, under directions or light from everywhere: how they are made, named and written."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence, Sized
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.arrays import check_transfer
from clrelight.device import Device
from clrelight.directions import unit_directions
from clrelight.errors import InputError
from clrelight.jobs.frames import DirectedFrames, Frames, LightFrames, Rotation, tell_below, turn_light
from clrelight.jobs.inputs import FittedLike, Path, read_directions, whole
from clrelight.jobs.pictures import (
    array_of,
    check_animation,
    holds_floats,
    is_animation,
    name_pictures,
    show,
    write_animation,
    write_view,
)
from clrelight.jobs.region import Part, take_part
from clrelight.jobs.report import Progress, Report, stage
from clrelight.jobs.unfinished import Unfinished
from clrelight.jobs.written import count_stops
from clrelight.lighting.light import Light
from clrelight.lighting.relighting import TONEMAPS
from clrelight.store import read_light

_TOLD = ("exposure", "below")
"""Facts of images under light from everywhere."""


@dataclass(frozen=True)
class How:
    """How images are asked for: stops (None is auto), turns, and what becomes of them in 8-bit files."""

    exposure: float | None
    rotate: Rotation | None
    turntable: int | None
    about: Sequence[float] | None
    tonemap: str | None
    transfer: str | None
    part: Part
    salvage: bool

    def check(self, target: str | None) -> None:
        """Raise InputError if the file that is written, if any, is none for these options, or one is unknown."""
        if self.transfer is not None:
            check_transfer(self.transfer)
        if self.tonemap is not None and self.tonemap not in TONEMAPS:
            raise InputError(f"tone mapping must be one of {', '.join(TONEMAPS)}, got {self.tonemap!r}")
        for option, value in (("--transfer", self.transfer), ("--tonemap", self.tonemap)):
            if value is not None and (target is None or holds_floats(target)):
                told = "what is returned" if target is None else target
                raise InputError(f"{option} is for 8-bit files, but {told} holds linear radiance: leave it out")

    def frames(
        self,
        light: ArrayLike | Light | str | os.PathLike[str] | None,
        lights: str | os.PathLike[str] | None,
        report: Report,
    ) -> tuple[Frames, bool]:
        """Return the images, and whether one alone is asked for by itself."""
        if isinstance(light, Light | str | os.PathLike):
            if lights is not None:
                raise InputError("a light file is light from everywhere: give one --light, and no --lights beside it")
            self.check_turntable()
            return self.frames_of(light), self.turntable is None
        self.refuse_turns()
        directions_i3, flat = _directions(light, lights, report)
        return DirectedFrames(directions_i3, self.exposure or 0.0, self.part, self.salvage), flat

    def check_turntable(self) -> None:
        """Raise InputError if an axis comes without a turntable, or is none."""
        if self.about is not None and (self.turntable is None or not np.any(_numbers(self.about))):
            raise InputError("--about X,Y,Z is the axis of --turntable N, and not all zero")

    def frames_of(self, light: Light | str | os.PathLike[str]) -> LightFrames:
        """Return the images under light from everywhere."""
        steps = 1 if self.turntable is None else whole(self.turntable, "turntable")
        lit = light if isinstance(light, Light) else read_light(light)
        turned = lit if self.rotate is None else turn_light(lit, self.rotate)
        axis = (0.0, 0.0, 1.0) if self.about is None else tuple(float(v) for v in self.about)
        return LightFrames(turned, self.exposure, steps, axis, self.part, self.salvage)

    def refuse_turns(self) -> None:
        """Raise InputError if something is asked for that directions do not have."""
        if self.exposure is None or any(v is not None for v in (self.rotate, self.turntable, self.about, self.tonemap)):
            raise InputError(
                "--exposure auto, --rotate, --turntable, --about and --tonemap are for light files (--light LIGHT.h5)"
            )


def take_how(
    exposure: float | str = 0.0,
    rotate: Rotation | None = None,
    turntable: int | None = None,
    about: Sequence[float] | None = None,
    tonemap: str | None = None,
    transfer: str | None = None,
    region: Sequence[int] | None = None,
    level: int = 0,
    salvage: bool = False,
) -> How:
    """Return how images are asked for by the options of `clrelight.jobs.relight.relight`; InputError as it says."""
    return How(count_stops(exposure), rotate, turntable, about, tonemap, transfer, take_part(region, level), salvage)


def show_frames(
    frames: Frames,
    source: FittedLike,
    names: list[str],
    how: How,
    device: Device,
    report: Report,
    progress: Progress | None,
    unfinished: Unfinished | None = None,
) -> NDArray[np.float32]:
    """Write all images where they have names, but those that an interrupted job left; else return them."""

    def some(part: Frames, first: int, end: int) -> NDArray[np.float32]:
        return _show_some(part, source, names[first:end], how, device, report, progress, unfinished, first)

    if unfinished is None or not unfinished.facts:
        made = some(frames, 0, len(names))
    else:
        made = np.empty((0,), np.float32)
        _show_rest(frames, unfinished, frames.together(source), some, report)
    if unfinished is not None:
        unfinished.end()
    return made


def _show_rest(
    frames: Frames,
    unfinished: Unfinished,
    together: int,
    some: Callable[[Frames, int, int], object],
    report: Report,
) -> None:
    """Write the images that an interrupted job has left out."""
    unfinished.tell(report)
    exposure, below = unfinished.exposure, unfinished.below
    for first, end in list(unfinished.missing(together)):  # of what is there now
        some(frames.only(first, end, exposure), first, end)
        below = max(below, float(report.facts.get("below", 0.0)))
    if isinstance(frames, LightFrames):
        report.facts |= {"exposure": exposure, "below": below}
        tell_below(below, frames.count, report)


def _show_some(
    frames: Frames,
    source: FittedLike,
    names: list[str],
    how: How,
    device: Device,
    report: Report,
    progress: Progress | None,
    unfinished: Unfinished | None,
    number: int,
) -> NDArray[np.float32]:
    """Write or return images, the first of which has this number among all."""
    kept_ihwc, pictures, n_note = np.empty((0,), np.float32), [], len(report.notes)
    with frames.lend(source, device, report, progress) as (images, transfer), stage(progress, "relighting") as tell:
        for index, image in enumerate(images):
            since, relit = time.perf_counter(), report.seconds.get("relight", 0.0)
            if not names:
                if index == 0:
                    kept_ihwc = np.empty((frames.count, *image.shape), np.float32)
                kept_ihwc[index] = array_of(image)
            elif is_animation(names[0]):
                pictures.append(show(array_of(image), how.tonemap, how.transfer or transfer))
            else:
                write_view(names[index], image, how.tonemap, how.transfer or transfer)
                if unfinished is not None:
                    told = {name: report.facts[name] for name in _TOLD if name in report.facts}
                    unfinished.add(number + index, {**told, "notes": report.notes[n_note:]})
                    n_note = len(report.notes)
            if names:  # rows are relit while others are written
                report.add("write", since + report.seconds.get("relight", 0.0) - relit)
            tell(index + 1, frames.count)
        if pictures:
            since = time.perf_counter()
            write_animation(names[0], pictures)
            report.add("write", since)
    return kept_ihwc


def _directions(light: ArrayLike | None, lights: Path | None, report: Report) -> tuple[NDArray[np.float64], bool]:
    """Return unit vectors from numbers of any length or from a file, and whether it was one direction's numbers."""
    given = light is not None and not (isinstance(light, Sized) and len(light) == 0)
    if given == (lights is not None):
        raise InputError("give the light by --light X,Y,Z or by --lights FILE")
    if lights is None:
        numbers = _numbers(light)
        return unit_directions(numbers.reshape(-1, 3), "light {}".format, allow_below=True), numbers.ndim == 1
    return read_directions(lights, report), False


def _numbers(light: ArrayLike | None) -> NDArray[np.float64]:
    """Return three numbers, or rows of them, as float64, whatever real numbers they come in."""
    wanted = "expected a direction as three numbers, or rows of three"
    try:
        given = np.asarray(light)
    except ValueError:
        raise InputError(f"{wanted}, got rows of different lengths") from None
    if given.dtype.kind not in "fiu" or given.ndim not in (1, 2) or given.shape[-1] != 3:
        raise InputError(f"{wanted}, got {given.dtype} of shape {given.shape}")
    return given.astype(np.float64)


def name_frames(target: str | None, frames: Frames) -> list[str]:
    """Return the files to write; none where images are returned."""
    if target is None:
        return []
    if isinstance(frames, LightFrames) and is_animation(target):
        check_animation()
        return [target]
    return name_pictures(target, frames.count)
