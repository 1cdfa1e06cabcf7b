"""Pictures of a surface one by one: what goes round from one to the next."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.jobs.frames import MAX_STEPS, Rotation, turn_light
from clrelight.jobs.inputs import whole
from clrelight.jobs.report import Report
from clrelight.surface import Surface
from clrelight.transfer.cameras import UP, Camera, Framing, middle_of
from clrelight.transfer.painting import Background, Painter, Picture
from clrelight.transfer.sources import DirectionalLight, DistantLight, Source

TURNS = ("view", "light")
"""What goes round on a turntable."""


Placed = tuple[Picture, Camera, Background | None]


@dataclass(frozen=True)
class SurfaceFrames:
    """How many pictures there are, and what goes round from one to the next."""

    count: int
    turns: str
    about: Sequence[float] | None
    is_turntable: bool

    @classmethod
    def asked(cls, turntable: int | None, turns: str, about: Sequence[float] | None) -> SurfaceFrames:
        """Return what `turntable` steps, or one picture where it is None, ask for; InputError where they cannot be."""
        count = 1 if turntable is None else whole(turntable, "turntable")
        if not 1 <= count <= MAX_STEPS:
            raise InputError(f"turntable must be 1 to {MAX_STEPS}, got {count}")
        if turns not in TURNS:
            raise InputError(f"what turns is one of {', '.join(TURNS)}, got {turns!r}")
        if about is not None:
            axis_3 = numbers_of(about, "--about")
            if turntable is None or axis_3.shape != (3,) or not axis_3.any():
                raise InputError("--about X,Y,Z is the axis of --turntable N: three finite numbers, not all zero")
        return cls(count, turns, about, turntable is not None)

    @property
    def axis(self) -> tuple[float, ...]:
        """Of the turn."""
        return UP if self.about is None else tuple(float(v) for v in self.about)

    def paint(
        self,
        painter: Painter,
        sources: list[Source],
        camera: Camera,
        behind: Background | None,
        colour_c: NDArray[np.float32],
        report: Report,
        numbers: Sequence[int],
    ) -> Iterator[Placed]:
        """Yield pictures of these numbers, tinted, the camera of each, and what lies behind it."""
        by_light = self.turns == "light" and self.is_turntable
        if by_light and not all(isinstance(each, DistantLight | DirectionalLight) for each in sources):
            raise InputError("lights near the surface do not go round it: let the view turn (--turns view)")
        if by_light and not sources:
            raise InputError("under a fixed light only the view can turn (--turns view)")
        middle_3 = middle_of(painter.body or painter.surface)
        for step in numbers:
            since = time.perf_counter()
            angle = 360.0 * step / self.count
            lit, view, back = sources, camera, behind
            if by_light and step:
                lit = turn_sources(sources, ("axis", (*self.axis, angle)))
                back = turn_background(behind, ("axis", (*self.axis, angle)))
            elif step:
                view = camera.turned(angle, self.axis, middle_3)
            picture = painter.paint(lit, view)
            report.add("render", since)
            if picture.behind > 0.0:
                report.note(f"{picture.behind:.1%} of what is seen is the inner side of the surface, which is black")
            yield replace(picture, radiance_hwc=picture.radiance_hwc * colour_c), view, back


def turn_sources(sources: list[Source], rotation: Rotation | None) -> list[Source]:
    """Return distant lights turned; InputError where others are asked to."""
    if rotation is None:
        return sources
    if not sources:
        raise InputError("--rotate turns distant light, and there is none")
    turned: list[Source] = []
    for source in sources:
        if isinstance(source, DistantLight):
            turned.append(DistantLight(turn_light(source.light, rotation)))
        elif isinstance(source, DirectionalLight):
            direction_3 = rotation_of(rotation) @ np.asarray(source.direction_3)
            turned.append(replace(source, direction_3=tuple(direction_3)))
        else:
            raise InputError("--rotate turns distant light; lights near the surface have positions of their own")
    return turned


def turn_background(behind: Background | None, rotation: Rotation | None) -> Background | None:
    """Return what lies behind the surface, turned as the light is."""
    if behind is None or rotation is None:
        return behind
    matrix = rotation_of(rotation)
    return lambda directions_n3: behind(directions_n3 @ matrix)  # what comes from d after the turn came from R^T d


def rotation_of(rotation: Rotation) -> NDArray[np.float64]:
    """Return the matrix (3, 3) of a turn as people write it."""
    form, numbers = rotation if isinstance(rotation, tuple) else ("axis", (0.0, 0.0, 1.0, rotation))
    return rotation_matrix(form, numbers)


def place_camera(
    camera: Camera | Framing | Sequence[float] | None, surface: Surface, size: tuple[int, int], frames: SurfaceFrames
) -> Camera:
    """Return the camera of a first picture; where the view goes round, one that sees the whole surface all the time."""
    if isinstance(camera, Camera):
        return camera
    if not isinstance(camera, Framing):
        camera = Framing(direction_3=None if camera is None else tuple(numbers_of(camera, "a camera's direction")))
    turning = frames.turns == "view" and frames.count > 1
    return camera.place(surface, aspect=size[0] / size[1], turning=turning)


def colour_of(recolour: ArrayLike | None, coefficients: CoefficientMap) -> NDArray[np.float32]:
    """Return the colour of a surface whose map has one channel, (3,); (1,) ones where none is wanted."""
    if recolour is None:
        return np.ones(1, np.float32)
    colour_c = numbers_of(recolour, "the colour of a surface")
    if colour_c.shape != (3,) or (colour_c < 0).any():
        raise InputError(f"the colour of a surface is 3 numbers that are not negative, got {recolour}")
    if coefficients.image_shape[2] != 1:
        raise InputError(f"recolouring takes a map of 1 channel, this has {coefficients.image_shape[2]}")
    return colour_c.astype(np.float32)


def numbers_of(value: ArrayLike, what: str) -> NDArray[np.float64]:
    """Return finite numbers as an array; InputError where they are none."""
    try:
        held = np.asarray(value)
    except ValueError:
        held = np.empty(0, object)
    if held.dtype.kind not in "fiu" or not np.isfinite(held).all():
        raise InputError(f"{what} takes finite numbers, got {value!r}")
    return held.astype(np.float64)
