"""``clrelight export`` and ``import``: textures for renderers, and files of other viewers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clrelight.cli.options import ByteCount, Numbers, device_option, given, json_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.errors import InputError

_ENDINGS = {"exr": "channels", "ptm": "ptm", "rti": "rti", "ktx2": "ktx2", "json": "json", "lp": "lp"}
_OPTIONS = {
    "planes": ("relight",),
    "colorspace": ("relight",),
    "tiles": ("relight",),
    "quality": ("relight", "deepzoom", "iiif", "ptm"),
    "light": ("deepzoom", "iiif"),
    "url": ("iiif", "relight"),
    "names": ("lp",),
    "memory": ("relight", "ptm", "rti", "channels", "channels-half", "ktx2", "deepzoom", "iiif"),
}
"""Formats that take each option."""


@click.command()
@click.argument("fitted", metavar="FIT_OR_ENC", type=click.Path())
@click.argument("out", metavar="FOLDER|FILE", type=click.Path())
@click.option(
    "--format",
    "file_format",
    type=click.Choice(
        "dds exr exr-half relight deepzoom iiif ptm rti ktx2 channels channels-half json lp".split()  # noqa: SIM905
    ),
    help="dds: BC6H blocks that GPUs sample (default); exr, exr-half: images of floats; relight: a folder that "
    "OpenLIME shows; deepzoom, iiif: one picture in tiles; channels: one EXR image of all coefficients; by their "
    "endings: .ptm, .rti for RTIViewer, .ktx2 (BC6H), .exr (channels), .json (of a light file), .lp (lights).",
)
@click.option("--planes", type=whole_number(3, 48), help="Planes of a relight folder, a multiple of 3; default 27.")
@click.option("--colorspace", type=click.Choice(["mrgb", "mycc"]), help="Of a relight folder's planes; default: mrgb.")
@click.option(
    "--tiles",
    type=click.Choice(["deepzoom", "google", "zoomify", "tarzoom", "itarzoom", "iiif"]),
    help="Cut the planes of a relight folder into tiles, in this layout.",
)
@click.option(
    "--quality",
    type=whole_number(1, 100),
    help="Of JPEGs; default: 100 of planes, 90 of pictures. A .ptm is compressed where it is given.",
)
@click.option(
    "--light", type=Numbers(float, "X,Y,Z", 3), help="Direction to the light of a picture; default: upper left."
)
@click.option("--url", metavar="URL", help="Where the folder will be found: IIIF images name their own address.")
@click.option("--names", metavar="PATTERN", help="Names of images in an .lp file; default: %03d.png.")
@click.option("--memory", type=ByteCount(), metavar="BYTES", help="Budget for decoded coefficients; default: 256MiB.")
@device_option
@json_option
def export(fitted: str, out: str, file_format: str | None, device: str | None, as_json: bool, **options: Any) -> None:
    """Write the coefficient maps as textures, or as files of other viewers.

    A new folder gets one texture for each coefficient; a name that ends in .dds becomes one texture array. Blocks of
    an encoding by bc6h are passed on as they are. docs/textures.md has the shader.

    \b
    Example:
      clrelight export fit.h5 textures
      clrelight export enc.h5 textures.dds
      clrelight export enc.h5 openlime --format relight --tiles deepzoom
      clrelight export enc.h5 coin.ptm
      clrelight export fit.h5 coin --format iiif --url https://example.org/coin --light -0.5,0.5,0.7
      clrelight export stack.h5 dome.lp
      clrelight export grace.h5 grace.json
    """
    from clrelight.jobs.export import export as run_export

    ending = Path(out).suffix.lower().removeprefix(".")
    chosen = file_format or _ENDINGS.get(ending, "dds")
    wanted = given(**options)
    for name in wanted:
        if chosen not in _OPTIONS[name]:
            raise InputError(f"--{name} is for --format {' or '.join(_OPTIONS[name])}, this is {chosen}")
    with progress_bar("exporting") as bar:
        told: dict[str, Any] = {"device": device, "progress": bar, "report": make_report(as_json)}
        if chosen not in ("dds", "exr", "exr-half"):
            _export_others(fitted, out, chosen, wanted, told, as_json)
            return
        report = run_export(fitted, out, chosen, **told)
    files = report.facts["files"]
    textures = files[0] + (f", ... ({len(files) - 1} files)" if len(files) > 2 else "")
    size = f"{report.facts['bytes']} bytes"
    print_report(report, as_json, {"textures": textures, "notes": files[-1], "size": size})


def _export_others(
    source: str, out: str, chosen: str, options: dict[str, Any], told: dict[str, Any], as_json: bool
) -> None:
    """Write what other programs show, and say so."""
    from clrelight.jobs.exchange import export_for_viewers
    from clrelight.jobs.light_lists import export_lights

    if chosen == "lp":
        report = export_lights(source, out, report=told["report"], **options)
        print_report(report, as_json, {"lights": f"{report.facts['lights']} in {out}"})
        return
    report = export_for_viewers(source, out, chosen, **options, **told)
    facts = report.facts
    lines = {chosen: out, "size": f"{facts['bytes']} bytes"}
    if "tiles" in facts:
        lines["tiles"] = str(facts["tiles"])
    if "refit" in facts:
        lines["refit"] = f"{facts['refit']:.2f} dB of the fit's display values"
    print_report(report, as_json, lines)


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
    from clrelight.jobs.archives import import_archive

    with progress_bar("importing") as bar:
        report = import_archive(archive, out, lights=lights, progress=bar, report=make_report(as_json))
    facts = report.facts
    print_report(report, as_json, {"stack": facts["file"], "shape": facts["shape"]})


COMMANDS = (export, import_command)
