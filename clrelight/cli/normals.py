"""``clrelight normals``."""

from __future__ import annotations

from typing import Any

import click

from clrelight.cli.options import device_option, json_option, memory_option
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar


@click.command()
@click.argument("stack", type=click.Path())
@click.argument("out", type=click.Path())
@click.option(
    "--method",
    type=click.Choice(["robust", "least-squares"]),
    default="robust",
    show_default=True,
    help="Without shadows and gloss, or all samples as they are.",
)
@click.option(
    "--green",
    type=click.Choice(["up", "down"]),
    default="up",
    show_default=True,
    help="Which way the second channel grows: up as in OpenGL, down as in DirectX.",
)
@click.option("--albedo", type=click.Path(), metavar="IMAGE", help="Also a picture of the albedo, linear.")
@click.option("--confidence", type=click.Path(), metavar="IMAGE", help="Also a picture of how far to trust, 0 to 1.")
@click.option("--height", type=click.Path(), metavar="FILE.exr", help="Also the height towards the camera, in pixels.")
@click.option("--ply", type=click.Path(), metavar="FILE.ply", help="Also the height as a mesh.")
@memory_option("256MiB", "samples on their way")
@device_option
@json_option
def normals(stack: str, out: str, as_json: bool, **asked: Any) -> None:
    """Find the normals of a stack: floats to .exr or .tif, 16 bits to .png.

    The lights of the stack are distant, known and of one intensity. x is right, y up, z towards the camera.

    \b
    Example:
      clrelight normals stack.h5 normals.exr --albedo albedo.exr
      clrelight normals stack.h5 normals.png --green down --height height.exr --ply relief.ply
    """
    from clrelight.jobs.normals import normals as run_normals

    report = make_report(as_json)
    with progress_bar("reading") as bar:
        run_normals(stack, out=out, progress=bar, report=report, **asked)
    facts = report.facts
    lines = {
        "normals": ", ".join(facts["files"]),
        "method": f"{facts['method']}, {facts['n_light']} lights, condition {facts['condition']:.3g}",
        "pixels": f"{facts['pixels']}",
        "confidence": f"{facts['confidence_median']:.2f} in the median",
        "device": report.device,
    }
    print_report(report, as_json, lines)


COMMANDS = (normals,)
