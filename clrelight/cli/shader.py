"""``clrelight shader``: GLSL for renderers of users."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.options import json_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.sections import Whole
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.jobs.report import Report


@click.group(cls=Whole)
def shader() -> None:
    """Write GLSL of irradiance, or of radiance transfer, with a light's numbers in it.

    \b
    Example:
      clrelight shader irradiance grace.h5 --out irradiance.glsl
      clrelight shader transfer grace.h5 --map map.h5 --out transfer.glsl
    """


@shader.command()
@click.argument("light", type=click.Path())
@click.option("--out", type=click.Path(), required=True, metavar="FILE", help="Where to write the text.")
@json_option
def irradiance(light: str, out: str, as_json: bool) -> None:
    """Write the irradiance of a unit normal, as a matrix and as a polynomial of x, y, z."""
    from clrelight.store import read_light
    from clrelight.transfer.shaders import irradiance_shader

    report = make_report(as_json)
    claim_output(out, [light])
    since = time.perf_counter()
    held = read_light(light)
    if held.degree > 2:
        report.note(f"irradiance takes degrees 0 to 2 of the light, which has {held.degree}")
    _write(out, irradiance_shader(held), ["irradiance_matrix", "irradiance_polynomial"], report, since, as_json)


@shader.command()
@click.argument("light", type=click.Path())
@click.option("--out", type=click.Path(), required=True, metavar="FILE", help="Where to write the text.")
@click.option(
    "--map", "fitted", type=click.Path(), metavar="MAP", help="For its degree, its channels, and how it was made."
)
@click.option("--degree", type=whole_number(0, 100), help="Of transfer vectors; default: the map's, else the light's.")
@click.option("--channels", type=click.Choice(["1", "3"]), help="Of transfer vectors; default: the map's, else 1.")
@click.option(
    "--form",
    type=click.Choice(["attributes", "texture"]),
    default="attributes",
    show_default=True,
    help="Where transfer vectors come from: attributes of vertices, or layers of an array texture.",
)
@json_option
def transfer(
    light: str, out: str, fitted: str | None, degree: int | None, channels: str | None, form: str, as_json: bool
) -> None:
    """Write the sum of transfer vectors times the light, per vertex or from a texture."""
    from clrelight.jobs.inputs import Packed, lend_fitted
    from clrelight.store import read_light
    from clrelight.surface import surface_facts
    from clrelight.transfer.reflection import OPERATOR
    from clrelight.transfer.shaders import transfer_shader
    from clrelight.transfer.shading import is_hemispherical

    report = make_report(as_json)
    claim_output(out, [light, *([fitted] if fitted else [])])
    since = time.perf_counter()
    held = read_light(light)
    taken, colours, hemispherical = held.degree, 1, False
    if fitted is not None:
        with lend_fitted(fitted, report) as found:
            kept = found.record if isinstance(found, Packed) else found
            taken, facts = kept.degree, surface_facts(kept.surface, kept.config) or {}
            colours = found.encoded.shape[3] if isinstance(found, Packed) else found.image_shape[2]
            hemispherical = is_hemispherical(kept)
        if kept.method == OPERATOR or facts.get("argument") == "view":
            raise InputError("shaders take functions of the direction to the light: these are operators, or of the eye")
        if facts.get("frame") == "local":
            kind = "a fit in local frames" if hemispherical else "in local frames"
            report.note(f"the map is {kind}: turn the light into each; these numbers are for one frame")
    made = transfer_shader(
        held,
        taken if degree is None else degree,
        channels=colours if channels is None else int(channels),
        form=form,
        hemispherical=hemispherical,
    )
    names = ["transfer_radiance", "transfer_from_attributes"] if form == "attributes" else ["transfer_from_texture"]
    _write(out, made, [name for name in names if f" {name}(" in made], report, since, as_json)


def _write(out: str, text: str, names: list[str], report: Report, since: float, as_json: bool) -> None:
    from clrelight.durable import replacing

    with replacing(out) as part:
        part.write(text.encode())
    report.add("write", since)
    report.facts = {"file": out, "functions": names, "bytes": len(text.encode())}
    print_report(report, as_json, {"shader": out, "functions": ", ".join(names), "size": f"{len(text)} characters"})


COMMANDS = (shader,)
