"""``clrelight light``: environment maps as spherical-harmonic coefficients."""

from __future__ import annotations

import math
import re
import time
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import device_option, json_option, whole_number
from clrelight.cli.output import print_facts, print_json, print_notes, seconds_line
from clrelight.cli.tables import print_table
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.lighting.light import Light

_CHANGE = re.compile(r"L?(\d{1,3})[, ]?([+-]?\d{1,3})=(.+)")
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
        match = _CHANGE.fullmatch(str(value).replace(" ", ""))
        try:
            numbers = tuple(float(part) for part in match[3].split(",")) if match else ()
        except ValueError:
            numbers = ()
        if match is None or len(numbers) not in (1, 3) or not all(map(math.isfinite, numbers)):
            self.fail(f"expected a coefficient and 1 or 3 numbers, such as L1-1=0.4,0.3,0.5, got {value!r}", param, ctx)
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
            "default: by the aspect.",
        ),
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
@click.option("--degree", type=whole_number(0, 100), help="Largest degree; default 6, or that of --edit.")
@click.option(
    "--method",
    type=click.Choice(["auto", "direct", "separable"]),
    default="auto",
    show_default=True,
    help="How maps are projected: any layout on the device, or FFT and Legendre sums for latlong.",
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
    degree: int | None,
    method: str,
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
    """
    from dataclasses import replace

    from clrelight.lighting.light import apply_window, set_coefficients
    from clrelight.lighting.projection import measure_lobes
    from clrelight.store import check_output, read_light, write_light

    sources = {"--env FILE": environments, "--edit LIGHT": edit}
    if sum(map(bool, sources.values())) != 1:
        raise InputError(f"give the light by one of {', '.join(sources)}")
    if not abs(scale) < math.inf:
        raise InputError(f"--scale must be a finite number, got {scale}")
    check_output(out, [*environments, *([edit] if edit else [])])
    seconds: dict[str, float] = {}
    notes: list[str] = []
    if edit is None:
        made = _project(
            environments, layout, axes, transfer, 6 if degree is None else degree, method, device, notes, seconds
        )
    else:
        made = _cut(read_light(edit), degree)
    made = replace(made, coeffs_kc=scale * made.coeffs_kc)
    if window is not None:
        made = apply_window(made, *window)
    if changes:
        made = set_coefficients(made, dict(changes))
    since = time.perf_counter()
    lobes = measure_lobes(made)
    seconds["measure"] = time.perf_counter() - since
    since = time.perf_counter()
    write_light(out, made)
    seconds["write"] = time.perf_counter() - since
    first_kc = made.coeffs_kc[: (_PRINTED_DEGREE + 1) ** 2]
    if as_json:
        facts = {"file": out, "degree": made.degree, "channels": made.channels, "source": made.source}
        facts.update({"axes": made.axes, "config": dict(made.config), "coefficients": first_kc, "mean": lobes.mean})
        print_json({**facts, "minimum": lobes.minimum, "negative": lobes.share, "notes": notes, "seconds": seconds})
        return
    print_notes(notes)
    facts = {"light": out, "degree": f"{made.degree}, {made.channels} channel(s)"}
    if made.axes:
        facts["axes"] = f"x, y, z are {made.axes.replace(',', ', ')}"
    facts["radiance"] = f"{lobes.mean:.4g} mean, {lobes.minimum:.4g} least, below 0 on {lobes.share:.1%} of the sphere"
    print_facts({**facts, "time": seconds_line(seconds)})
    if shown:
        print_coefficients(made)


def print_coefficients(light: Light) -> None:
    """Print the coefficients up to degree 2 as a table."""
    names = [f"L{l}{m}" for l in range(min(light.degree, _PRINTED_DEGREE) + 1) for m in range(-l, l + 1)]
    headers = ["", *(("red", "green", "blue") if light.channels == 3 else ("value",))]
    rows = [[name, *(f"{v:.6g}" for v in values)] for name, values in zip(names, light.coeffs_kc, strict=False)]
    print_table(headers, rows)


def _project(
    environments: tuple[str, ...],
    layout: str | None,
    axes: str,
    transfer: str,
    degree: int,
    method: str,
    device: str | None,
    notes: list[str],
    seconds: dict[str, float],
) -> Light:
    from clrelight.device import open_device
    from clrelight.lighting.environment import read_environment
    from clrelight.lighting.projection import project_environment

    since = time.perf_counter()
    environment, said = read_environment(environments, layout=layout, axes=axes, transfer=transfer)
    notes += said
    seconds["read"] = time.perf_counter() - since
    since = time.perf_counter()
    opened = open_device(device) if device else None  # the separable transform needs none
    made = project_environment(environment, degree, method=method, device=opened)
    if degree > environment.resolved_degree:
        notes.append(
            f"the map is fine enough for degree {environment.resolved_degree}; beyond it coefficients are aliased"
        )
    seconds["project"] = time.perf_counter() - since
    return made


def _cut(light: Light, degree: int | None) -> Light:
    from dataclasses import replace

    if degree is None:
        return light
    if degree > light.degree:
        raise InputError(f"the light has degree {light.degree}, it cannot be cut to {degree}")
    return replace(light, coeffs_kc=light.coeffs_kc[: (degree + 1) ** 2].copy())


COMMANDS = (light,)
