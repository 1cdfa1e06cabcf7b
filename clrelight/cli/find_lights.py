"""``clrelight find-lights``."""

from __future__ import annotations

from statistics import median
from typing import Any

import click

from clrelight.cli.options import Numbers, json_option, memory_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table


@click.command(name="find-lights")
@click.argument("source", metavar="FOLDER|STACK", type=click.Path())
@click.argument("out", metavar="OUT.lp", type=click.Path())
@click.option(
    "--by",
    type=click.Choice(["sphere", "object"]),
    default="sphere",
    show_default=True,
    help="One or more spheres in the photographs, or the shading of a matte object.",
)
@click.option(
    "--kind",
    type=click.Choice(["glossy", "matte"]),
    default="glossy",
    show_default=True,
    help="Of the spheres: by their highlights, or by their shading.",
)
@click.option(
    "--sphere",
    "spheres",
    type=Numbers(float, "X,Y,RADIUS", 3),
    multiple=True,
    help="Where a sphere is, in pixels from the upper left; several times for several. Default: it is looked for.",
)
@click.option("--count", type=whole_number(1, 16), default=1, show_default=True, help="Spheres to look for.")
@click.option("--focal", type=float, metavar="PIXELS", help="The camera's focal length; default: a camera far away.")
@click.option("--normals", type=click.Path(), metavar="IMAGE", help="Normals of the object (--by object).")
@click.option("--albedo", type=click.Path(), metavar="IMAGE", help="Albedo of the object; default: found too.")
@click.option("--mask", type=click.Path(), metavar="IMAGE", help="Where the object is; default: everywhere.")
@click.option(
    "--green",
    type=click.Choice(["up", "down"]),
    default="up",
    show_default=True,
    help="Which way the second channel of the picture of normals grows.",
)
@click.option(
    "--transfer",
    type=click.Choice(["linear", "srgb"]),
    default="linear",
    show_default=True,
    help="Curve of a folder's photographs.",
)
@click.option("--csv", type=click.Path(), metavar="FILE.csv", help="Also a table of all lights and how sure they are.")
@click.option("--picture", type=click.Path(), metavar="IMAGE", help="Also a picture of the spheres and highlights.")
@memory_option("1GiB", "samples that are held")
@json_option
def find_lights(source: str, out: str, as_json: bool, **asked: Any) -> None:
    """Find the lights of photographs that came without, and write them to an .lp file.

    By default a glossy sphere is looked for, and the highlight on it in each photograph. x is right, y up, z towards
    the camera.

    \b
    Example:
      clrelight find-lights photos/ lights.lp --transfer srgb --picture found.png
      clrelight find-lights photos/ lights.lp --sphere 1510,420,96
      clrelight find-lights photos/ lights.lp --by object --normals normals.exr
    """
    from clrelight.jobs.variation.find_lights import find_lights as run_find_lights

    report = make_report(as_json)
    asked["spheres"] = asked["spheres"] or None
    with progress_bar("reading") as bar:
        run_find_lights(source, out=out, progress=bar, report=report, **asked)
    facts = report.facts
    if not as_json:
        headers, rows = _table(facts["lights"], asked["by"], asked["kind"])
        print_table(headers, rows)
    spheres = [f"{x:.1f},{y:.1f},{radius:.1f}" for x, y, radius in facts["spheres"]]
    lines = {
        "lights": f"{', '.join(facts['files'])}, {facts['n_light']} of {facts['n_image']} photographs",
        **({"spheres": "  ".join(spheres)} if spheres else {}),
        **_outline_line(facts["outlines"]),
        **_uncertain_line(facts["lights"]),
        **_known_line(facts),
    }
    print_report(report, as_json, lines)


def _table(lights: list[dict[str, Any]], by: str, kind: str) -> tuple[list[str], list[list[str]]]:
    names = {"residual": "highlight spreads °" if by == "sphere" and kind == "glossy" else "residual"}
    names |= {"degrees_a_pixel": "° a pixel", "apart": "spheres apart °", "rival": "second highlight"}
    names |= {"uncertain": "uncertain °"}
    shown = ("confidence", "residual", "degrees_a_pixel", "uncertain", "rival", "apart", "intensity")
    columns = [c for c in shown if any(row.get(c) is not None for row in lights)]
    doubted = any(row.get("doubt") for row in lights)
    rows = []
    for row in lights:
        vector = ["–"] * 3 if row["direction"] is None else [f"{each:.4f}" for each in row["direction"]]
        angles = ["–" if row[c] is None else f"{row[c]:.1f}" for c in ("elevation", "azimuth")]
        others = ["–" if row[c] is None else f"{row[c]:.3f}" for c in columns]
        rows.append([row["image"], *vector, *angles, *others, *([row["doubt"] or ""] if doubted else [])])
    headers = ["image", "x", "y", "z", "elevation °", "azimuth °", *(names.get(c, c) for c in columns)]
    return [*headers, *(["doubt"] if doubted else [])], rows


def _outline_line(outlines: list[dict[str, float]]) -> dict[str, str]:
    if not outlines:
        return {}
    return {
        "outline": ", ".join(
            f"{each['seen']:.0%} seen, {each['off']:.2f} pixels off a circle" if each["seen"] else "not seen"
            for each in outlines
        )
    }


def _uncertain_line(lights: list[dict[str, Any]]) -> dict[str, str]:
    known = [row["uncertain"] for row in lights if row.get("uncertain") is not None]
    if not known:
        return {}
    return {"uncertain by": f"{median(known):.2f}° in the median, at most {max(known):.2f}° (one standard deviation)"}


def _known_line(facts: dict[str, Any]) -> dict[str, str]:
    if "off_known" not in facts:
        return {}
    off = facts["off_known"]
    return {"off the stack's own": f"{off['median']:.2f}° in the median, at most {off['most']:.2f}°"}


COMMANDS = (find_lights,)
