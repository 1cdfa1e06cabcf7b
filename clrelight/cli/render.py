"""``clrelight render``: pictures of surfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.lamps import ROTATION_HELP, Rotation, Turn
from clrelight.cli.options import Exposure, Numbers, device_option, json_option, memory_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.surface_lights import CameraWish, SurfaceLamps, camera_options, surface_light_options

if TYPE_CHECKING:
    from clrelight.jobs.report import Report


class Ground(click.ParamType):
    """A name of a background, or numbers."""

    name = "black|transparent|environment|R,G,B"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the name, or the numbers as a tuple."""
        if isinstance(value, tuple) or value in ("black", "transparent", "environment"):
            return value
        return Numbers(float, "black, transparent, environment, or 0.2,0.3,0.4").convert(value, param, ctx)


@click.command()
@click.argument("fitted", metavar="MAP", type=click.Path())
@click.argument("image", type=click.Path())
@click.option(
    "--mesh",
    type=click.Path(),
    help="The surface, where MAP holds none: mesh file, fit or stack; or what wears MAP as a texture.",
)
@click.option("--mesh-up", type=click.Choice(["y", "z"]), help="Of the mesh file, as transfer was told by --up.")
@surface_light_options
@camera_options
@click.option(
    "--size", type=Numbers(int, "640,480"), default="512", show_default=True, metavar="W[,H]", help="In pixels."
)
@click.option(
    "--subsamples", type=whole_number(1, 16), default=3, show_default=True, help="Rays of a pixel are its square."
)
@click.option(
    "--shading",
    type=click.Choice(["vertex", "pixel"]),
    default="vertex",
    show_default=True,
    help="Radiance of vertices, interpolated; or functions at each pixel, a parameter grid as a texture.",
)
@click.option(
    "--background",
    type=Ground(),
    default="black",
    show_default=True,
    help="Name, or radiance.",
)
@click.option("--exposure", type=Exposure(), default=0.0, show_default=True, help="Stops, or auto.")
@click.option("--rotate", type=Turn(), help=f"Turn distant light: {ROTATION_HELP}")
@click.option("--turntable", type=whole_number(1, 1 << 16), metavar="N", help="N images of one time round.")
@click.option(
    "--turns", type=click.Choice(["view", "light"]), default="view", show_default=True, help="What goes round."
)
@click.option("--about", type=Numbers(float, "0,1,0", 3), metavar="X,Y,Z", help="Axis of it; default: 0,0,1.")
@click.option("--tonemap", type=click.Choice(["clip", "reinhard"]), help="8-bit images; default: clip.")
@click.option(
    "--transfer",
    type=click.Choice(["linear", "srgb"]),
    default="srgb",
    show_default=True,
    help="Curve of 8-bit images.",
)
@click.option("--degree", type=whole_number(0, 100), help="Leave out coefficients above it.")
@click.option("--recolour", type=Numbers(float, "0.8,0.5,0.3", 3), metavar="R,G,B", help="Of a map of one channel.")
@memory_option("256MiB", "rays and functions of a band of the picture")
@device_option
@json_option
def render(
    fitted: str,
    image: str,
    mesh: str | None,
    mesh_up: str | None,
    lamps: SurfaceLamps,
    wish: CameraWish,
    size: tuple[int, ...],
    subsamples: int,
    shading: str,
    background: Any,
    exposure: float | None,
    rotate: Rotation | None,
    turntable: int | None,
    turns: str,
    about: tuple[float, float, float] | None,
    tonemap: str | None,
    transfer: str,
    degree: int | None,
    recolour: tuple[float, float, float] | None,
    memory: int,
    device: str | None,
    as_json: bool,
) -> None:
    """Write a picture of a surface whose vertices carry functions, under any light.

    All lights that are given shine together. The name decides the format, as of relight.

    \b
    Example:
      clrelight render map.h5 day.png --sky clear --sun 35,120 --exposure auto
      clrelight render map.h5 hall.png --env grace_probe.hdr --background environment --tonemap reinhard
      clrelight render map.h5 lamp.png --point 60,90,80,20000 --shading pixel --camera 200,250,90
      clrelight render coded.h5 round.gif --mesh armadillo.ply --light 0.3,0.2,1 --turntable 36
    """
    from clrelight.jobs.surface.render import render as run_render

    report = make_report(as_json)
    with progress_bar("rendering") as bar:
        run_render(
            fitted,
            lamps.lights(report) or None,
            out=image,
            mesh=mesh,
            mesh_up=mesh_up,
            camera=wish.framing(),
            size=size,
            subsamples=subsamples,
            shading=shading,
            background=background,
            exposure="auto" if exposure is None else exposure,
            rotate=rotate,
            turntable=turntable,
            turns=turns,
            about=about,
            tonemap=tonemap,
            transfer=transfer,
            degree=degree,
            recolour=recolour,
            memory=memory,
            device=device,
            progress=bar,
            report=report,
        )
    _print(report, as_json)


def _print(report: Report, as_json: bool) -> None:
    told = report.facts
    files = told["files"]
    facts = {"image": ", ".join(files[:3]) + (" ..." if len(files) > 3 else "")}
    facts["surface"] = (
        f"{report.facts['vertices']} vertices, {report.facts['faces']} faces, degree {report.facts['degree']}"
    )
    facts["camera"] = "at " + ", ".join(f"{v:.4g}" for v in report.facts["camera"]["eye"])
    facts["exposure"] = f"{report.facts['exposure']:+.2f} stops"
    print_report(report, as_json, facts)


COMMANDS = (render,)
