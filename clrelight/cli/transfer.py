"""``clrelight transfer``."""

from __future__ import annotations

from typing import Any

import click

from clrelight.cli.engines import engine_options, is_shared, run_shared
from clrelight.cli.options import Numbers, is_given, json_option, memory_option, order_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.errors import InputError


class Albedo(click.ParamType):
    """One number, three of them, or ``file``."""

    name = "R,G,B|file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the numbers, or ``"file"``."""
        if value == "file" or isinstance(value, tuple):
            return value
        try:
            numbers = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            numbers = ()
        if len(numbers) not in (1, 3):
            self.fail(f"expected a number, three separated by commas, or file, got {value!r}", param, ctx)
        return numbers


@click.command()
@click.argument("mesh", type=click.Path())
@click.argument("out", type=click.Path())
@click.option(
    "--type",
    "kind",
    type=click.Choice(["unshadowed", "shadowed", "interreflected"]),
    default="shadowed",
    show_default=True,
    help="What light reaches a vertex: all, what nothing blocks, and that with what other parts send on.",
)
@click.option("--degree", type=whole_number(0, 100), default=4, show_default=True, help="Largest SH degree.")
@click.option(
    "--samples",
    type=whole_number(1, 1 << 24),
    metavar="N",
    help="Stratified directions all around, a square; default: 1024, but unshadowed is exact without.",
)
@click.option("--lights", type=click.Path(), metavar="FILE", help="These directions instead: .lp, or a table N×3.")
@click.option(
    "--frame",
    type=click.Choice(["global", "local"]),
    default="global",
    show_default=True,
    help="Axes of the functions: the mesh's, or each vertex's own, z its normal.",
)
@click.option("--albedo", type=Albedo(), help="Reflectance from 0 to 1, or the file's colours; default: 1.")
@click.option(
    "--bounces", type=whole_number(0, 1000), default=3, show_default=True, help="At most, where light is gathered."
)
@click.option(
    "--gather/--shoot",
    "is_gathered",
    default=True,
    help="Each vertex gathers bounce after bounce, or those with the most light send it on first.",
)
@click.option("--threshold", type=float, help="Share of the direct light at which bounces end; shot: 0.001.")
@click.option("--up", type=click.Choice(["y", "z"]), help="Axis of the file that points up; default: z, of GLB y.")
@click.option(
    "--texels",
    type=Numbers(int, "ROWS,COLUMNS", 2),
    help="At the middles of so many texels of its texture, instead of at vertices.",
)
@order_option
@click.option("--seed", type=whole_number(0), default=0, show_default=True, help="Of the stratified directions.")
@memory_option("256MiB", "rays and what they meet")
@engine_options
@json_option
@click.pass_context
def transfer(
    context: click.Context,
    mesh: str,
    out: str,
    is_gathered: bool,
    kind: str,
    engine: str | None,
    jobs: int | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Make transfer functions of a mesh (.ply, .obj, .stl, .off, .glb).

    What each vertex sends on of the light from each direction, as SH coefficients: a fit whose rows are the vertices,
    which codecs take as any other.

    \b
    Example:
      clrelight transfer bunny.obj bunny.h5
      clrelight transfer bunny.obj bunny.h5 --type interreflected --bounces 3 --albedo 0.8,0.6,0.5
      clrelight transfer bunny.obj bunny.h5 --frame local --samples 4096 --degree 6
      clrelight transfer statue.ply statue.h5 --samples 4096 --jobs 2
    """
    from clrelight.jobs.surface.transfer import transfer as run_transfer

    if kind != "interreflected":
        for name in ("bounces", "is_gathered", "threshold"):
            if is_given(context, name):
                option = {"is_gathered": "--gather and --shoot"}.get(name, f"--{name}")
                raise InputError(f"{option}: for --type interreflected")
    report, way = make_report(as_json), "gather" if is_gathered else "shoot"
    with progress_bar("reading the mesh") as bar:
        if is_shared(engine, jobs):
            run_shared("transfer", mesh, out, {**asked, "kind": kind, "way": way}, engine, jobs, None, bar, report)
        else:
            run_transfer(mesh, out=out, kind=kind, way=way, progress=bar, report=report, **asked)
    facts = report.facts
    lines = {
        "transfer": out,
        "surface": f"{facts['vertices']} vertices, {facts['faces']} faces",
        "functions": f"{kind}, degree {facts['degree']}, in {facts['frame']} axes",
    }
    if facts["rays"]:
        lines["rays"] = f"{facts['rays']:,}, {facts['rays_per_second'] / 1e6:.2f} million a second"
    if kind == "interreflected" and is_gathered:
        lines["sent on"] = ", ".join(f"{each:.3g}" for each in facts["energy"]) + " by 0, 1, ... bounces"
    elif kind == "interreflected":
        first, last = facts["energy"]
        lines["left unshot"] = f"{last / max(first, 1e-300):.2g} of the direct light"
    lines["stored"] = f"{facts['bytes_on_disk']} bytes"
    print_report(report, as_json, lines)


COMMANDS = (transfer,)
