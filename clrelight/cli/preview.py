"""``clrelight preview``: a small picture of a file."""

from __future__ import annotations

import click

from clrelight.cli.options import json_option, whole_number
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar


@click.command()
@click.argument("file", type=click.Path())
@click.argument("out", metavar="OUT.png|OUT.h5", type=click.Path())
@click.option("--size", type=whole_number(1, 4096), default=256, show_default=True, help="Longer side in pixels.")
@json_option
def preview(file: str, out: str, size: int, as_json: bool) -> None:
    """Write a small picture of a file of ours, or a copy of an encoding that holds one.

    Stacks, fits, lights and results open on a picture in h5web, silx and the like as they are; an encoding, whose bytes
    only its codec reads, does where it was copied to a name that ends in .h5.

    \b
    Example:
      clrelight preview stack.h5 stack.png
      clrelight preview view.h5 shown.h5 --size 128
    """
    from clrelight.jobs.preview import preview as run_preview

    with progress_bar("drawing"):
        report = run_preview(file, out, size=size, report=make_report(as_json))
    width, height = report.facts["size"]
    print_report(report, as_json, {"preview": out, "size": f"{width}×{height}, {report.facts['bytes_on_disk']} bytes"})


COMMANDS = (preview,)
