"""``clrelight shrm bench``: the tables of costs and errors of reflection maps."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.maps import MapReading, map_options
from clrelight.cli.options import device_option, json_option
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table

if TYPE_CHECKING:
    from clrelight.device import Device
    from clrelight.lighting.environment import Environment
    from clrelight.lighting.light import Light

_DEGREE = 63
"""Of the light that tables are made under: what 128 × 128 texels hold."""


@click.command()
@click.argument("sources", metavar="FILE...", type=click.Path(), nargs=-1, required=True)
@map_options
@click.option(
    "--table",
    type=click.Choice(["costs", "phong", "microfacets", "peers", "codecs", "rates"]),
    default="phong",
    show_default=True,
    help="Growth of costs (the paper's table 3), Phong lobes by angles and by orders (4), microfacets (5), errors of "
    "orders and of earlier methods (figures 7, 9, 10), codecs on a map of microfacets, or rates of dynamic maps and of "
    "prefiltering.",
)
@click.option(
    "--brdf",
    "names",
    multiple=True,
    metavar="NAME[:NUMBER]|FILE",
    help="Of the table peers, several times; default: microfacet, skin and kajiya-kay.",
)
@device_option
@json_option
def bench(
    sources: tuple[str, ...],
    reading: MapReading,
    table: str,
    names: tuple[str, ...],
    device: str | None,
    as_json: bool,
) -> None:
    """Measure what reflection maps cost, and how near they come, beside integration over angles.

    \b
    Example:
      clrelight shrm bench grace.hdr --table phong
      clrelight shrm bench grace.hdr --table peers --brdf phong:32 --brdf krylon_blue.brdf
    """
    from clrelight.device import open_device
    from clrelight.jobs.reflection.bench import check_lit
    from clrelight.lighting.projection import project_environment

    report = make_report(as_json)
    with progress_bar("measuring"):
        environment, opened = reading.read(sources, report), open_device(device)
        report.device = opened.info.label
        since = time.perf_counter()
        light = project_environment(environment, min(_DEGREE, environment.resolved_degree), device=opened)
        since = report.add("project", since)
        if table in ("phong", "peers", "codecs"):
            check_lit(light)
        headers, rows, facts = _measure(table, names, environment, light, opened)
        report.add("measure", since)
    report.facts = {"table": table, "rows": facts}
    print_report(report, as_json, {"table": table, "device": report.device})
    if not as_json:
        print_table(headers, rows)


def _measure(
    table: str, names: tuple[str, ...], environment: Environment, light: Light, device: Device
) -> tuple[list[str], list[list[str]], Any]:
    """Return the headers and rows of a table as text, and its numbers."""
    from clrelight.jobs.reflection import bench as measure

    if table == "costs":
        slopes = measure.cost_slopes()
        rows = [[name, f"{found['theory']:g}", f"{found['slope']:.2f}"] for name, found in slopes.items()]
        return ["cost of", "theory", "slope"], rows, slopes
    if table == "phong":
        lobes = measure.time_phong(light, device)
        columns = ["s", "degree", "angular", "frequency", "ratio", "apart"]
        return ["s", "F", "angles, s", "orders, s", "ratio", "apart"], _rows(lobes, columns), lobes
    if table == "microfacets":
        facets = measure.time_microfacets(light, device)
        columns = ["sigma", "degree", "order", "image", "images", "frequency", "shrm", "ratio"]
        headers = ["sigma", "F", "P", "one map by angles, s", "100 maps, s", "100 by orders, s", "SHRM, s", "ratio"]
        return headers, _rows(facets, columns), facets
    if table == "peers":
        return _peers(names, light)
    if table == "codecs":
        return _codecs(light, device)
    rates = {f"P = {order}": measure.frame_rates(order, device) for order in (2, 3, 5)}
    shares = measure.prefilter_shares(environment.radiance_hwc, device) if environment.layout == "latlong" else {}
    rows = [[f"maps of 64² × 6 a second, {name}", f"{each['device']:.0f}"] for name, each in rates.items()]
    rows += [[f"prefiltering: {name}, s", f"{value:.4f}"] for name, value in shares.items()]
    return ["", "measured"], rows, {"rates": rates, "prefilter": shares}


def _peers(names: tuple[str, ...], light: Light) -> tuple[list[str], list[list[str]], Any]:
    from clrelight.brdf.named import parse_brdf
    from clrelight.jobs.reflection.peers import compare_peers

    found = [compare_peers(light, parse_brdf(name)) for name in names or ("microfacet", "skin", "kajiya-kay")]
    orders = list(found[0]["orders"])
    rows = [
        [each["brdf"], *(f"{v:.4f}" for v in (*_errors(each, orders), each["texture"], each["icosahedron"]))]
        for each in found
    ]
    return ["RMS error", *(f"P = {p}" for p in orders), "3-D texture", "12 maps"], rows, found


def _codecs(light: Light, device: Device) -> tuple[list[str], list[list[str]], Any]:
    from clrelight.brdf.named import make_brdf
    from clrelight.jobs.reflection.build import build_reflection
    from clrelight.jobs.reflection.codecs import code_maps, principal_shares
    from clrelight.jobs.report import Report

    shrm = build_reflection(light, make_brdf("microfacet"), epsilon=0.03, device=device, report=Report())
    coded, shares = code_maps(shrm, device), principal_shares(shrm)
    rows = [[each["codec"], f"{each['bytes']}", f"{each['bits']:.3f}", f"{each['error']:.2e}"] for each in coded]
    rows += [
        [f"{n} principal axes", "", "", f"{(1 - share) ** 0.5:.2e}"] for n, share in enumerate(shares[:-1], start=1)
    ]
    return ["", "bytes", "bits a coefficient", "error"], rows, {"codecs": coded, "principal": shares}


def _errors(found: dict[str, Any], orders: list[int]) -> list[float]:
    return [found["orders"][p]["error"] for p in orders]


def _rows(found: list[dict[str, Any]], columns: list[str]) -> list[list[str]]:
    return [[f"{each[name]:.4g}" for name in columns] for each in found]
