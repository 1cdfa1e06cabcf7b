"""Options of ``clrelight light`` that make a light without a map, and rotations of ``light`` and ``relight``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import Numbers, gather
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.lighting.light import Light

ROTATION_HELP = "DEG about z, counterclockwise; or euler:A,B,C (Z Y Z), quaternion:W,X,Y,Z, axis:X,Y,Z,DEG."

Rotation = tuple[str, tuple[float, ...]]

_COUNTS = {"euler": 3, "quaternion": 4, "axis": 4}
_ROUNDING = 1e-9


class Turn(click.ParamType):
    """A rotation: an angle about z in degrees, or a form and its numbers."""

    name = "ROTATION"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Rotation:
        """Return a form of `rotation.rotation_matrix` and its numbers."""
        if isinstance(value, tuple):
            return value
        form, colon, words = str(value).partition(":")
        try:
            numbers = tuple(float(word) for word in (words if colon else form).split(","))
        except ValueError:
            numbers = ()
        if not colon and len(numbers) == 1:
            form, numbers = "axis", (0.0, 0.0, 1.0, *numbers)
        if _COUNTS.get(form) != len(numbers) or not all(map(math.isfinite, numbers)):
            self.fail(
                "expected an angle about z in degrees, such as 90, or euler:A,B,C, quaternion:W,X,Y,Z or "
                f"axis:X,Y,Z,DEG, got {value!r}",
                param,
                ctx,
            )
        return form, numbers


class Sample(click.ParamType):
    """A light file and where it was sampled: LIGHT@X,Y,Z."""

    name = "LIGHT@X,Y,Z"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, tuple[float, ...]]:
        """Return the file's name and the position."""
        if isinstance(value, tuple):
            return value
        file, _, place = str(value).rpartition("@")
        if not file:
            self.fail(f"expected a light file and its position, such as hall.h5@0,1.5,2, got {value!r}", param, ctx)
        return file, Numbers(float, "0,1.5,2", 3).convert(place, param, ctx)


@dataclass(frozen=True)
class Lamp:
    """What was asked of a light that is made without a map; the fields are the options."""

    sky: str | None
    sun: tuple[float, float] | None
    zenith: float | None
    cap: tuple[float, float, float, float] | None
    directional: tuple[float, float, float] | None
    colour: tuple[float, ...] | None
    blend: tuple[tuple[str, tuple[float, float, float]], ...]
    at: tuple[float, float, float] | None
    power: float | None

    @property
    def sources(self) -> dict[str, Any]:
        """The sources, of which a light has one, by what is shown to the user."""
        return {
            "--sky NAME": self.sky,
            "--cap X,Y,Z,ANGLE": self.cap,
            "--directional X,Y,Z": self.directional,
            "--blend LIGHT@X,Y,Z": self.blend,
        }

    @property
    def extent(self) -> tuple[tuple[float, ...], float] | None:
        """A direction and the angle around it, in degrees, that the light comes from; None for a blend."""
        if self.cap:
            return self.cap[:3], self.cap[3]
        if self.directional:
            return self.directional, 0.0
        return ((0.0, 0.0, 1.0), 90.0) if self.sky else None

    def check(self) -> None:
        """Refuse options that go with another source than the one that was given."""
        coloured = self.sky or self.cap or self.directional
        for option, value, source, wanted in (
            ("--sun", self.sun, self.sky, "--sky"),
            ("--zenith", self.zenith, self.sky, "--sky"),
            ("--colour", self.colour, coloured, "--sky, --cap and --directional"),
            ("--at", self.at, self.blend, "--blend"),
            ("--power", self.power, self.blend, "--blend"),
        ):
            if value is not None and not source:
                raise InputError(f"{option} is for {wanted}")
        if self.colour is not None and len(self.colour) not in (1, 3):
            raise InputError(f"--colour takes 1 or 3 numbers, got {len(self.colour)}")
        if self.sky and self.sky != "overcast" and self.sun is None:
            raise InputError(f"sky {self.sky} needs the sun: --sun ELEVATION,AZIMUTH in degrees")
        if self.blend and self.at is None:
            raise InputError("--blend needs the place where the light is wanted: --at X,Y,Z")


def lamp_options(command: Any) -> Any:
    """Add the options that `Lamp` holds, which the command gets as `lamp`."""
    command = gather(Lamp, "lamp")(command)
    for option in reversed(
        (
            click.option(
                "--sky",
                metavar="NAME",
                help="CIE sky: overcast, clear, partly-cloudy, or 1 to 15 of the standard general sky; z is up.",
            ),
            click.option(
                "--sun",
                type=Numbers(float, "30,45", 2),
                metavar="ELEV,AZ",
                help="Where the sun is, degrees; AZ from x to y.",
            ),
            click.option("--zenith", type=float, metavar="KCD", help="Luminance of the zenith, kcd/m²; default 1."),
            click.option(
                "--cap",
                type=Numbers(float, "0,0,1,30", 4),
                metavar="X,Y,Z,ANGLE",
                help="A round light: radiance 1 within ANGLE degrees of a direction.",
            ),
            click.option(
                "--directional",
                type=Numbers(float, "0,0.6,0.8", 3),
                metavar="X,Y,Z",
                help="A distant lamp of irradiance 1.",
            ),
            click.option(
                "--colour",
                type=Numbers(float, "1,0.9,0.7"),
                metavar="R,G,B",
                help="Colour of sky, cap or lamp: 1 or 3 factors.",
            ),
            click.option(
                "--blend",
                type=Sample(),
                multiple=True,
                help="Light files sampled at positions, weighted by their distance from --at.",
            ),
            click.option("--at", type=Numbers(float, "1,0,2", 3), metavar="X,Y,Z", help="Where a blend is wanted."),
            click.option("--power", type=float, help="Weights of a blend are 1 / distance^POWER; default 10."),
        )
    ):
        command = option(command)
    return command


def make_lamp(lamp: Lamp, degree: int | None) -> Light:
    """Return the light that was asked for; a blend is of its samples' largest degree where none is given."""
    import numpy as np

    from clrelight.lighting.lamps import BLEND_POWER, WHITE, blend_lights, cap_light, directional_light
    from clrelight.lighting.sky import sky_light
    from clrelight.store import read_light

    colour = lamp.colour or WHITE
    wanted = 6 if degree is None else degree
    if lamp.sky:
        zenith = 1.0 if lamp.zenith is None else lamp.zenith
        return sky_light(lamp.sky, *(lamp.sun or (90.0, 0.0)), zenith=zenith, degree=wanted, colour=colour)
    if lamp.cap:
        return cap_light(lamp.cap[:3], lamp.cap[3], wanted, colour)
    if lamp.directional:
        return directional_light(lamp.directional, wanted, colour)
    lights = [read_light(file) for file, _ in lamp.blend]
    power = BLEND_POWER if lamp.power is None else lamp.power
    positions_i3 = np.array([position for _, position in lamp.blend])
    return blend_lights(lights, positions_i3, np.array(lamp.at), power)


def note_horizon(lamp: Lamp, rotation: Rotation | None) -> list[str]:
    """Return a note that fits of a hemisphere will not see the light, or a part of it, as it lies once rotated."""
    from clrelight.harmonics.rotation import rotation_matrix

    if lamp.extent is None:
        return []
    (x, y, z), angle = lamp.extent
    if rotation is not None:
        x, y, z = rotation_matrix(*rotation) @ (x, y, z)
    elevation = math.degrees(math.atan2(z, math.hypot(x, y)))
    if elevation - angle >= -_ROUNDING:
        return []
    what = "the light" if elevation + angle <= _ROUNDING else "a part of the light"
    return [f"{what} is below the horizon (z < 0): relighting a fit of the hemisphere cuts it"]


def rotate_by(light: Light, rotation: Rotation) -> Light:
    """Return the light turned as ``--rotate`` says."""
    from clrelight.harmonics.rotation import rotation_matrix
    from clrelight.lighting.rotation import rotate_light

    return rotate_light(light, rotation_matrix(*rotation))
