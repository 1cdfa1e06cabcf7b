"""``clrelight to-sh``."""

from __future__ import annotations

import click

from clrelight.cli.options import device_option, json_option
from clrelight.cli.output import make_report, print_report
from clrelight.cli.progress import progress_bar


@click.command(name="to-sh")
@click.argument("fitted", metavar="FIT_OR_ENC", type=click.Path())
@click.argument("out", type=click.Path())
@device_option
@json_option
def to_sh(fitted: str, out: str, device: str | None, as_json: bool) -> None:
    """Make spherical-harmonic coefficients of a fit of basis gram-schmidt, which spans the same functions.

    \b
    Example:
      clrelight to-sh gram-schmidt.h5 harmonics.h5
    """
    from clrelight.jobs.to_sh import to_sh as run

    report = make_report(as_json)
    with progress_bar("changing the basis") as bar:
        run(fitted, out=out, device=device, progress=bar, report=report)
    facts = report.facts
    lines = {"fit": out, "basis": f"{facts['basis']}, degree {facts['degree']}"}
    print_report(report, as_json, {**lines, "condition": f"{facts['condition']:.3g}"})


COMMANDS = (to_sh,)
