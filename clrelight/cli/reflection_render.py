"""``clrelight shrm render``: spheres and meshes under reflection maps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.lamps import ROTATION_HELP, Rotation, Turn
from clrelight.cli.maps import is_light_file
from clrelight.cli.options import Exposure, Numbers, is_given, json_option, memory_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.render import Ground
from clrelight.cli.surface_lights import CameraWish, Triple, camera_options
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.jobs.report import Report
    from clrelight.lighting.environment import Environment

_CAMERA = ("camera", "target", "from_direction", "up", "fov", "orthographic")
_OF_MESHES = (*_CAMERA, "mesh_up", "subsamples", "views", "memory")


@click.command()
@click.argument("source", metavar="SHRM", type=click.Path())
@click.argument("image", type=click.Path())
@click.option("--mesh", type=click.Path(), help="Mesh file, fit or stack that holds a surface; default: a sphere.")
@click.option("--mesh-up", type=click.Choice(["y", "z"]), help="Of the mesh file; default: z, of GLB y.")
@click.option("--view", type=Numbers(float, "0,-1,0.3", 3), help="Of a sphere: towards the camera; default 0,-1,0.3.")
@camera_options
@click.option(
    "--views",
    type=click.Choice(["distant", "pixel"]),
    default="distant",
    show_default=True,
    help="Of a mesh: one dynamic map for a distant view, or the coefficients at each pixel for its own.",
)
@click.option(
    "--size", type=Numbers(int, "640,480"), default="256", show_default=True, metavar="W[,H]", help="In pixels."
)
@click.option(
    "--subsamples", type=whole_number(1, 16), default=3, show_default=True, help="Rays of a pixel are its square."
)
@click.option("--background", type=Ground(), default="black", show_default=True, help="Name, or radiance.")
@click.option(
    "--env",
    "environments",
    type=click.Path(),
    multiple=True,
    metavar="FILE",
    help="What --background environment shows: the map that SHRM was built of, or a light file.",
)
@click.option("--layout", metavar="LAYOUT", help="Of the map, as build takes it.")
@click.option("--axes", default="z-up", show_default=True, help="Of the map, as there.")
@click.option("--rotate", type=Turn(), help=f"Turn the light: {ROTATION_HELP}")
@click.option("--turntable", type=whole_number(1, 1 << 16), metavar="N", help="N pictures of one time round.")
@click.option(
    "--turns", type=click.Choice(["light", "view"]), default="light", show_default=True, help="What goes round."
)
@click.option("--about", type=Numbers(float, "0,1,0", 3), metavar="X,Y,Z", help="Axis of it; default: 0,0,1.")
@click.option("--exposure", type=Exposure(), default="auto", show_default=True, help="Stops.")
@click.option("--tonemap", type=click.Choice(["clip", "reinhard"]), help="Of 8-bit pictures.")
@click.option(
    "--transfer",
    type=click.Choice(["linear", "srgb"]),
    default="srgb",
    show_default=True,
    help="Curve of 8-bit pictures.",
)
@memory_option("256MiB", "rays of a band of the picture of a mesh")
@json_option
def render(
    source: str,
    image: str,
    mesh: str | None,
    mesh_up: str | None,
    view: Triple | None,
    wish: CameraWish,
    views: str,
    size: tuple[int, ...],
    subsamples: int,
    background: Any,
    environments: tuple[str, ...],
    layout: str | None,
    axes: str,
    rotate: Rotation | None,
    turntable: int | None,
    turns: str,
    about: Triple | None,
    exposure: float | None,
    tonemap: str | None,
    transfer: str,
    memory: int,
    as_json: bool,
) -> None:
    """Show a sphere or a mesh under the light of a reflection map.

    The name decides the format, as of relight; a turntable may be a .gif or an .apng.

    \b
    Example:
      clrelight shrm render glossy.h5 sphere.png
      clrelight shrm render glossy.h5 bunny.png --mesh bunny.obj --mesh-up y --background environment --env probe.hdr
      clrelight shrm render glossy.h5 around.gif --mesh bunny.obj --mesh-up y --turntable 36 --size 320,240
    """
    from clrelight.jobs.reflection.render import render_reflection

    _check(mesh, environments)
    report = make_report(as_json)
    with progress_bar("rendering") as bar:
        render_reflection(
            source,
            image,
            mesh=mesh,
            mesh_up=mesh_up,
            camera=None if mesh is None else wish.framing(),
            view=view,
            views=views,
            size=size,
            subsamples=subsamples,
            background=background,
            environment=_environment(environments, layout, axes, report),
            rotate=rotate,
            turntable=turntable,
            turns=turns,
            about=about,
            exposure=exposure,
            tonemap=tonemap,
            transfer=transfer,
            memory=memory,
            progress=lambda done, total, what: bar(done, total or done),
            report=report,
        )
    _print(report, turntable is not None, as_json)


def _check(mesh: str | None, environments: tuple[str, ...]) -> None:
    context = click.get_current_context()
    if mesh is None:
        for name in _OF_MESHES:
            if is_given(context, name):
                option = "from" if name == "from_direction" else name.replace("_", "-")
                raise InputError(f"--{option} is for --mesh: a sphere is seen from afar, from --view")
    for name in ("layout", "axes"):
        if is_given(context, name) and not environments:
            raise InputError(f"--{name} is for --env")


def _environment(files: tuple[str, ...], layout: str | None, axes: str, report: Report) -> Environment | str | None:
    if not files:
        return None
    if len(files) == 1 and is_light_file(files[0]):
        if layout is not None or is_given(click.get_current_context(), "axes"):
            raise InputError("--layout and --axes are for maps, not for light files")
        return files[0]
    from clrelight.lighting.environment import read_environment

    environment, notes = read_environment(files, layout=layout, axes=axes)
    report.note(*notes)
    return environment


def _print(report: Report, several: bool, as_json: bool) -> None:
    from clrelight.jobs.reflection.render import PAPER_RATE

    facts = report.facts
    files = facts["files"]
    lines = {"picture": ", ".join(files[:3]) + (" ..." if len(files) > 3 else "")}
    if "vertices" in facts:
        lines["surface"] = f"{facts['vertices']} vertices, {facts['faces']} faces"
        lines["camera"] = "at " + ", ".join(f"{v:.4g}" for v in facts["camera"]["eye"])
    lines["exposure"] = f"{facts['exposure']:+.2f} stops"
    if several:  # of one picture, the time is that of beginning
        lines["rate"] = f"{facts['frames_a_second']:.1f} pictures a second"
    if several and "maps_a_second" in facts:
        lines["dynamic maps"] = (
            f"{facts['maps_a_second']:.0f} a second of 64²×6 texels, P = {facts['order']} (the paper: {PAPER_RATE:g})"
        )
    print_report(report, as_json, lines)
