"""``clrelight variation``."""

from __future__ import annotations

from typing import Any

import click

from clrelight.cli.options import Names, device_option, json_option, memory_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.sections import Whole
from clrelight.cli.tables import print_table

_green_option = click.option(
    "--green",
    type=click.Choice(["up", "down"]),
    default="up",
    show_default=True,
    help="Which way the second channel of the picture of normals grows.",
)


@click.group(cls=Whole)
def variation() -> None:
    """How a view varies with light: its principal components, and the light behind a picture.

    \b
    Example:
      clrelight variation pca stack.h5
      clrelight variation inverse photo.exr normals.exr light.h5
      clrelight variation basis stack.h5 nine.h5
    """


@variation.command()
@click.argument("source", metavar="STACK|MESH|NORMALS", type=click.Path())
@click.option("--centred/--raw", default=True, show_default=True, help="Whether the mean over all lights is taken off.")
@click.option("--degree", type=whole_number(0, 30), default=2, show_default=True, help="Of light (mesh, normals).")
@_green_option
@click.option("--up", type=click.Choice(["y", "z"]), help="Axis of a mesh's file that points up; default: z, of GLB y.")
@click.option("--pictures", type=click.Path(), metavar="FOLDER", help="Also pictures of the components; grey is 0.")
@memory_option("256MiB", "samples of a stack on their way")
@json_option
def pca(source: str, as_json: bool, **asked: Any) -> None:
    """How much of all pictures of a view its principal components hold.

    Of a stack's photographs; or of a mesh (seen from +z) or a picture of normals, as a matte surface.

    \b
    Example:
      clrelight variation pca stack.h5
      clrelight variation pca normals.exr --raw --pictures components/
    """
    from clrelight.jobs.variation.components import principal_components

    report = make_report(as_json)
    with progress_bar("reading") as bar:
        principal_components(source, progress=bar, report=report, **asked)
    facts = report.facts
    counted = {"stack": "lights", "mesh": "vertices in view", "normals": "pixels"}[facts["kind"]]
    lines = {
        "components of": f"{source}, {facts['count']} {counted}",
        "mean": "taken off" if facts["centred"] else "kept",
        "each": ", ".join(f"{each:.4f}" for each in facts["variance"]),
        **{f"first {count}": f"{share:.4f}" for count, share in facts["cumulative"].items()},
        **({"pictures": f"{facts['folder']}, {len(facts['files'])} files"} if "folder" in facts else {}),
    }
    print_report(report, as_json, lines)


@variation.command()
@click.argument("source", metavar="STACK|MESH|NORMALS", type=click.Path())
@click.option(
    "--holdout",
    type=whole_number(2),
    default=5,
    show_default=True,
    metavar="K",
    help="Test by every K-th light (stack).",
)
@click.option("--albedo", type=click.Path(), metavar="IMAGE", help="Albedo beside a picture of normals.")
@click.option(
    "--lights",
    type=click.Choice(["sphere", "hemisphere"]),
    default="sphere",
    show_default=True,
    help="Where lamps are, all around or in front (mesh, normals).",
)
@_green_option
@click.option("--up", type=click.Choice(["y", "z"]), help="Axis of a mesh's file that points up; default: z, of GLB y.")
@memory_option("256MiB", "samples of a stack on their way")
@device_option
@json_option
def subspaces(source: str, as_json: bool, **asked: Any) -> None:
    """How much of a view's pictures under lamps each subspace holds, side by side.

    Three and four dimensions of the scaled normals, nine of harmonics, nine pictures, principal components, and the
    cone of pictures, each at lamps that it was not made of.

    \b
    Example:
      clrelight variation subspaces stack.h5
      clrelight variation subspaces normals.exr --albedo albedo.exr
    """
    from clrelight.jobs.variation.subspaces import compare_subspaces
    from clrelight.variation.comparing import EPSTEIN

    report = make_report(as_json)
    with progress_bar("reading") as bar:
        compare_subspaces(source, progress=bar, report=report, **asked)
    facts = report.facts
    known = {f"mean and {count} components": f"{share:.2f}" for count, share in EPSTEIN.items()}
    if not as_json:
        rows = [
            [
                *(each["name"], str(each["dimensions"]), f"{each['energy']:.4f}", f"{each['variance']:.4f}"),
                known.get(each["name"], ""),
            ]
            for each in facts["spaces"]
        ]
        print_table(["subspace", "dimensions", "of energy", "of variance", "Epstein's faces"], rows)
        greedy = next(each for each in facts["spaces"] if each["name"] == "nine lights, greedy")
    else:
        greedy = {"lights": []}
    counted = {"stack": "lights", "mesh": "vertices in view", "normals": "pixels"}[facts["kind"]]
    lines = {
        "subspaces of": f"{source}, {facts['count']} {counted}",
        "lamps": f"made of {facts['made_of']}, tested by {facts['tested']} others",
        "greedy lights": ", ".join(map(str, greedy["lights"])),
    }
    print_report(report, as_json, lines)


@variation.command()
@click.argument("image", type=click.Path())
@click.argument("normals", type=click.Path())
@click.argument("out", metavar="LIGHT.h5", type=click.Path())
@click.option("--albedo", type=click.Path(), metavar="IMAGE", help="Albedo of the view; default: 1 everywhere.")
@click.option(
    "--degree", type=whole_number(0, 30), help="Of the light; default: 2, or below that what the normals tell."
)
@click.option("--ridge", type=float, default=0.0, show_default=True, help="Damps what the picture hardly tells.")
@_green_option
@json_option
def inverse(image: str, normals: str, out: str, as_json: bool, **asked: Any) -> None:
    """Find the light behind a linear picture of a matte view whose normals are known.

    \b
    Example:
      clrelight variation inverse photo.exr normals.exr light.h5 --albedo albedo.exr
    """
    from clrelight.jobs.variation.components import inverse_lighting

    report = make_report(as_json)
    with progress_bar("reading") as bar:
        inverse_lighting(image, normals, out=out, progress=bar, report=report, **asked)
    facts = report.facts
    lines = {
        "light": out,
        "degree": facts["degree"],
        "condition": ", ".join(f"{each:.3g}" for each in facts["condition"]) + " up to degree 0, 1, ...",
        "not explained": f"{facts['residual']:.2%} of the picture",
    }
    print_report(report, as_json, lines)


@variation.command()
@click.argument("source", metavar="STACK", type=click.Path())
@click.argument("out", metavar="BASIS.h5", type=click.Path())
@click.option(
    "--by",
    type=click.Choice(["lights", "normals"]),
    default="lights",
    show_default=True,
    help="Least squares over nine photographs and more, or harmonics of the normals that three tell.",
)
@click.option("--degree", type=whole_number(0, 2), help="Of light: 1, 4 or 9 pictures; default: what the lights tell.")
@click.option("--pictures", type=click.Path(), metavar="FOLDER", help="Also pictures of them; grey is 0.")
@memory_option("256MiB", "samples of a stack on their way")
@device_option
@json_option
def basis(source: str, out: str, as_json: bool, **asked: Any) -> None:
    """Write the nine pictures that all pictures of a matte view are sums of, from a few photographs.

    They are a fit of degree 2, for `relight` under any light.

    \b
    Example:
      clrelight variation basis stack.h5 nine.h5 --pictures nine/
      clrelight variation basis four.h5 nine.h5 --by normals
    """
    from clrelight.jobs.variation.basis import basis_images

    report = make_report(as_json)
    with progress_bar("reading") as bar:
        basis_images(source, out=out, progress=bar, report=report, **asked)
    facts = report.facts
    told = ", ".join(f"{each:.3g}" for each in facts["condition"])
    lines = {
        "basis": f"{out}, {facts['count']} pictures of degree {facts['degree']} by {facts['by']}",
        "condition": f"{told} of the lights" if asked["by"] == "normals" else f"{told} up to degree 0, 1, ...",
        **({"pictures": f"{facts['folder']}, {len(facts['files'])} files"} if "folder" in facts else {}),
    }
    print_report(report, as_json, lines)


@variation.command()
@click.argument("gallery", metavar="GALLERY_FOLDER", type=click.Path())
@click.argument("photographs", metavar="PHOTO...", nargs=-1, required=True, type=click.Path())
@click.option(
    "--spaces",
    type=Names(),
    default="9d",
    show_default=True,
    help="What pictures of a subject are taken to be: 3d, 4d, 9d (harmonics as light), cone (lamps).",
)
@click.option(
    "--pixels",
    type=click.Choice(["common", "all"]),
    default="common",
    show_default=True,
    help="Those that all subjects share, or outlines too.",
)
@click.option("--side", type=whole_number(8), default=256, show_default=True, help="Pixels that pictures shrink to.")
@click.option(
    "--transfer",
    type=click.Choice(["linear", "srgb"]),
    default="linear",
    show_default=True,
    help="Curve of photographs.",
)
@_green_option
@click.option("--csv", type=click.Path(), metavar="FILE.csv", help="Also a table of all distances.")
@json_option
def recognise(gallery: str, photographs: tuple[str, ...], as_json: bool, **asked: Any) -> None:
    """Say which subject of a gallery each photograph shows, under light that may be any.

    A subject is a folder with normals and albedo, or with photographs (and an .lp file, where lights are known), or a
    stack. All lie alike and have one size.

    \b
    Example:
      clrelight variation recognise people/ who.exr
      clrelight variation recognise people/ a.jpg b.jpg --transfer srgb --spaces 3d,4d,9d,cone --csv table.csv
    """
    from clrelight.jobs.variation.recognition import recognise as run_recognise

    report = make_report(as_json)
    with progress_bar("reading") as bar:
        run_recognise(gallery, photographs, progress=bar, report=report, **asked)
    facts = report.facts
    if not as_json:
        rows = [
            [
                each["photograph"],
                each["space"],
                str(rank),
                ranked["subject"],
                f"{ranked['distance']:.4f}",
                _margin(each, rank),
            ]
            for each in facts["photographs"]
            for rank, ranked in enumerate(each["ranks"][:3], start=1)
        ]
        print_table(["photograph", "space", "rank", "subject", "distance", "margin"], rows)
    lines = {"gallery": f"{len(facts['subjects'])} subjects, {facts['pixels']} pixels"}
    if "file" in facts:
        lines["table"] = facts["file"]
    print_report(report, as_json, lines)


def _margin(told: dict[str, Any], rank: int) -> str:
    ranks = told["ranks"]
    return f"{ranks[rank]['distance'] - ranks[rank - 1]['distance']:.4f}" if rank < len(ranks) else ""


COMMANDS = (variation,)
