"""``clrelight light``."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.lamps import ROTATION_HELP, Lamp, Rotation, Turn, lamp_options, make_lamp, note_horizon, rotate_by
from clrelight.cli.maps import MapReading, map_options, refuse_map_options
from clrelight.cli.options import Numbers, device_option, json_option, whole_number
from clrelight.cli.output import print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.jobs.report import Report
    from clrelight.lighting.environment import Environment
    from clrelight.lighting.light import Light
    from clrelight.lighting.projection import Lobes

# Two digits are l and m; more need a sign, a comma or a blank between the two: L110 could be 1,10 or 11,0.
_CHANGE = re.compile(r"L?(\d(?=\d\s*=)|\d{1,3}(?=[\s,+-]))\s*,?\s*([+-]?\d{1,3})\s*=(.+)")
_PRINTED_DEGREE = 2


class Change(click.ParamType):
    """A coefficient and its new value: L1-1=0.4 or L1-1=0.4,0.3,0.5."""

    name = "LM=VALUE"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[tuple[int, int], tuple[float, ...]]:
        """Return (l, m) and the numbers."""
        if isinstance(value, tuple):
            return value
        match = _CHANGE.fullmatch(str(value).strip())
        try:
            numbers = tuple(float(part) for part in match[3].split(",")) if match else ()
        except ValueError:
            numbers = ()
        if match is None or len(numbers) not in (1, 3) or not all(map(math.isfinite, numbers)):
            self.fail(
                f"expected a coefficient and 1 or 3 numbers, such as L20,10=1 or L1-1=0.4,0.3,0.5, got {value!r}",
                param,
                ctx,
            )
        return (int(match[1]), int(match[2])), numbers


class Window(click.ParamType):
    """A window, with its width in degrees behind a colon where it is not the default one."""

    name = "NAME[:WIDTH]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, float | None]:
        """Return the name and the width, None for the default."""
        if isinstance(value, tuple):
            return value
        name, colon, width = str(value).partition(":")
        try:
            return name, float(width) if colon else None
        except ValueError:
            self.fail(f"expected a window such as hann or hann:8, got {value!r}", param, ctx)


@click.command()
@click.argument("out", type=click.Path())
@click.option(
    "--env",
    "environments",
    type=click.Path(),
    multiple=True,
    metavar="FILE",
    help="Environment map; six times for the faces of a cube, +X -X +Y -Y +Z -Z.",
)
@click.option("--edit", type=click.Path(), metavar="LIGHT", help="Take the coefficients of a light file instead.")
@map_options
@lamp_options
@click.option("--degree", type=whole_number(0, 100), help="Largest degree; default 6, or that of --edit or --blend.")
@click.option(
    "--method",
    type=click.Choice(["auto", "direct", "separable", "separable-device"]),
    default="auto",
    show_default=True,
    help="How maps are projected: any layout on the device, or sums over azimuth and rows for latlong, in float64 or "
    "with azimuths on the device.",
)
@click.option("--rotate", type=Turn(), help=f"Turn the light: {ROTATION_HELP}")
@click.option(
    "--shadow",
    "shadows",
    type=Numbers(float, "0,0,1,20", 4),
    multiple=True,
    metavar="X,Y,Z,ANGLE",
    help="Take away what then comes from within ANGLE degrees of a direction.",
)
@click.option("--window", type=Window(), help="Against ringing: gaussian, hann or lanczos, such as hann or hann:8.")
@click.option("--scale", type=float, default=1.0, show_default=True, help="Factor on all values.")
@click.option("--set", "changes", type=Change(), multiple=True, help="Replace a coefficient, such as L1-1=0.4,0.3,0.5.")
@click.option("--print", "shown", is_flag=True, help="Print the nine coefficients up to degree 2.")
@device_option
@json_option
def light(
    out: str,
    environments: tuple[str, ...],
    edit: str | None,
    reading: MapReading,
    lamp: Lamp,
    degree: int | None,
    method: str,
    rotate: Rotation | None,
    shadows: tuple[tuple[float, float, float, float], ...],
    window: tuple[str, float | None] | None,
    scale: float,
    changes: tuple[tuple[tuple[int, int], tuple[float, ...]], ...],
    shown: bool,
    device: str | None,
    as_json: bool,
) -> None:
    """Make a light file: the spherical-harmonic coefficients of light from everywhere.

    \b
    Example:
      clrelight light grace.h5 --env grace_probe.hdr --degree 6 --window hann
      clrelight light cube.h5 --env sky.dds --axes left,forward,up
      clrelight light edited.h5 --edit grace.h5 --set L1-1=-0.4 --print
      clrelight light sky.h5 --sky clear --sun 35,120 --zenith 4.5 --shadow 0,1,0.3,40
    """
    from clrelight.jobs.report import Report
    from clrelight.lighting.light import apply_window, set_coefficients
    from clrelight.lighting.projection import measure_lobes
    from clrelight.store import read_light, write_light

    sources = {"--env FILE": environments, "--edit LIGHT": edit, **lamp.sources}
    if sum(map(bool, sources.values())) != 1:
        raise InputError(f"give the light by one of {', '.join(sources)}")
    if not environments:
        refuse_map_options("method")
    if not abs(scale) < math.inf:
        raise InputError(f"--scale must be a finite number, got {scale}")
    lamp.check()
    claim_output(out, [*environments, *([edit] if edit else []), *(file for file, _ in lamp.blend)])
    report = Report()
    if environments:
        with progress_bar("projecting"):
            environment = reading.read(environments, report)
            made = _project(environment, 6 if degree is None else degree, method, device, report)
    else:
        since = time.perf_counter()
        made = _cut(read_light(edit) if edit else make_lamp(lamp, degree), degree)
        report.add("make", since)
    if rotate is not None:
        made = rotate_by(made, rotate)
    report.note(*note_horizon(lamp, rotate))
    made = _scale(_shade(made, shadows), scale)
    if window is not None:
        made = apply_window(made, *window)
    if changes:
        made = set_coefficients(made, dict(changes))
    since = time.perf_counter()
    lobes = measure_lobes(made)
    since = report.add("measure", since)
    if not all(map(math.isfinite, (lobes.minimum, lobes.maximum, lobes.mean))):
        raise InputError("the coefficients are finite, but summing them to radiance overflows: scale them down")
    write_light(out, made)
    report.add("write", since)
    _print(out, made, lobes, report, as_json)
    if shown and not as_json:
        print_coefficients(made)


def _shade(light: Light, shadows: Sequence[tuple[float, float, float, float]]) -> Light:
    from clrelight.lighting.lamps import cast_shadow

    for *direction, angle in shadows:
        light = cast_shadow(light, direction, angle)
    return light


def _scale(light: Light, factor: float) -> Light:
    from dataclasses import replace

    import numpy as np

    with np.errstate(over="ignore", invalid="ignore"):  # a light refuses what is not finite
        return replace(light, coeffs_kc=factor * light.coeffs_kc)


def _print(out: str, made: Light, lobes: Lobes, report: Report, as_json: bool) -> None:
    from clrelight.harmonics.index import coefficient_count

    first_kc = made.coeffs_kc[: coefficient_count(_PRINTED_DEGREE)]
    report.facts = {"file": out, "degree": made.degree, "channels": made.channels, "source": made.source}
    report.facts |= {"axes": made.axes, "config": dict(made.config), "coefficients": first_kc, "mean": lobes.mean}
    report.facts |= {"minimum": lobes.minimum, "maximum": lobes.maximum, "negative": lobes.share}
    lines = {"light": out, "degree": f"{made.degree}, {made.channels} channel(s)"}
    if made.axes:
        lines["axes"] = f"x, y, z are {made.axes.replace(',', ', ')}"
    lines["radiance"] = f"{lobes.mean:.4g} mean, {lobes.minimum:.4g} least, below 0 on {lobes.share:.1%} of the sphere"
    print_report(report, as_json, lines)


def print_coefficients(light: Light) -> None:
    """Print the coefficients up to degree 2 as a table."""
    names = [f"L{l}{m}" for l in range(min(light.degree, _PRINTED_DEGREE) + 1) for m in range(-l, l + 1)]
    headers = ["", *(("red", "green", "blue") if light.channels == 3 else ("value",))]
    rows = [[name, *(f"{v:.6g}" for v in values)] for name, values in zip(names, light.coeffs_kc, strict=False)]
    print_table(headers, rows)


def _project(environment: Environment, degree: int, method: str, device: str | None, report: Report) -> Light:
    """Return the light of a map; the report names the device it was projected on, none where the host did it."""
    from clrelight.device import open_device
    from clrelight.lighting.projection import project_environment

    since = time.perf_counter()
    opened = open_device(device) if device else None  # the separable transform needs none
    made = project_environment(environment, degree, method=method, device=opened)
    if degree > environment.resolved_degree:
        report.note(
            f"the map is fine enough for degree {environment.resolved_degree}; beyond it coefficients are aliased"
        )
    report.add("project", since)
    report.device = None if made.config["method"] == "separable" else (opened or open_device()).info.label
    return made


def _cut(light: Light, degree: int | None) -> Light:
    from dataclasses import replace

    from clrelight.harmonics.index import coefficient_count

    if degree is None:
        return light
    if degree > light.degree:
        raise InputError(f"the light has degree {light.degree}, it cannot be cut to {degree}")
    return replace(light, coeffs_kc=light.coeffs_kc[: coefficient_count(degree)].copy())


COMMANDS = (light,)
