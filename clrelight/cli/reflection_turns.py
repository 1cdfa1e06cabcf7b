"""``clrelight shrm rotate``: reflection maps under turned light."""

from __future__ import annotations

import click

from clrelight.cli.lamps import ROTATION_HELP, Rotation, Turn
from clrelight.cli.options import Numbers, json_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar


@click.command()
@click.argument("source", metavar="SHRM", type=click.Path())
@click.argument("out", type=click.Path())
@click.option("--rotate", "turn", type=Turn(), help=f"Turn the light: {ROTATION_HELP}")
@click.option("--turntable", type=whole_number(1, 10000), metavar="N", help="N maps, the light going round once.")
@click.option(
    "--about", type=Numbers(float, "0,0,1", 3), default="0,0,1", show_default=True, help="Axis of the turntable."
)
@json_option
def rotate(
    source: str,
    out: str,
    turn: Rotation | None,
    turntable: int | None,
    about: tuple[float, float, float],
    as_json: bool,
) -> None:
    """Write a reflection map as it is under turned light, without its environment map.

    \b
    Example:
      clrelight shrm rotate glossy.h5 turned.h5 --rotate axis:1,0,0,-90
      clrelight shrm rotate glossy.h5 turned%03d.h5 --turntable 36
    """
    from clrelight.jobs.reflection.turns import rotate_reflection

    report = make_report(as_json)
    with progress_bar("turning") as bar:
        rotate_reflection(
            source,
            out,
            rotate=turn,
            turntable=turntable,
            about=about,
            progress=lambda done, total, what: bar(done, total or done),
            report=report,
        )
    files = report.facts["files"]
    rate = len(files) / max(report.seconds["turn"], 1e-9)
    lines = {
        "reflection maps" if len(files) > 1 else "reflection map": files[0]
        if len(files) == 1
        else f"{files[0]} … {files[-1]}",
        "rate": f"{rate:.1f} a second",
    }
    print_report(report, as_json, lines)
