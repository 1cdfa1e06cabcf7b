"""``clrelight normals``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import Command, device_option, json_option, memory_option
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar

if TYPE_CHECKING:
    from clrelight.jobs.report import Report


class FieldType(click.ParamType):
    """Degrees, or auto."""

    name = "DEG|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | None:
        """Return the degrees, None for auto."""
        if value == "auto" or value is None:
            return None
        try:
            return float(value)
        except ValueError:
            self.fail(f"expected degrees such as 40, 0 or auto, got {value!r}", param, ctx)


_LIGHTS = (
    click.option(
        "--transfer",
        type=click.Choice(["stack", "auto", "linear", "srgb"]),
        default="stack",
        show_default=True,
        help="Curve of the codes: as the stack says, told from the samples, or this one.",
    ),
    click.option(
        "--field",
        type=FieldType(),
        default="auto",
        show_default=True,
        help="Degrees that the longer side of the images takes in the camera, 0 from afar; auto: told from gloss.",
    ),
    click.option(
        "--positions",
        type=click.Path(),
        metavar="FILE",
        help="Near lights: x y z of each from the middle of the image, in any unit, instead of directions.",
    ),
    click.option(
        "--pixel", type=float, metavar="SIZE", help="Width of a pixel on the object, in the unit of --positions."
    ),
    click.option(
        "--gains",
        metavar="estimate|FILE",
        help="Intensities of the lights that are still in the images: told from them, or a table.",
    ),
    click.option(
        "--lighting",
        type=click.Choice(["known", "unknown"]),
        default="known",
        show_default=True,
        help="unknown: directions are not looked at; each image may be under any distant light.",
    ),
    click.option(
        "--degree", type=click.IntRange(1, 2), help="Of unknown light: 1, four components (default), or 2, nine."
    ),
    click.option("--concave", is_flag=True, help="Of unknown light: the other one of the two possible surfaces."),
)


def light_options(command: Command) -> Command:
    """Add the options that say what is known of the lights."""
    for option in reversed(_LIGHTS):
        command = option(command)
    return command


@click.command()
@click.argument("stack", type=click.Path())
@click.argument("out", type=click.Path())
@click.option(
    "--method",
    type=click.Choice(["auto", "robust", "quick", "least-squares"]),
    default="auto",
    show_default=True,
    help="robust: gloss is found with each normal; quick: it is left out; least-squares: all samples as they are; "
    "auto: robust, or quick of large stacks.",
)
@click.option(
    "--green",
    type=click.Choice(["up", "down"]),
    default="up",
    show_default=True,
    help="Which way the second channel grows: up as in OpenGL, down as in DirectX.",
)
@click.option("--albedo", type=click.Path(), metavar="IMAGE", help="Also a picture of the matte albedo, linear.")
@click.option("--confidence", type=click.Path(), metavar="IMAGE", help="Also a picture of how far to trust, 0 to 1.")
@click.option("--height", type=click.Path(), metavar="FILE.exr", help="Also the height towards the camera, in pixels.")
@click.option("--ply", type=click.Path(), metavar="FILE.ply", help="Also the height as a mesh.")
@light_options
@memory_option("256MiB", "samples on their way")
@device_option
@json_option
def normals(stack: str, out: str, as_json: bool, **asked: Any) -> None:
    """Find the normals of a stack: floats to .exr or .tif, 16 bits to .png.

    The lights of the stack are distant, known and of one intensity, unless options say more. x is right, y up, z
    towards the camera.

    \b
    Example:
      clrelight normals stack.h5 normals.exr --albedo albedo.exr
      clrelight normals stack.h5 normals.png --green down --height height.exr --ply relief.ply
      clrelight normals stack.h5 normals.exr --positions lamps.csv --pixel 0.1 --gains estimate
      clrelight normals stack.h5 normals.exr --lighting unknown --degree 2
    """
    from clrelight.jobs.variation.normals import normals as run_normals

    report = make_report(as_json)
    with progress_bar("reading") as bar:
        run_normals(stack, out=out, progress=bar, report=report, **asked)
    print_report(report, as_json, _lines(report))


def _lines(report: Report) -> dict[str, str]:
    facts = report.facts
    lines = {
        "normals": ", ".join(facts["files"]),
        "method": f"{facts['method']}, {facts['n_light']} lights, condition {facts['condition']:.3g}",
        "pixels": f"{facts['pixels']}",
        "confidence": f"{facts['confidence_median']:.2f} in the median",
    }
    if "law" in facts:
        lines["law"] = facts["law"]
    if "curves" in facts:
        errors = ", ".join(f"{name} {error:.3f}" for name, error in facts["curves"].items())
        lines["transfer"] = f"{facts['transfer']} (errors of lights left out: {errors})"
    if "gains" in facts:
        gains = facts["gains"]
        lines["gains"] = f"{', '.join(f'{each:.3f}' for each in gains)} (each ± {facts['gains_spread']:.1%})"
    if "rounds" in facts:
        lines["rounds"] = f"{facts['rounds']} of normals and heights"
    if "degree" in facts:
        lines["light"] = (
            f"unknown, degree {facts['degree']}: its components hold {facts['energy']:.1%} of the energy; "
            f"law off by {facts['residual']:.2%}, surface told by {facts['gap']:.2g}"
        )
    lines["device"] = report.device or ""
    return lines


COMMANDS = (normals,)
