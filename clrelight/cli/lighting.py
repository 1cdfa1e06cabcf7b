"""``clrelight light`` and ``irradiance``."""

from __future__ import annotations

import math
import re
import time
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.lamps import ROTATION_HELP, Lamp, Rotation, Turn, lamp_options, make_lamp, note_horizon, rotate_by
from clrelight.cli.options import (
    Numbers,
    clip_negative_option,
    device_option,
    json_option,
    layer_option,
    whole_number,
)
from clrelight.cli.output import print_facts, print_json, print_notes, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.lighting.environment import Environment
    from clrelight.lighting.light import Light

# Two digits are l and m; more need a sign, a comma or a blank between the two: L110 could be 1,10 or 11,0.
_CHANGE = re.compile(r"L?(\d(?=\d\s*=)|\d{1,3}(?=[\s,+-]))\s*,?\s*([+-]?\d{1,3})\s*=(.+)")
_PRINTED_DEGREE = 2


class Exposure(click.ParamType):
    """Stops, or auto."""

    name = "STOPS|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | None:
        """Return the stops, None for auto."""
        from clrelight.jobs.written import count_stops

        try:
            return count_stops(value)
        except InputError as error:
            self.fail(str(error), param, ctx)


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


def environment_options(command: Any) -> Any:
    """Add the options that say how an environment map is to be read."""
    for option in (
        click.option(
            "--transfer",
            type=click.Choice(["srgb", "linear"]),
            default="srgb",
            show_default=True,
            help="Curve of maps of integers.",
        ),
        click.option(
            "--axes",
            default="z-up",
            show_default=True,
            help="Where x, y, z point in the map's view: z-up (right,forward,up), camera (right,up,back), probe "
            "(right,up,forward: published tables), or three such words; left, back, down flip.",
        ),
        click.option(
            "--layout",
            metavar="LAYOUT",
            help="latlong, angular, vertical-cross, horizontal-cross, vertical-strip, horizontal-strip or cube; "
            "default: by an EXR's envmap attribute, else the aspect.",
        ),
        layer_option,
        clip_negative_option,
    ):
        command = option(command)
    return command


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
@environment_options
@lamp_options
@click.option("--degree", type=whole_number(0, 100), help="Largest degree; default 6, or that of --edit or --blend.")
@click.option(
    "--method",
    type=click.Choice(["auto", "direct", "separable"]),
    default="auto",
    show_default=True,
    help="How maps are projected: any layout on the device, or FFT and Legendre sums for latlong.",
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
    layout: str | None,
    axes: str,
    transfer: str,
    layer: str | None,
    clip_negative: bool,
    sky: str | None,
    sun: tuple[float, float] | None,
    zenith: float | None,
    cap: tuple[float, float, float, float] | None,
    directional: tuple[float, float, float] | None,
    colour: tuple[float, ...] | None,
    blend: tuple[tuple[str, tuple[float, float, float]], ...],
    at: tuple[float, float, float] | None,
    power: float | None,
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
    from dataclasses import replace

    import numpy as np

    from clrelight.harmonics.index import coefficient_count
    from clrelight.lighting.environment import read_environment
    from clrelight.lighting.lamps import cast_shadow
    from clrelight.lighting.light import apply_window, set_coefficients
    from clrelight.lighting.projection import measure_lobes
    from clrelight.store import read_light, write_light

    lamp = Lamp(sky, sun, zenith, cap, directional, colour, blend, at, power)
    sources = {"--env FILE": environments, "--edit LIGHT": edit, **lamp.sources}
    if sum(map(bool, sources.values())) != 1:
        raise InputError(f"give the light by one of {', '.join(sources)}")
    _check_map_options(bool(environments))
    if not abs(scale) < math.inf:
        raise InputError(f"--scale must be a finite number, got {scale}")
    lamp.check()
    claim_output(out, [*environments, *([edit] if edit else []), *(file for file, _ in blend)])
    seconds: dict[str, float] = {}
    notes: list[str] = []
    computed_on: str | None = None
    if environments:
        since = time.perf_counter()
        environment, notes = read_environment(
            environments, layout=layout, axes=axes, transfer=transfer, layer=layer, clip_negative=clip_negative
        )
        seconds["read"] = time.perf_counter() - since
        made, computed_on = _project(environment, 6 if degree is None else degree, method, device, notes, seconds)
    else:
        since = time.perf_counter()
        made = _cut(read_light(edit) if edit else make_lamp(lamp, degree), degree)
        seconds["make"] = time.perf_counter() - since
    if rotate is not None:
        made = rotate_by(made, rotate)
    note_horizon(lamp, rotate, notes)
    for *direction, angle in shadows:
        made = cast_shadow(made, direction, angle)
    with np.errstate(over="ignore", invalid="ignore"):  # a light refuses what is not finite
        made = replace(made, coeffs_kc=scale * made.coeffs_kc)
    if window is not None:
        made = apply_window(made, *window)
    if changes:
        made = set_coefficients(made, dict(changes))
    since = time.perf_counter()
    lobes = measure_lobes(made)
    seconds["measure"] = time.perf_counter() - since
    if not all(map(math.isfinite, (lobes.minimum, lobes.maximum, lobes.mean))):
        raise InputError("the coefficients are finite, but summing them to radiance overflows: scale them down")
    since = time.perf_counter()
    write_light(out, made)
    seconds["write"] = time.perf_counter() - since
    first_kc = made.coeffs_kc[: coefficient_count(_PRINTED_DEGREE)]
    if as_json:
        facts = {"file": out, "degree": made.degree, "channels": made.channels, "source": made.source}
        facts.update({"axes": made.axes, "config": dict(made.config), "coefficients": first_kc, "mean": lobes.mean})
        facts.update({"minimum": lobes.minimum, "maximum": lobes.maximum, "negative": lobes.share})
        print_json({**facts, "notes": notes, "seconds": seconds, "device": computed_on})
        return
    print_notes(notes)
    facts = {"light": out, "degree": f"{made.degree}, {made.channels} channel(s)"}
    if made.axes:
        facts["axes"] = f"x, y, z are {made.axes.replace(',', ', ')}"
    facts["radiance"] = f"{lobes.mean:.4g} mean, {lobes.minimum:.4g} least, below 0 on {lobes.share:.1%} of the sphere"
    print_facts({**facts, "time": seconds_line(seconds)})
    if shown:
        print_coefficients(made)


def _check_map_options(with_map: bool) -> None:
    """Refuse options of maps where there is none: --axes would not turn a sky, for one."""
    context = click.get_current_context()
    for name in ("layout", "axes", "transfer", "method", "layer", "clip_negative"):
        if not with_map and context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
            raise InputError(f"--{name.replace('_', '-')} is for maps (--env); --rotate turns any light")


@click.command()
@click.argument("environments", metavar="FILE...", type=click.Path(), nargs=-1, required=True)
@click.argument("out", type=click.Path())
@environment_options
@click.option(
    "--method",
    type=click.Choice(["nine", "brute"]),
    default="nine",
    show_default=True,
    help="From nine coefficients, or by summing the whole map for every normal.",
)
@click.option("--size", type=whole_number(1, 4096), default=64, show_default=True, help="Rows of the irradiance map.")
@click.option(
    "--map",
    "shape",
    type=click.Choice(["latlong", "angular"]),
    default="latlong",
    show_default=True,
    help="Layout of the irradiance map.",
)
@device_option
@json_option
def irradiance(
    environments: tuple[str, ...],
    out: str,
    layout: str | None,
    axes: str,
    transfer: str,
    layer: str | None,
    clip_negative: bool,
    method: str,
    size: int,
    shape: str,
    device: str | None,
    as_json: bool,
) -> None:
    """Write the irradiance that matte surfaces receive, as a map over their normals.

    The map has the view of the environment's own and holds floats (.exr, .hdr, .tif). With --json, the matrix M of each
    channel for a shader is printed too: E(n) = (n, 1) M (n, 1).

    \b
    Example:
      clrelight irradiance grace_probe.hdr irradiance.exr
      clrelight irradiance grace_probe.hdr exact.exr --method brute --map angular --size 256
    """
    import numpy as np

    from clrelight.device import open_device
    from clrelight.images import write_image
    from clrelight.jobs.pictures import FLOAT_FORMATS, holds_floats
    from clrelight.lighting import layouts
    from clrelight.lighting.environment import read_environment
    from clrelight.lighting.irradiance import (
        compare_irradiance,
        evaluate_irradiance,
        integrate_irradiance,
        irradiance_matrix,
    )
    from clrelight.lighting.projection import project_environment

    if not holds_floats(out):
        raise InputError(f"irradiance is linear radiance: write it to {', '.join(FLOAT_FORMATS)}, got {out}")
    claim_output(out, environments)
    seconds: dict[str, float] = {}
    since = time.perf_counter()
    environment, notes = read_environment(
        environments, layout=layout, axes=axes, transfer=transfer, layer=layer, clip_negative=clip_negative
    )
    seconds["read"] = time.perf_counter() - since
    opened = open_device(device)
    since = time.perf_counter()
    light = project_environment(environment, _PRINTED_DEGREE, device=opened)
    seconds["project"] = time.perf_counter() - since
    width = 2 * size if shape == "latlong" else size
    view_n3, weights_n = layouts.texel_geometry(shape, size, width)
    normals_n3 = view_n3 @ layouts.parse_axes(axes)[1].T
    since = time.perf_counter()
    values_nc = evaluate_irradiance(light, normals_n3).astype(np.float32)
    seconds["nine"] = time.perf_counter() - since
    facts: dict[str, Any] = {"file": out, "method": method, "matrix": irradiance_matrix(light)}
    if method == "brute":
        since = time.perf_counter()
        with progress_bar("integrating") as bar:
            exact_nc = integrate_irradiance(environment, normals_n3, device=opened, progress=bar)
        seconds["brute"] = time.perf_counter() - since
        error = compare_irradiance(values_nc, exact_nc, weights_n, light)
        facts.update({"nine_error_mean": error.mean, "nine_error_maximum": error.maximum})
        values_nc = exact_nc
    values_nc = np.where(weights_n[:, None] > 0, values_nc, np.float32(0.0))  # corners of an angular map
    since = time.perf_counter()
    write_image(out, values_nc.reshape(size, width, light.channels))
    seconds["write"] = time.perf_counter() - since
    if as_json:
        facts.update({"coefficients": light.coeffs_kc, "notes": notes})
        print_json({**facts, "seconds": seconds, "device": opened.info.label})
        return
    print_notes(notes)
    lines = {"irradiance": out, "map": f"{shape}, {width}×{size}", "method": method}
    if method == "brute":
        mean, most = facts["nine_error_mean"], facts["nine_error_maximum"]
        lines["nine are off"] = f"{mean:.2%} of the light on average, {most:.2%} at most"
    print_facts({**lines, "time": seconds_line(seconds)})


def print_coefficients(light: Light) -> None:
    """Print the coefficients up to degree 2 as a table."""
    names = [f"L{l}{m}" for l in range(min(light.degree, _PRINTED_DEGREE) + 1) for m in range(-l, l + 1)]
    headers = ["", *(("red", "green", "blue") if light.channels == 3 else ("value",))]
    rows = [[name, *(f"{v:.6g}" for v in values)] for name, values in zip(names, light.coeffs_kc, strict=False)]
    print_table(headers, rows)


def _project(
    environment: Environment,
    degree: int,
    method: str,
    device: str | None,
    notes: list[str],
    seconds: dict[str, float],
) -> tuple[Light, str | None]:
    """Return the light of a map, and the device it was projected on, None where the host did it."""
    from clrelight.device import open_device
    from clrelight.lighting.projection import project_environment

    since = time.perf_counter()
    opened = open_device(device) if device else None  # the separable transform needs none
    made = project_environment(environment, degree, method=method, device=opened)
    if degree > environment.resolved_degree:
        notes.append(
            f"the map is fine enough for degree {environment.resolved_degree}; beyond it coefficients are aliased"
        )
    seconds["project"] = time.perf_counter() - since
    return made, (opened or open_device()).info.label if made.config["method"] == "direct" else None


def _cut(light: Light, degree: int | None) -> Light:
    from dataclasses import replace

    from clrelight.harmonics.index import coefficient_count

    if degree is None:
        return light
    if degree > light.degree:
        raise InputError(f"the light has degree {light.degree}, it cannot be cut to {degree}")
    return replace(light, coeffs_kc=light.coeffs_kc[: coefficient_count(degree)].copy())


COMMANDS = (light, irradiance)
