"""``clrelight brdf``: reflectances that were measured, or are found in pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.maps import MapReading, is_light_file, map_options, refuse_map_options
from clrelight.cli.options import Numbers, device_option, json_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.sections import Whole
from clrelight.cli.tables import print_table

if TYPE_CHECKING:
    from clrelight.jobs.report import Report


@click.group(cls=Whole)
def brdf() -> None:
    """Look at measured reflectances, and find those of pictures under known light.

    \b
    Example:
      clrelight brdf info krylon_blue.brdf
      clrelight brdf estimate ball.exr found.json --light probe.exr
      clrelight brdf recognise ball.exr --light probe.exr --material paint.brdf --material microfacet:0.2
    """


def picture_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say what pictures show, and under which light."""
    for option in (
        click.option(
            "--samples", type=whole_number(1), default=4000, show_default=True, help="Points of all pictures taken."
        ),
        click.option(
            "--order", type=whole_number(0, 32), default=3, show_default=True, metavar="P", help="Of the view."
        ),
        click.option(
            "--degree", type=whole_number(0, 100), default=10, show_default=True, metavar="F", help="Of the light."
        ),
        click.option(
            "--normals",
            type=click.Path(),
            metavar="IMAGE",
            help="Of what the pictures show, in the axes of the light; default: a sphere that fills the picture.",
        ),
        click.option(
            "--view",
            "views",
            type=Numbers(float, "0,-1,0.3", 3),
            multiple=True,
            help="Towards the camera, once for each picture; default: 0,-1,0.3, with --normals 0,0,1.",
        ),
        click.option(
            "--light", "lights", type=click.Path(), multiple=True, required=True, help="Environment map, or light file."
        ),
    ):
        command = option(command)
    return command


@brdf.command()
@click.argument("file", metavar="FILE|NAME[:NUMBER]", type=click.Path())
@json_option
def info(file: str, as_json: bool) -> None:
    """Say what a .brdf file, or one of estimate, holds, and how its energy falls to orders P of the view.

    Of a name, such as phong:32, the energy alone.

    \b
    Example:
      clrelight brdf info krylon_blue.brdf
      clrelight brdf info microfacet:0.2
    """
    from clrelight.jobs.reflection.plan import describe_brdf

    report = make_report(as_json)
    describe_brdf(file, report=report)
    facts = report.facts
    lines = {"file": file, **(_measured(facts) if "pairs" in facts else _coefficients(facts))}
    shares = ", ".join(f"{row.mean():.3f}" for row in facts["shares"])
    lines[f"energy up to P, F = {facts['degree']}"] = shares
    print_report(report, as_json, lines)


def _measured(facts: dict[str, Any]) -> dict[str, str]:
    waves = facts["wavelengths"]
    (first, last), (low, high) = facts["light_degrees"], facts["view_degrees"]
    return {
        "measured": f"{facts['pairs']} pairs of directions, light {first:.0f} to {last:.0f}°, "
        f"view {low:.0f} to {high:.0f}°",
        "wavelengths": f"{len(waves)}, {waves[0]:g} to {waves[-1]:g} nm",
        "values": f"{facts['least']:.4g} to {facts['largest']:.4g} 1/sr",
    }


def _coefficients(facts: dict[str, Any]) -> dict[str, str]:
    orders = f"F = {facts['degree']}, P = {facts['order']}, {facts['channels']} channel(s)"
    return {"coefficients": f"{orders}, angles from the {facts['centre']}"}


@brdf.command()
@click.argument("pictures", type=click.Path(), nargs=-1, required=True, metavar="PICTURE...")
@click.argument("out", type=click.Path(), metavar="OUT.json")
@picture_options
@click.option(
    "--centre",
    type=click.Choice(["reflection", "normal", "tangent"]),
    default="reflection",
    show_default=True,
    help="Where its angles are taken from: the mirrored view, the normal, or tangents along meridians.",
)
@click.option("--ridge", type=float, help="Damping; default: by generalised cross-validation.")
@click.option(
    "--prior",
    type=click.Choice(["typical", "none"]),
    default="typical",
    show_default=True,
    help="What pictures do not tell is as in lobes, facets, matte surfaces and skin, or 0.",
)
@map_options
@device_option
@json_option
def estimate(
    pictures: tuple[str, ...],
    out: str,
    lights: tuple[str, ...],
    views: tuple[tuple[float, ...], ...],
    normals: str | None,
    degree: int,
    order: int,
    samples: int,
    centre: str,
    ridge: float | None,
    prior: str,
    reading: MapReading,
    device: str | None,
    as_json: bool,
) -> None:
    """Find the reflectance that pictures of one material under known light show.

    Pictures are spheres as shrm render shows them, or any convex shape with its normals; pictures of integers have the
    curve of --transfer. OUT.json is taken wherever a reflectance is.

    \b
    Example:
      clrelight brdf estimate ball.exr found.json --light probe.exr --degree 10 --order 3
      clrelight brdf estimate a.exr b.exr found.json --light probe.exr --view 0,-1,0.3 --view 1,0,0
      clrelight shrm build other.exr glossy.h5 --brdf found.json
    """
    from clrelight.jobs.reflection.estimate import estimate_reflectance

    report = make_report(as_json)
    with progress_bar("estimating") as bar:
        estimate_reflectance(
            pictures,
            _light(lights, reading, report),
            out,
            views=views or None,
            normals=normals,
            degree=degree,
            order=order,
            centre=centre,
            ridge=ridge,
            prior=prior,
            transfer=reading.transfer,
            samples=samples,
            device=device,
            progress=bar,
            report=report,
        )
    facts = report.facts
    lines = {
        "reflectance": out,
        "points": f"{facts['points']} of {len(pictures)} picture(s)",
        "condition": ", ".join(f"{each:.3g}" for each in facts["condition"]) + " of degree 0, 1, ...",
        "error": ", ".join(f"{each:.2g}" for each in facts["error"]),
        "ridge": ", ".join(f"{each:.2g}" for each in facts["ridge"]),
        "not explained": f"{facts['residual']:.2%} of the pictures",
    }
    print_report(report, as_json, lines)


@brdf.command()
@click.argument("pictures", type=click.Path(), nargs=-1, required=True, metavar="PICTURE...")
@picture_options
@click.option(
    "--material",
    "materials",
    multiple=True,
    required=True,
    metavar="NAME[:NUMBER]|FILE",
    help="Several times: microfacet:0.2, phong:32, lambert, skin, a .brdf file, or what estimate wrote.",
)
@click.option("--components", type=whole_number(1), metavar="K", help="Principal components; default: all there are.")
@map_options
@device_option
@json_option
def recognise(
    pictures: tuple[str, ...],
    lights: tuple[str, ...],
    views: tuple[tuple[float, ...], ...],
    normals: str | None,
    degree: int,
    order: int,
    samples: int,
    materials: tuple[str, ...],
    components: int | None,
    reading: MapReading,
    device: str | None,
    as_json: bool,
) -> None:
    """Say which of some materials pictures under known light show, by principal components; exposure does not matter.

    \b
    Example:
      clrelight brdf recognise ball.exr --light probe.exr --material paint.brdf --material skin --material phong:32
    """
    from clrelight.jobs.reflection.estimate import recognise_material

    report = make_report(as_json)
    with progress_bar("recognising") as bar:
        recognise_material(
            pictures,
            _light(lights, reading, report),
            materials,
            views=views or None,
            normals=normals,
            degree=degree,
            order=order,
            components=components,
            transfer=reading.transfer,
            samples=samples,
            device=device,
            progress=bar,
            report=report,
        )
    facts = report.facts
    lines = {
        "material": facts["materials"][0],
        "components": f"{facts['components']}: " + ", ".join(f"{each:.3f}" for each in facts["shares"]),
        "not explained": f"{facts['unexplained']:.2%} of the pictures",
    }
    print_report(report, as_json, lines)
    if not as_json:
        found = zip(facts["materials"], facts["distances"], strict=True)
        print_table(["material", "distance"], [[name, f"{each:.4f}"] for name, each in found])


def _light(lights: tuple[str, ...], reading: MapReading, report: Report) -> Any:
    """Return a light file's path, or the environment in some files."""
    if len(lights) == 1 and is_light_file(lights[0]):
        refuse_map_options(but=("transfer",))
        return lights[0]
    return reading.read(lights, report)


COMMANDS = (brdf,)
