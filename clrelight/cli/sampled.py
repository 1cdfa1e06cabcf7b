"""``clrelight project`` and ``clrelight product``."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.maps import MapReading, map_options, refuse_map_options
from clrelight.cli.options import json_option, whole_number
from clrelight.cli.output import print_report
from clrelight.cli.progress import progress_bar
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.lighting.light import Light


@click.command()
@click.argument("out", type=click.Path())
@click.option(
    "--expr",
    "text",
    metavar="EXPRESSION",
    help="Radiance from a direction, of x, y, z, theta and phi: 'max(0, z)', 'theta < 30 * deg'; three, separated by "
    "';', are red, green and blue.",
)
@click.option(
    "--env", "environments", type=click.Path(), multiple=True, metavar="FILE", help="Environment map, or six of a cube."
)
@map_options
@click.option("--degree", type=whole_number(0, 100), default=6, show_default=True, help="Largest degree.")
@click.option(
    "--samples",
    type=whole_number(8),
    default=80_000,
    show_default=True,
    help="Directions in all, in 8 stratified sets.",
)
@click.option("--seed", type=whole_number(0), default=0, show_default=True, help="Of the random directions.")
@json_option
def project(
    out: str,
    text: str | None,
    environments: tuple[str, ...],
    reading: MapReading,
    degree: int,
    samples: int,
    seed: int,
    as_json: bool,
) -> None:
    """Make a light file by Monte Carlo integration, and tell its standard error.

    \b
    Example:
      clrelight project lobe.h5 --expr 'max(0, z) ** 20' --degree 8
      clrelight project stripes.h5 --expr 'where(sin(8 * phi) > 0, 1, 0.2); 0.5; z > 0'
      clrelight project sampled.h5 --env grace.hdr --samples 200000
    """
    from clrelight.jobs.report import Report
    from clrelight.lighting.expressions import parse_expression
    from clrelight.lighting.sampled import look_up, sample_light
    from clrelight.store import write_light

    if (text is None) == (not environments):
        raise InputError("give the light by one of --expr EXPRESSION, --env FILE")
    if not environments:
        refuse_map_options()
    claim_output(out, environments)
    report = Report()
    function: Any
    with progress_bar("sampling"):
        if text is not None:
            function, source, axes = parse_expression(text), text, ""
        else:
            environment = reading.read(environments, report)
            function, source, axes = look_up(environment), environment.source, environment.axes
        since = time.perf_counter()
        made, error_kc = sample_light(function, degree, samples, seed=seed, source=source, axes=axes)
        since = report.add("sample", since)
    write_light(out, made)
    report.add("write", since)
    worst, typical = float(error_kc.max()), float((error_kc**2).mean() ** 0.5)
    report.facts = {"file": out, **_facts(made), "error": error_kc, "largest_error": worst, "rms_error": typical}
    print_report(
        report,
        as_json,
        {
            **_lines(out, made),
            "samples": made.config["samples"],
            "standard error": f"{typical:.2g} of a coefficient, {worst:.2g} at most",
        },
    )


@click.command()
@click.argument("first", type=click.Path())
@click.argument("second", type=click.Path())
@click.argument("out", type=click.Path())
@click.option("--degree", type=whole_number(0, 100), help="Of the product; default: the larger of both.")
@json_option
def product(first: str, second: str, out: str, degree: int | None, as_json: bool) -> None:
    """Multiply two light files, such as light and what can be seen of it.

    Both are functions of the direction; the product is exact up to its degree.

    \b
    Example:
      clrelight product sky.h5 window.h5 seen.h5
      clrelight product grace.h5 mask.h5 masked.h5 --degree 12
    """
    from clrelight.jobs.report import Report
    from clrelight.lighting.sampled import multiply_lights
    from clrelight.store import read_light, write_light

    claim_output(out, [first, second])
    report = Report()
    since = time.perf_counter()
    made = multiply_lights(read_light(first), read_light(second), degree)
    since = report.add("multiply", since)
    write_light(out, made)
    report.add("write", since)
    report.facts = {"file": out, **_facts(made)}
    print_report(report, as_json, _lines(out, made))


def _facts(made: Light) -> dict[str, Any]:
    return {"degree": made.degree, "channels": made.channels, "source": made.source, "config": dict(made.config)}


def _lines(out: str, made: Light) -> dict[str, Any]:
    mean = float(made.coeffs_kc[0].mean()) * 0.28209479177387814
    return {"light": out, "degree": f"{made.degree}, {made.channels} channel(s)", "radiance": f"{mean:.4g} mean"}


COMMANDS = (project, product)
