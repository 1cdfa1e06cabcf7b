"""``clrelight operators`` and ``clrelight reflect``."""

from __future__ import annotations

from typing import Any

import click

from clrelight.cli.options import Numbers, device_option, json_option, memory_option, order_option, whole_number
from clrelight.cli.output import print_report
from clrelight.cli.progress import progress_bar


@click.command()
@click.argument("mesh", type=click.Path())
@click.argument("out", type=click.Path())
@click.option(
    "--brdf",
    default="phong:20",
    show_default=True,
    metavar="NAME[:NUMBER]",
    help="diffuse, phong:EXPONENT, blinn:EXPONENT or ggx:ROUGHNESS.",
)
@click.option("--diffuse", type=Numbers(float, "0.5,0.4,0.3"), help="Reflectance of the matte part; 1 or 3 numbers.")
@click.option("--specular", type=Numbers(float, "0.04"), help="Strength of the glossy part; 1 or 3 numbers.")
@click.option(
    "--degree", type=whole_number(0, 25), default=4, show_default=True, help="Largest SH degree of the light."
)
@click.option("--view-degree", type=whole_number(0, 25), help="Of what is reflected; default: the light's.")
@click.option("--samples", type=whole_number(16), default=1024, show_default=True, help="Rays of each vertex.")
@click.option(
    "--extension",
    type=click.Choice(["smooth", "least-squares", "mirror", "zero"]),
    default="smooth",
    show_default=True,
    help="What becomes of views below a vertex's horizon.",
)
@click.option("--shadows/--no-shadows", "shadowed", default=True, help="Whether the mesh takes light from itself.")
@click.option(
    "--frame",
    type=click.Choice(["global", "local"]),
    default="global",
    show_default=True,
    help="Axes of views: the mesh's, or each vertex's own.",
)
@click.option(
    "--light-frame",
    type=click.Choice(["global", "local"]),
    default="global",
    show_default=True,
    help="Axes of the light; local, beside local views, makes operators alike: codecs take less.",
)
@order_option
@click.option("--add", type=click.Path(), metavar="TRANSFER", help="Diffuse transfer of the same vertices, added.")
@click.option("--colors", is_flag=True, help="Scale the matte part by the colours that the file has.")
@click.option("--up", type=click.Choice(["y", "z"]), help="Axis of the file that points up; default: z, of GLB y.")
@memory_option("256MiB", "a tile of vertices")
@json_option
def operators(mesh: str, out: str, as_json: bool, **asked: Any) -> None:
    """Make operators from light to reflected radiance of every vertex of a glossy mesh.

    \b
    Example:
      clrelight operators statue.ply glossy.h5 --brdf phong:20 --diffuse 0.3 --specular 0.6
      clrelight operators statue.ply metal.h5 --brdf ggx:0.4 --specular 0.9,0.7,0.4 --order hilbert
    """
    from clrelight.jobs.report import Report
    from clrelight.jobs.surface.operators import transfer_operators

    report = Report()
    with progress_bar("planning") as bar:
        transfer_operators(mesh, out=out, progress=bar, report=report, **asked)
    facts = report.facts
    config, shape = facts["config"], facts["shape"]
    lines = {
        "operators": out,
        "mesh": f"{facts['n_vertex']} vertices, {facts['n_face']} faces",
        "brdf": _brdf_line(config),
        "size": f"{(config['view_degree'] + 1) ** 2}×{(config['light_degree'] + 1) ** 2} a vertex, "
        f"{shape[-1]} channel(s), {facts['bytes_on_disk']} bytes",
        "rays": f"{facts['rays']:,}".replace(",", " "),
    }
    print_report(report, as_json, lines)


@click.command()
@click.argument("glossy", metavar="OPERATORS", type=click.Path())
@click.argument("out", type=click.Path())
@click.option("--light", required=True, type=click.Path(), metavar="LIGHT", help="A light file (clrelight light).")
@click.option(
    "--mesh", type=click.Path(), help="The surface of encoded operators: the file before encoding, or a mesh."
)
@device_option
@json_option
def reflect(glossy: str, out: str, light: str, mesh: str | None, device: str | None, as_json: bool) -> None:
    """Write what a glossy mesh reflects under a light, over directions to the eye.

    \b
    Example:
      clrelight reflect glossy.h5 seen.h5 --light grace.h5
    """
    from clrelight.jobs.report import Report
    from clrelight.jobs.surface.reflect import reflect as run_reflect

    report = Report()
    with progress_bar("reflecting") as bar:
        run_reflect(glossy, light, out=out, mesh=mesh, device=device, progress=bar, report=report)
    shape = report.facts["shape"]
    print_report(report, as_json, {"radiance": out, "size": f"degree {report.facts['degree']}, {shape[1]}×{shape[2]}"})


def _brdf_line(config: dict[str, Any]) -> str:
    number = next((f":{config[name]:g}" for name in ("exponent", "roughness") if name in config), "")
    parts = [
        f"{name} {','.join(f'{v:g}' for v in config[name])}" for name in ("diffuse", "specular") if any(config[name])
    ]
    return ", ".join([config["brdf"] + number, *parts])


COMMANDS = (operators, reflect)
