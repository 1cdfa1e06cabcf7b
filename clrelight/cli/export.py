"""``clrelight export`` and ``import``: textures for renderers, and files of other viewers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clrelight.cli.options import device_option, given, json_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.errors import InputError


@click.command()
@click.argument("fitted", metavar="FIT_OR_ENC", type=click.Path())
@click.argument("out", metavar="FOLDER|FILE", type=click.Path())
@click.option(
    "--format",
    "file_format",
    type=click.Choice(["dds", "exr", "exr-half", "relight", "ptm", "rti", "ktx2", "channels", "channels-half", "json"]),
    help="dds: BC6H blocks that GPUs sample (default); exr, exr-half: images of floats; relight: a folder that "
    "OpenLIME shows; channels: one EXR image of all coefficients; by their endings: .ptm, .rti for RTIViewer, .ktx2 "
    "(BC6H), .exr (channels), .json (of a light file).",
)
@click.option("--planes", type=whole_number(3, 48), help="Planes of a relight folder, a multiple of 3; default 27.")
@click.option("--quality", type=whole_number(1, 100), help="Of a relight folder's JPEGs; default 100.")
@device_option
@json_option
def export(
    fitted: str,
    out: str,
    file_format: str | None,
    planes: int | None,
    quality: int | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Write the coefficient maps as textures, or as files of other viewers.

    A new folder gets one texture for each coefficient; a name that ends in .dds becomes one texture array. Blocks of
    an encoding by bc6h are passed on as they are. docs/textures.md has the shader.

    \b
    Example:
      clrelight export fit.h5 textures
      clrelight export enc.h5 textures.dds
      clrelight export enc.h5 openlime --format relight
      clrelight export enc.h5 coin.ptm
      clrelight export grace.h5 grace.json
    """
    from clrelight.jobs.exchange import FORMATS, export_for_viewers
    from clrelight.jobs.export import export as run_export

    ending = Path(out).suffix.lower().removeprefix(".")
    chosen = file_format or {"exr": "channels"}.get(ending, ending if ending in FORMATS else "dds")
    options = given(planes=planes, quality=quality)
    if options and chosen != "relight":
        raise InputError(f"--{next(iter(options))} is for --format relight")
    with progress_bar("exporting") as bar:
        told: dict[str, Any] = {"device": device, "progress": bar, "report": make_report(as_json)}
        if chosen in FORMATS:
            report = export_for_viewers(fitted, out, chosen, **options, **told)
            lines = {chosen: out, "size": f"{report.facts['bytes']} bytes"}
            if "refit" in report.facts:
                lines["refit"] = f"{report.facts['refit']:.2f} dB of the fit's display values"
            print_report(report, as_json, lines)
            return
        report = run_export(fitted, out, chosen, **told)
    files = report.facts["files"]
    textures = files[0] + (f", ... ({len(files) - 1} files)" if len(files) > 2 else "")
    size = f"{report.facts['bytes']} bytes"
    print_report(report, as_json, {"textures": textures, "notes": files[-1], "size": size})


@click.command("import")
@click.argument("archive", metavar="FILE.ptm|.rti|FOLDER", type=click.Path())
@click.argument("out", type=click.Path())
@click.option("--lights", type=whole_number(4, 1000), default=64, show_default=True, help="About how many.")
@json_option
def import_command(archive: str, out: str, lights: int, as_json: bool) -> None:
    """Make a stack of what an old archive shows under lights all over the hemisphere: to fit, relight and code it.

    \b
    Example:
      clrelight import coin.ptm coin.h5
      clrelight import openlime/ coin.h5 --lights 100
    """
    from clrelight.jobs.exchange import import_archive

    with progress_bar("importing") as bar:
        report = import_archive(archive, out, lights=lights, progress=bar, report=make_report(as_json))
    facts = report.facts
    print_report(report, as_json, {"stack": facts["file"], "shape": facts["shape"]})


COMMANDS = (export, import_command)
