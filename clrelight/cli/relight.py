"""``clrelight relight``: images under any light."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clrelight.cli.engines import engine_options, is_shared, run_shared
from clrelight.cli.lamps import ROTATION_HELP, Rotation, Turn
from clrelight.cli.options import (
    Exposure,
    Numbers,
    device_option,
    json_option,
    level_option,
    region_option,
    salvage_option,
    whole_number,
)
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.errors import InputError


class LightOrDirection(Numbers):
    """Three numbers, or a light file: what is there, or is named as one."""

    def __init__(self) -> None:
        super().__init__(float, "X,Y,Z", 3)
        self.name = "X,Y,Z|LIGHT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the numbers as a tuple, or the path as it is."""
        if isinstance(value, str) and (value.lower().endswith((".h5", ".hdf5")) or Path(value).is_file()):
            return value
        return super().convert(value, param, ctx)


@click.command()
@click.argument("fitted", metavar="FIT_OR_ENC", type=click.Path())
@click.argument("image", type=click.Path())
@click.option(
    "--light",
    type=LightOrDirection(),
    multiple=True,
    help="Direction to the light; may be repeated. Or a light file: light from everywhere.",
)
@click.option("--lights", type=click.Path(), metavar="FILE", help="Directions from a file, as ingest reads them.")
@click.option(
    "--exposure",
    type=Exposure(),
    default=0.0,
    show_default=True,
    help="Stops: values are scaled by 2^exposure. auto (light files): so that hardly anything is clipped.",
)
@click.option("--rotate", type=Turn(), help=f"Turn a light file: {ROTATION_HELP}")
@click.option(
    "--turntable", type=whole_number(1, 1 << 16), metavar="N", help="N images, a light file going round once."
)
@click.option(
    "--about", type=Numbers(float, "0,1,0", 3), metavar="X,Y,Z", help="Axis of the turntable; default: 0,0,1."
)
@click.option("--tonemap", type=click.Choice(["clip", "reinhard"]), help="8-bit images of a light file; default: clip.")
@click.option("--transfer", type=click.Choice(["linear", "srgb"]), help="Curve of 8-bit files; default: the stack's.")
@region_option
@level_option
@salvage_option
@engine_options
@device_option
@json_option
def relight(
    fitted: str,
    image: str,
    light: tuple[tuple[float, float, float] | str, ...],
    lights: str | None,
    exposure: float | None,
    rotate: Rotation | None,
    turntable: int | None,
    about: tuple[float, float, float] | None,
    tonemap: str | None,
    transfer: str | None,
    region: tuple[int, int, int, int] | None,
    level: int,
    salvage: bool,
    engine: str | None,
    jobs: int | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Write the view under one light, under several, or under light from everywhere.

    The name decides the format: .exr, .hdr and .tif hold linear radiance as floats, .png, .jpg and others 8-bit
    display values. For several images, IMAGE holds a number field such as %03d; a turntable may be a .gif or .apng.

    \b
    Example:
      clrelight relight fit.h5 relit.png --light 0.5,0.2,0.8
      clrelight relight enc.h5 frame%03d.exr --lights turntable.lp
      clrelight relight enc.h5 detail.png --light 0,0,1 --region 1200,800,512,512
      clrelight relight https://host/enc.h5 small.png --light 0,0,1 --level 3
      clrelight relight fit.h5 grace.png --light grace.h5 --rotate 90 --exposure auto
      clrelight relight large.h5 frame%03d.exr --lights turntable.lp --jobs 2
    """
    from clrelight.jobs.relight import relight as run_relight

    under: str | list[Any] | None = list(light) or None
    if any(isinstance(each, str) for each in light):
        if len(light) > 1:
            raise InputError("a light file is light from everywhere: give one --light, and no --lights beside it")
        under = str(light[0])
    report = make_report(as_json)
    asked: dict[str, Any] = {
        "lights": lights,
        "exposure": "auto" if exposure is None else exposure,
        "rotate": rotate,
        "turntable": turntable,
        "about": about,
        "tonemap": tonemap,
        "transfer": transfer,
        "region": region,
        "salvage": salvage,
    }
    with progress_bar("relighting") as bar:
        if is_shared(engine, jobs):
            shared = {"light": under, **asked, "level": level or None}
            run_shared("relight", fitted, image, shared, engine, jobs, device, bar, report)
        else:
            run_relight(fitted, under, out=image, **asked, level=level, device=device, progress=bar, report=report)
    files = report.facts["files"]
    facts = {"image": ", ".join(files[:3]) + (" ..." if len(files) > 3 else "")}
    if "exposure" in report.facts:
        facts["exposure"] = f"{report.facts['exposure']:+.2f} stops"
    print_report(report, as_json, facts)


COMMANDS = (relight,)
