"""``clrelight shrm``: reflection maps of environments."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.maps import MapReading, is_light_file, map_options, refuse_map_options
from clrelight.cli.options import device_option, json_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.reflection_bench import bench
from clrelight.cli.reflection_render import render
from clrelight.cli.reflection_turns import rotate
from clrelight.cli.sections import Whole
from clrelight.cli.tables import print_table
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.brdf.centred import CentredBrdf
    from clrelight.jobs.report import Report


@click.group(cls=Whole)
def shrm() -> None:
    """Make, show and plan reflection maps: what glossy surfaces reflect of an environment, for every view.

    \b
    Example:
      clrelight shrm build probe.hdr glossy.h5 --brdf microfacet:0.2
    """


def brdf_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--brdf``, ``--sigma`` and ``--exponent``."""
    for option in (
        click.option("--exponent", type=float, help="Of phong and kajiya-kay, in place of :NUMBER; default 32."),
        click.option("--sigma", type=float, help="Roughness of microfacet, in place of :NUMBER; default 0.2."),
        click.option(
            "--brdf",
            "name",
            default="microfacet",
            show_default=True,
            metavar="NAME[:NUMBER]|FILE",
            help="lambert, phong:32, microfacet:0.2, kajiya-kay:32 (fibres along meridians), skin, a measured file, or "
            "what brdf estimate wrote.",
        ),
    ):
        command = option(command)
    return command


def _make(name: str, sigma: float | None, exponent: float | None) -> CentredBrdf:
    from clrelight.brdf.named import parse_brdf

    return parse_brdf(name, sigma=sigma, exponent=exponent)


@shrm.command()
@click.argument("sources", metavar="FILE...", type=click.Path(), nargs=-1, required=True)
@click.argument("out", type=click.Path())
@brdf_options
@map_options
@click.option("--epsilon", type=float, help="Part of the reflectance's energy that may be left out; default 0.03.")
@click.option("--degree", type=whole_number(0, 100), metavar="F", help="Largest degree of the light, with --order.")
@click.option("--order", type=whole_number(0, 32), metavar="P", help="Largest order of the view, with --degree.")
@click.option("--rows", type=whole_number(1, 4096), help="Rows of the map; default: ten for each degree.")
@click.option(
    "--frame",
    type=click.Choice(["global", "local", "zonal"]),
    help="Views in the axes of the world, of each direction, or by their angle from it alone (q = 0); default: zonal "
    "for kajiya-kay, else global.",
)
@click.option(
    "--method",
    type=click.Choice(["device", "fft", "product"]),
    help="How columns become orders and orders columns: by kernels (device, the default but for zonal maps), by FFT on "
    "the host, or as a product there.",
)
@device_option
@json_option
def build(
    sources: tuple[str, ...],
    out: str,
    name: str,
    sigma: float | None,
    exponent: float | None,
    reading: MapReading,
    epsilon: float | None,
    degree: int | None,
    order: int | None,
    rows: int | None,
    frame: str | None,
    method: str | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Write the reflection map of an environment, or of a light file, and a reflectance.

    \b
    Example:
      clrelight shrm build probe.hdr --brdf microfacet:0.2 --epsilon 0.03 glossy.h5
      clrelight shrm build grace.h5 --brdf paint.brdf --degree 30 --order 5 paint.h5
    """
    from clrelight.jobs.reflection.build import build_reflection
    from clrelight.store import check_output, read_light

    made_of = _make(name, sigma, exponent)
    check_output(out, sources)
    report = make_report(as_json)
    source: Any
    asked: dict[str, Any] = {"epsilon": epsilon, "degree": degree, "order": order, "rows": rows, "frame": frame}
    with progress_bar("prefiltering"):
        if len(sources) == 1 and is_light_file(sources[0]):
            refuse_map_options()
            source = read_light(sources[0])
        else:
            source = reading.read(sources, report)
        build_reflection(source, made_of, out, **asked, method=method, device=device, report=report)
    facts = report.facts
    lines = {
        "reflection map": out,
        "orders": f"F = {facts['degree']}, P = {facts['order']}, {facts['share']:.4f} of the reflectance's energy",
        "maps": f"{facts['maps']} of {facts['columns']}×{facts['rows']}, {facts['channels']} channel(s), "
        f"{facts['frame']}",
        "size": f"{facts['bytes']} bytes in memory",
    }
    print_report(report, as_json, lines)


@shrm.command()
@click.argument("sources", metavar="[FILE...]", type=click.Path(), nargs=-1)
@brdf_options
@map_options
@click.option("--epsilon", type=float, default=0.03, show_default=True, help="Energy that may be left out.")
@click.option("--chart", type=click.Path(), help="Draw accuracy over F here (figure 6); needs a map.")
@device_option
@json_option
def plan(
    sources: tuple[str, ...],
    name: str,
    sigma: float | None,
    exponent: float | None,
    reading: MapReading,
    epsilon: float,
    chart: str | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Say which orders and sizes a reflectance needs, and how good they are under a map.

    \b
    Example:
      clrelight shrm plan --brdf microfacet:0.1 --epsilon 0.03
      clrelight shrm plan grace.hdr --brdf phong:32 --chart accuracy.svg
    """
    from clrelight.jobs.reflection.plan import plan_reflection

    made_of = _make(name, sigma, exponent)
    if chart is not None:
        if not sources:
            raise InputError("--chart draws accuracy under a map: give one")
        claim_output(chart, sources)
    report = make_report(as_json)
    if not sources:
        refuse_map_options()
    with progress_bar("planning"):
        environment = reading.read(sources, report) if sources else None
        plan_reflection(made_of, environment, epsilon=epsilon, device=device, report=report)
    if chart is not None:
        from clrelight.report.reflection import write_accuracy

        write_accuracy(chart, report.facts["accuracy"], epsilon)
        report.facts["file"] = chart
    _print_plan(report, as_json)


def _print_plan(report: Report, as_json: bool) -> None:
    facts = report.facts
    lines = {
        "orders": f"F = {facts['degree']}, P = {facts['order']}: {facts['share']:.4f} of the energy, "
        f"{1 - facts['epsilon']:g} asked for",
        "samples": f"S = {facts['rows']}, T = {facts['views']} (ten for each)",
        "energy up to P": ", ".join(f"{row.min():.4f}" for row in facts["shares"]),
    }
    if "estimate" in facts:
        lines["estimate"] = f"F = sqrt(-s ln epsilon) = {facts['estimate']:.1f}, width {facts['width']:.4f}"
        lines["crossover"] = f"s* = S^(4/3) = {facts['crossover']:.0f}"
    if "bilinear" in facts:
        lines["bilinear error"] = ", ".join(f"{value:.4f} at {name}" for name, value in facts["bilinear"].items())
    print_report(report, as_json, lines)
    if "accuracy" in facts and not as_json:
        rows = [[str(row[0]), *(f"{value:.5f}" for value in row[1:])] for row in facts["accuracy"]]
        print_table(["F", "reflected", "light", "reflectance", "bound"], rows)


for command in (render, rotate, bench):
    shrm.add_command(command)
COMMANDS = (shrm,)
