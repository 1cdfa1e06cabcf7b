"""``clrelight export``: textures for renderers."""

from __future__ import annotations

import click

from clrelight.cli.options import device_option, json_option
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar


@click.command()
@click.argument("fitted", metavar="FIT_OR_ENC", type=click.Path())
@click.argument("out", metavar="FOLDER|OUT.dds", type=click.Path())
@click.option(
    "--format",
    "file_format",
    type=click.Choice(["dds", "exr", "exr-half"]),
    default="dds",
    show_default=True,
    help="BC6H blocks that GPUs sample, or images of 32-bit or 16-bit floats.",
)
@device_option
@json_option
def export(fitted: str, out: str, file_format: str, device: str | None, as_json: bool) -> None:
    """Write the coefficient maps as textures, with a JSON file that says what they mean.

    A new folder gets one texture for each coefficient; a name that ends in .dds becomes one texture array. Blocks of
    an encoding by bc6h are passed on as they are. docs/textures.md has the shader.

    \b
    Example:
      clrelight export fit.h5 textures
      clrelight export enc.h5 textures.dds
    """
    from clrelight.jobs.export import export as run_export

    with progress_bar("exporting") as bar:
        report = run_export(fitted, out, file_format, device=device, progress=bar, report=make_report(as_json))
    files = report.facts["files"]
    textures = files[0] + (f", ... ({len(files) - 1} files)" if len(files) > 2 else "")
    size = f"{report.facts['bytes']} bytes"
    print_report(report, as_json, {"textures": textures, "notes": files[-1], "size": size})


COMMANDS = (export,)
