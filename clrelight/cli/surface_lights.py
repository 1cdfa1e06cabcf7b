"""Options of ``clrelight render`` that say what shines on a surface, and from where it is seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.lamps import Lamp, Sample, make_lamp
from clrelight.cli.options import Numbers, gather
from clrelight.cli.relight import LightOrDirection
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.jobs.report import Report
    from clrelight.jobs.surface.inputs import LightLike
    from clrelight.transfer.cameras import Framing

Triple = tuple[float, float, float]


class Polygon(click.ParamType):
    """Corners in a row, with radiance behind a colon."""

    name = "X,Y,Z,X,Y,Z,...[:RADIANCE]"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the corners' numbers, and the radiance."""
        if isinstance(value, tuple):
            return value
        text, colon, shades = str(value).partition(":")
        corners = Numbers(float, "0,0,2,1,0,2,0,1,2").convert(text, param, ctx)
        if len(corners) % 3 or len(corners) < 9:
            self.fail(f"expected three corners or more of three numbers each, got {value!r}", param, ctx)
        return corners, Numbers(float, "1,0.9,0.7").convert(shades, param, ctx) if colon else (1.0,)


@dataclass(frozen=True)
class SurfaceLamps:
    """What shines; the fields are the options."""

    light: tuple[Triple | str, ...]
    environments: tuple[str, ...]
    layout: str | None
    axes: str
    sky: str | None
    sun: tuple[float, float] | None
    zenith: float | None
    cap: tuple[float, float, float, float] | None
    colour: tuple[float, ...] | None
    point: tuple[tuple[float, ...], ...]
    sphere: tuple[tuple[float, ...], ...]
    area: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]
    two_sided: bool
    local: tuple[tuple[str, Triple], ...]
    local_blend: str | None
    power: float | None

    def lights(self, report: Report) -> list[LightLike]:
        """Return lights as `render` takes them."""
        self._check()
        found: list[LightLike] = [each if isinstance(each, str) else tuple(each) for each in self.light]
        if self.environments:
            from clrelight.lighting.environment import read_environment

            environment, notes = read_environment(self.environments, layout=self.layout, axes=self.axes)
            report.note(*notes)
            found.append(environment)
        if self.sky or self.cap:
            lamp = Lamp(self.sky, self.sun, self.zenith, self.cap, None, self.colour, (), None, None)
            lamp.check()
            found.append(lambda degree: make_lamp(lamp, degree))
        return found + self._near()

    def _near(self) -> list[LightLike]:
        from clrelight.lighting.lamps import BLEND_POWER
        from clrelight.store import read_light
        from clrelight.transfer.local_light import LocalLights
        from clrelight.transfer.near_lights import PointLight, PolygonLight, SphereLight

        found: list[LightLike] = [PointLight(each[:3], each[3:] or (1.0,)) for each in self.point]
        found += [SphereLight(each[:3], each[3], each[4:] or (1.0,)) for each in self.sphere]
        for numbers, radiance in self.area:
            corners = [numbers[at : at + 3] for at in range(0, len(numbers), 3)]
            found.append(PolygonLight(corners, radiance, self.two_sided))
        if self.local:
            lights = [read_light(file) for file, _ in self.local]
            positions = [place for _, place in self.local]
            power = BLEND_POWER if self.power is None else self.power
            found.append(LocalLights(lights, positions, self.local_blend or "power", power))
        return found

    def _check(self) -> None:
        """Refuse options without what they are for, and numbers of a wrong count."""
        for option, value, source, wanted in (
            ("--sun", self.sun, self.sky, "--sky"),
            ("--zenith", self.zenith, self.sky, "--sky"),
            ("--colour", self.colour, self.sky or self.cap, "--sky and --cap"),
            ("--layout", self.layout, self.environments, "--env"),
            ("--two-sided", self.two_sided or None, self.area, "--area"),
            ("--local-blend", self.local_blend, self.local, "--local"),
            ("--power", self.power, self.local, "--local"),
        ):
            if value is not None and not source:
                raise InputError(f"{option} is for {wanted}")
        if self.sky and self.cap:
            raise InputError("give --sky or --cap, not both: a light file made by clrelight light can hold either")
        for option, given, counts, form in (
            ("--point", self.point, (3, 4, 6), "X,Y,Z and 1 or 3 numbers of intensity"),
            ("--sphere", self.sphere, (4, 5, 7), "X,Y,Z,RADIUS and 1 or 3 numbers of radiance"),
        ):
            for each in given:
                if len(each) not in counts:
                    raise InputError(f"{option} takes {form}, got {', '.join(f'{v:g}' for v in each)}")


_DISTANT = (
    click.option(
        "--light",
        type=LightOrDirection(),
        multiple=True,
        help="Direction to a lamp, or a light file: light from everywhere. All lights shine together.",
    ),
    click.option(
        "--env",
        "environments",
        type=click.Path(),
        multiple=True,
        metavar="FILE",
        help="Environment map; six times for the faces of a cube.",
    ),
    click.option("--layout", metavar="LAYOUT", help="Of the map, as clrelight light takes it."),
    click.option("--axes", default="z-up", show_default=True, help="Of the map, as there."),
    click.option("--sky", metavar="NAME", help="CIE sky: overcast, clear, partly-cloudy, or 1 to 15; z is up."),
    click.option("--sun", type=Numbers(float, "30,45", 2), metavar="ELEV,AZ", help="Of the sky, degrees."),
    click.option("--zenith", type=float, metavar="KCD", help="Luminance of the sky's zenith; default 1."),
    click.option("--cap", type=Numbers(float, "0,0,1,30", 4), metavar="X,Y,Z,ANGLE", help="A round light, radiance 1."),
    click.option("--colour", type=Numbers(float, "1,0.9,0.7"), metavar="R,G,B", help="Of sky or cap."),
)
_NEAR = (
    click.option(
        "--point",
        type=Numbers(float, "2,0,3,10"),
        multiple=True,
        metavar="X,Y,Z[,I]",
        help="A lamp near the surface: irradiance I / r², I one number or three; default 1.",
    ),
    click.option(
        "--sphere",
        type=Numbers(float, "2,0,3,0.5,10"),
        multiple=True,
        metavar="X,Y,Z,R[,L]",
        help="A shining ball near the surface: centre, radius, radiance; default 1.",
    ),
    click.option(
        "--area",
        type=Polygon(),
        multiple=True,
        help="A shining flat polygon, counterclockwise seen from the side that shines; radiance default 1.",
    ),
    click.option("--two-sided", is_flag=True, help="Polygons shine to both sides."),
    click.option(
        "--local",
        type=Sample(),
        multiple=True,
        help="Light files sampled at positions, blended for each vertex.",
    ),
    click.option(
        "--local-blend",
        type=click.Choice(["power", "polyhedron"]),
        help="By 1 / distance^POWER (default), or barycentric in the nearest face of the samples' polyhedron.",
    ),
    click.option("--power", type=float, help="Of the distance from samples; default 10."),
)


def surface_light_options(command: Any) -> Any:
    """Add the options that `SurfaceLamps` holds, which the command gets as `lamps`."""
    command = gather(SurfaceLamps, "lamps")(command)
    for option in reversed(_DISTANT + _NEAR):
        command = option(command)
    return command


@dataclass(frozen=True)
class CameraWish:
    """From where it is seen; the fields are the options."""

    camera: Triple | None
    target: Triple | None
    from_direction: Triple | None
    up: Triple
    fov: float
    orthographic: bool

    def framing(self) -> Framing:
        """Return the camera that is wanted."""
        from clrelight.transfer.cameras import Framing

        return Framing(self.camera, self.target, self.from_direction, self.up, self.fov, self.orthographic)


def camera_options(command: Any) -> Any:
    """Add the options that `CameraWish` holds, which the command gets as `wish`."""
    command = gather(CameraWish, "wish")(command)
    for option in reversed(
        (
            click.option(
                "--camera",
                type=Numbers(float, "2,-4,2", 3),
                metavar="X,Y,Z",
                help="Where the eye is; default: where it sees the whole surface.",
            ),
            click.option(
                "--target",
                type=Numbers(float, "0,0,1", 3),
                metavar="X,Y,Z",
                help="What it looks at; default: the middle of the surface.",
            ),
            click.option(
                "--from",
                "from_direction",
                type=Numbers(float, "1,-2,1", 3),
                metavar="X,Y,Z",
                help="Instead: the direction it looks from, at a fitting distance; default 1,-2,1.",
            ),
            click.option(
                "--up",
                type=Numbers(float, "0,0,1", 3),
                default="0,0,1",
                show_default=True,
                metavar="X,Y,Z",
                help="Upwards.",
            ),
            click.option(
                "--fov", type=float, default=30.0, show_default=True, metavar="DEG", help="Lower to upper edge."
            ),
            click.option("--orthographic", is_flag=True, help="Without perspective."),
        )
    ):
        command = option(command)
    return command
