"""``clrelight variation``."""

from __future__ import annotations

from typing import Any

import click

from clrelight.cli.options import json_option, memory_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar

_green_option = click.option(
    "--green",
    type=click.Choice(["up", "down"]),
    default="up",
    show_default=True,
    help="Which way the second channel of the picture of normals grows.",
)


@click.group()
def variation() -> None:
    """How a view varies with light: its principal components, and the light behind a picture.

    \b
    Example:
      clrelight variation pca stack.h5
      clrelight variation inverse photo.exr normals.exr light.h5
    """


@variation.command()
@click.argument("source", metavar="STACK|MESH|NORMALS", type=click.Path())
@click.option("--centred/--raw", default=True, show_default=True, help="Whether the mean over all lights is taken off.")
@click.option("--degree", type=whole_number(0, 30), default=2, show_default=True, help="Of light (mesh, normals).")
@_green_option
@click.option("--up", type=click.Choice(["y", "z"]), help="Axis of a mesh's file that points up; default: z, of GLB y.")
@memory_option("256MiB", "samples of a stack on their way")
@json_option
def pca(source: str, as_json: bool, **asked: Any) -> None:
    """How much of all pictures of a view its principal components hold.

    Of a stack's photographs; or of a mesh (seen from +z) or a picture of normals, as a matte surface.

    \b
    Example:
      clrelight variation pca stack.h5
      clrelight variation pca normals.exr --raw
    """
    from clrelight.jobs.variation import principal_components

    report = make_report(as_json)
    with progress_bar("reading") as bar:
        principal_components(source, progress=bar, report=report, **asked)
    facts = report.facts
    counted = {"stack": "lights", "mesh": "vertices in view", "normals": "pixels"}[facts["kind"]]
    lines = {
        "components of": f"{source}, {facts['count']} {counted}",
        "mean": "taken off" if facts["centred"] else "kept",
        "each": ", ".join(f"{each:.4f}" for each in facts["variance"]),
        **{f"first {count}": f"{share:.4f}" for count, share in facts["cumulative"].items()},
    }
    print_report(report, as_json, lines)


@variation.command()
@click.argument("image", type=click.Path())
@click.argument("normals", type=click.Path())
@click.argument("out", metavar="LIGHT.h5", type=click.Path())
@click.option("--albedo", type=click.Path(), metavar="IMAGE", help="Albedo of the view; default: 1 everywhere.")
@click.option(
    "--degree", type=whole_number(0, 30), help="Of the light; default: 2, or below that what the normals tell."
)
@click.option("--ridge", type=float, default=0.0, show_default=True, help="Damps what the picture hardly tells.")
@_green_option
@json_option
def inverse(image: str, normals: str, out: str, as_json: bool, **asked: Any) -> None:
    """Find the light behind a linear picture of a matte view whose normals are known.

    \b
    Example:
      clrelight variation inverse photo.exr normals.exr light.h5 --albedo albedo.exr
    """
    from clrelight.jobs.variation import inverse_lighting

    report = make_report(as_json)
    with progress_bar("reading") as bar:
        inverse_lighting(image, normals, out=out, progress=bar, report=report, **asked)
    facts = report.facts
    lines = {
        "light": out,
        "degree": facts["degree"],
        "condition": ", ".join(f"{each:.3g}" for each in facts["condition"]) + " up to degree 0, 1, ...",
        "not explained": f"{facts['residual']:.2%} of the picture",
    }
    print_report(report, as_json, lines)


COMMANDS = (variation,)
