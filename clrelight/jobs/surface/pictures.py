"""What becomes of pictures of a surface: exposure, background, files."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import check_transfer
from clrelight.errors import InputError
from clrelight.jobs.pictures import (
    ANIMATIONS,
    FLOAT_FORMATS,
    check_animation,
    holds_floats,
    is_animation,
    name_pictures,
    show,
    write_animation,
    write_view,
)
from clrelight.jobs.report import Progress, Report, stage
from clrelight.jobs.surface.frames import Placed
from clrelight.jobs.surface.transparency import check_alpha, write_transparent
from clrelight.jobs.unfinished import Unfinished
from clrelight.lighting.relighting import TONEMAPS, automatic_exposure
from clrelight.transfer.cameras import Camera
from clrelight.transfer.painting import Background, Picture, put_on


@dataclass(frozen=True)
class Showing:
    """What becomes of radiance: stops (None is auto), and of 8-bit files tones and curve."""

    exposure: float | None
    tonemap: str | None
    transfer: str

    def check(self, target: str | None) -> None:
        """Raise InputError where an option is unknown, or the file is none for it."""
        check_transfer(self.transfer)
        if self.tonemap is not None and self.tonemap not in TONEMAPS:
            raise InputError(f"tone mapping must be one of {', '.join(TONEMAPS)}, got {self.tonemap!r}")
        if self.tonemap is not None and (target is None or holds_floats(target)):
            told = "what is returned" if target is None else target
            raise InputError(f"--tonemap is for 8-bit files, but {told} holds linear radiance: leave it out")

    def show(
        self,
        pictures: Iterator[Placed],
        names: list[str],
        numbers: Sequence[int],
        has_alpha: bool,
        report: Report,
        progress: Progress | None,
        unfinished: Unfinished | None = None,
    ) -> NDArray[np.float32]:
        """Write pictures of these numbers where they have names; return them where they have none."""
        known = None if unfinished is None else unfinished.exposure
        exposure, kept, animated = self.exposure if known is None else known, [], []
        n_note = len(report.notes)
        with stage(progress, "rendering") as tell:
            for index, (picture, camera, behind) in zip(numbers, pictures, strict=True):
                if exposure is None:
                    exposure = _automatic(picture)  # of the first picture, for all of them
                image_hwc = _compose(picture, camera, behind, has_alpha, np.float32(2.0**exposure))
                since = time.perf_counter()
                if not names:
                    kept.append(image_hwc)
                elif is_animation(names[0]):
                    animated.append(show(image_hwc, self.tonemap, self.transfer))
                elif has_alpha:
                    write_transparent(names[index], image_hwc, self.tonemap, self.transfer)
                else:
                    write_view(names[index], image_hwc, self.tonemap, self.transfer)
                if unfinished is not None:
                    unfinished.add(index, {"exposure": exposure, "notes": report.notes[n_note:]})
                    n_note = len(report.notes)
                report.add("write", since)
                tell(index + 1, numbers[-1] + 1)
            if animated:
                write_animation(names[0], animated)
        if unfinished is not None:
            unfinished.end()
        report.facts["exposure"] = exposure
        return np.stack(kept) if kept else np.empty((0,), np.float32)


def numbers_to_make(unfinished: Unfinished | None, count: int, report: Report, together: int = 1) -> Sequence[int]:
    """Return the numbers of pictures that are not there yet, and note those that are; `together` are made at a time."""
    if unfinished is None or not unfinished.facts:
        return range(count)
    unfinished.tell(report)
    return unfinished.numbers(together)


def _compose(
    picture: Picture, camera: Camera, behind: Background | None, has_alpha: bool, scale: np.float32
) -> NDArray[np.float32]:
    if has_alpha:
        return np.concatenate([scale * picture.radiance_hwc, picture.coverage_hw[..., None]], axis=2)
    return scale * (picture.radiance_hwc if behind is None else put_on(picture, behind, camera))


def _automatic(picture: Picture) -> float:
    """Return the stops of `automatic_exposure` of what the surface covers."""
    whole_hw = picture.coverage_hw >= 1.0
    chosen_hw = whole_hw if whole_hw.any() else picture.coverage_hw > 0.0
    return automatic_exposure(picture.radiance_hwc[chosen_hw][None])


PICTURE_FORMATS = (*FLOAT_FORMATS, ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".ppm", ".pgm", *ANIMATIONS)


def picture_names(target: str | None, count: int, has_alpha: bool) -> list[str]:
    """Return the files to write; none where pictures are returned."""
    if target is None:
        return []
    if not target.lower().endswith(PICTURE_FORMATS):  # before any work
        raise InputError(f"cannot write {target}: a picture's name ends in one of {', '.join(PICTURE_FORMATS)}")
    if has_alpha:
        check_alpha(target)
    if is_animation(target):
        check_animation()
        return [target]
    return name_pictures(target, count)
