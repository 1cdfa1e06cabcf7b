"""``clrelight pack``: photographs to one small file."""

from __future__ import annotations

from typing import Any

import click

from clrelight.cli.completion import known_methods
from clrelight.cli.engines import engine_options, is_shared, run_shared
from clrelight.cli.files import reading_options
from clrelight.cli.options import (
    ByteCount,
    DegreeType,
    basis_option,
    device_option,
    holdout_by_option,
    holdout_option,
    json_option,
    memory_option,
    perceptual_option,
    preview_option,
    salvage_option,
    within_option,
)
from clrelight.cli.output import make_report, preview_line, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.psnr import psnr_lines


@click.command()
@click.argument("photographs", metavar="FOLDER_OR_STACK", type=click.Path())
@click.argument("out", type=click.Path())
@reading_options
@click.option("--rate", type=float, help="Bits per coefficient, such as 0.1.")
@click.option(
    "--bytes",
    "byte_count",
    type=ByteCount(),
    metavar="BYTES",
    help="The file takes no more, such as 20M; default: a byte a pixel.",
)
@click.option("--target-psnr", type=float, metavar="DB", help="Fewest bytes for this pooled PSNR, held out if any are.")
@click.option(
    "--loss", type=float, metavar="DB", help="Fewest bytes that cost so many decibels in the mean over those lights."
)
@click.option(
    "--metric",
    type=click.Choice(["radiance", "perceptual"]),
    default="radiance",
    show_default=True,
    help="What errors cost: the same in every channel, or what they are in CIELAB.",
)
@click.option(
    "--method",
    shell_complete=known_methods,
    default="auto",
    show_default=True,
    help="auto, or a method of fit: spectrum, spline, cls, ...",
)
@click.option("--degree", type=DegreeType(), default="auto", show_default=True, help="Largest SH degree, or auto.")
@basis_option
@within_option
@holdout_option("the fit")
@holdout_by_option
@click.option(
    "--measure",
    type=click.Choice(["auto", "all", "sample", "none"]),
    default="auto",
    show_default=True,
    help="PSNR at all pixels, or at a sample with its standard error; auto: a sample from a megapixel on.",
)
@perceptual_option
@click.option(
    "--keep-stack",
    type=click.Path(),
    metavar="FILE",
    help="Keep the photographs there as a stack, which pack takes as well; default: gone when it ends.",
)
@preview_option
@memory_option("1GiB", "photographs being read and planes being coded")
@engine_options
@device_option
@json_option
def pack(
    photographs: str,
    out: str,
    byte_count: int | None,
    holdout_by: str | None,
    engine: str | None,
    jobs: int | None,
    device: str | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Turn photographs under known lights into one small file that can be relit.

    Reads the folder as ingest does, fits as fit does and codes as encode --codec klt does, but keeps no coefficients:
    those of a large image are made of the photographs whenever the coder asks for some.

    \b
    Example:
      clrelight pack photos/ view.h5 --lights photos/dome.lp --transfer srgb --holdout 5
      clrelight pack photos/ view.h5 --transfer srgb --bytes 20M
      clrelight pack stack.h5 view.h5 --target-psnr 38
      clrelight pack large.h5 view.h5 --engine dask --jobs 4
      clrelight relight view.h5 relit.png --light 0.3,0.1,2
    """
    from clrelight.jobs.pack import pack as run_pack

    report = make_report(as_json)
    with progress_bar("preparing") as bar:
        asked |= {"bytes": byte_count, "holdout_by": holdout_by or "index"}
        if is_shared(engine, jobs):
            run_shared("pack", photographs, out, asked, engine, jobs, device, bar, report)
        else:
            run_pack(photographs, out, device=device, progress=bar, report=report, **asked)
    facts = report.facts
    height, width, channel = facts["image_shape"]
    lines: dict[str, Any] = {
        "packed": out,
        **preview_line(facts),
        "images": f"{facts['n_light'] + facts['n_holdout']} of {width}×{height}, {channel} channel(s)",
        "fit": f"{facts['method']}, degree {facts['degree']}, {facts['n_light']} lights",
        **({"basis": facts["fit_config"]["basis"]} if "basis" in facts["fit_config"] else {}),
        "size": f"{facts['bytes_on_disk']} bytes on disk, {facts['bits_per_coefficient']:.4g} bit per coefficient",
        **psnr_lines(report.psnr),
    }
    if facts["peak_memory"]:
        held = facts.get("photographs_in_memory", 0) / 2**20
        beside = f", beside {held:.0f} MiB of photographs" if held >= 0.5 else ""
        lines["memory"] = f"{facts['peak_memory'] / 2**20:.0f} MiB at most{beside}"
    print_report(report, as_json, lines)


@click.command()
@click.argument("packed", metavar="PACKED", type=click.Path())
@click.argument("out", metavar="FOLDER", type=click.Path())
@click.option("--lights", type=click.Path(), metavar="FILE", help="Directions; default: those that were fitted.")
@click.option(
    "--format",
    "kind",
    type=click.Choice(["jpg", "png", "tif", "exr", "hdr"]),
    default="jpg",
    show_default=True,
    help="8-bit images, or linear radiance in floats.",
)
@click.option("--transfer", type=click.Choice(["linear", "srgb"]), help="Curve of 8-bit files; default: the stack's.")
@salvage_option
@memory_option("1GiB", "images and planes")
@engine_options
@device_option
@json_option
def unpack(
    packed: str, out: str, engine: str | None, jobs: int | None, device: str | None, as_json: bool, **asked: Any
) -> None:
    """Write the photographs of a packed view, under the lights it was made of or any others.

    The folder gets a lights.lp beside them, so that it can be packed or ingested again.

    \b
    Example:
      clrelight unpack view.h5 photos_again/
      clrelight unpack view.h5 dome/ --lights dome.lp --format exr
      clrelight unpack large.h5 photos_again/ --jobs 2
    """
    from clrelight.jobs.unpack import unpack as run_unpack

    report = make_report(as_json)
    with progress_bar("preparing") as bar:
        if is_shared(engine, jobs):
            run_shared("unpack", packed, out, asked, engine, jobs, device, bar, report)
        else:
            run_unpack(packed, out, device=device, progress=bar, report=report, **asked)
    print_report(report, as_json, {"folder": out, "images": len(report.facts["files"]) - 1})


COMMANDS = (pack, unpack)
