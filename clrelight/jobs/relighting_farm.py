"""What `relight` hands to other processes: some pictures each, as the bytes of their files."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, starmap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.durable import replacing
from clrelight.jobs.farm import Arrays, Chore, Farm, check_written, facts_of, shared_path
from clrelight.jobs.frames import Frames, LightFrames, tell_below
from clrelight.jobs.inputs import FittedLike
from clrelight.jobs.pictures import is_animation, write_animation
from clrelight.jobs.report import Report
from clrelight.jobs.unfinished import Unfinished
from clrelight.lighting.light import Light
from clrelight.tiles import row_tiles

RELIGHT_SOME = "relight-some"
_TOGETHER = 8
"""Pictures of a chore at the least: what is decoded is decoded once for them."""


@dataclass
class _Made:
    """What has come so far: pictures of an animation, notes, what is the same for all, and the device of the first."""

    animated: list[NDArray[np.uint8]]
    notes: list[str]
    below: float
    exposure: float = 0.0
    device: str | None = None


@dataclass(frozen=True)
class SharedFrames:
    """Pictures of a file that other processes relight: see `clrelight.jobs.relighting_chores.relight_some`."""

    farm: Farm
    source: str
    options: Mapping[str, Any]
    reads: tuple[str, ...]
    names: list[str]

    @classmethod
    def of(
        cls,
        farm: Farm,
        source: FittedLike,
        light: ArrayLike | Light | str | os.PathLike[str] | None,
        lights: str | os.PathLike[str] | None,
        names: list[str],
        options: Mapping[str, Any],
    ) -> SharedFrames:
        """Return what relights a file; InputError where other processes have none, or nothing is written."""
        relit = shared_path(source, "what is relit")
        check_written(names)
        files = {"light": light, "lights": lights}
        paths = {
            name: shared_path(file, "the light file")
            for name, file in files.items()
            if isinstance(file, str | os.PathLike | Light)
        }
        given: dict[str, Any] = {"light": None if light is None else np.asarray(light).tolist(), **options, **paths}
        if "light" in paths:
            given["light"] = paths["light"]
        given = {name: value for name, value in given.items() if value is not None}
        return cls(farm, relit, given, tuple(paths.values()), names)

    def write(self, frames: Frames, exposure: float | None, report: Report, unfinished: Unfinished | None) -> None:
        """Have all pictures made but those that an interrupted job left, and write them."""
        since, count, made = time.perf_counter(), frames.count, _Made([], [], 0.0)
        first, known = 0, {} if unfinished is None else unfinished.facts
        if unfinished is not None and known:
            unfinished.tell(report)
            made.below = unfinished.below
            exposure = unfinished.exposure if exposure is None else exposure
        if exposure is None:  # that of the first picture is that of all
            self._put(self._do([(0, 1)], None), [0], made, unfinished)
            exposure, first = made.exposure, 1
        # Of as many as one process makes at a time, or a multiple: then they are its pictures, bit for bit.
        each = frames.together(self.source)
        parts = row_tiles((first, count), -(-_TOGETHER // each) * each)
        parts = [part for part in parts if not all(number in known for number in range(*part))]
        self._put(self._do(parts, exposure), chain.from_iterable(starmap(range, parts)), made, unfinished)
        if made.animated:
            write_animation(self.names[0], made.animated)
        if unfinished is not None:
            unfinished.end()
        report.add("relight", since)
        report.note(*made.notes)
        report.device = made.device
        if isinstance(frames, LightFrames):
            report.facts |= {"exposure": exposure, "below": made.below}
            tell_below(made.below, count, report)

    def _put(self, found: Iterator[Arrays], numbers: Iterable[int], made: _Made, unfinished: Unfinished | None) -> None:
        """Write pictures of these numbers, or keep those of an animation."""
        following = iter(numbers)
        for each in found:
            told = facts_of(each["told"])
            made.notes += told["notes"]
            made.device = made.device or told["device"]
            made.below = max(made.below, float(each["below"]))
            made.exposure = float(each["exposure"])
            for at in range(int(each["count"])):
                content, number = each[f"picture{at}"], next(following)
                if is_animation(self.names[0]):
                    made.animated.append(content)
                else:
                    with replacing(self.names[number]) as part:
                        part.write(content.tobytes())
                    if unfinished is not None:
                        facts = {"exposure": made.exposure, "below": made.below, "notes": [] if at else told["notes"]}
                        unfinished.add(number, facts)

    def _do(self, parts: Sequence[tuple[int, int]], exposure: float | None) -> Iterator[Arrays]:
        kind = os.path.splitext(self.names[0])[1]
        given = {**self.options, "kind": kind, "exposure": "auto" if exposure is None else exposure}
        chores = [Chore(RELIGHT_SOME, self.source, {**given, "some": list(part)}, self.reads) for part in parts]
        return self.farm.do(chores, "relighting")
