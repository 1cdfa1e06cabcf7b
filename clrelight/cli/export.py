"""``clrelight export``: textures for renderers."""

from __future__ import annotations

import time

import click

from clrelight.cli.options import device_option, json_option
from clrelight.cli.output import print_facts, print_json, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.cli.quality import lend_coefficients


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
    from clrelight.codec import Encoded
    from clrelight.device import open_device
    from clrelight.export import check_export, export_textures
    from clrelight.store import file_schema, read_encoded

    check_export(out, file_format, [fitted])
    opened = open_device(device)
    seconds: dict[str, float] = {}
    blocks: Encoded | None = None
    if file_format == "dds" and file_schema(fitted).startswith("encoded/"):
        encoded = read_encoded(fitted)[0]
        blocks = encoded if encoded.codec == "bc6h" else None
    with lend_coefficients(fitted, opened, seconds) as coefficients, progress_bar("exporting") as bar:
        since = time.perf_counter()
        files = export_textures(coefficients, out, file_format, blocks=blocks, device=opened, progress=bar)
        seconds["export"] = time.perf_counter() - since
    if as_json:
        print_json(
            {"files": [str(file) for file in files], "format": file_format, "seconds": seconds}
            | {"bytes": sum(file.stat().st_size for file in files), "device": opened.info.label}
        )
        return
    print_facts(
        {
            "textures": str(files[0]) + (f", ... ({len(files) - 1} files)" if len(files) > 2 else ""),
            "notes": str(files[-1]),
            "size": f"{sum(file.stat().st_size for file in files)} bytes",
            "time": seconds_line(seconds),
        }
    )


COMMANDS = (export,)
