"""``clrelight brdf``: measured reflectances."""

from __future__ import annotations

import click

from clrelight.cli.options import json_option
from clrelight.cli.output import make_report, print_report


@click.group()
def brdf() -> None:
    """Look at measured reflectances.

    \b
    Example:
      clrelight brdf info krylon_blue.brdf
    """


@brdf.command()
@click.argument("file", type=click.Path())
@json_option
def info(file: str, as_json: bool) -> None:
    """Say what a .brdf file holds, and how its energy falls to orders P of the view.

    \b
    Example:
      clrelight brdf info krylon_blue.brdf
    """
    from clrelight.jobs.reflection_plan import describe_brdf

    report = make_report(as_json)
    describe_brdf(file, report=report)
    facts = report.facts
    waves = facts["wavelengths"]
    (first, last), (low, high) = facts["light_degrees"], facts["view_degrees"]
    lines = {
        "file": file,
        "measured": f"{facts['pairs']} pairs of directions, light {first:.0f} to {last:.0f}°, "
        f"view {low:.0f} to {high:.0f}°",
        "wavelengths": f"{len(waves)}, {waves[0]:g} to {waves[-1]:g} nm",
        "values": f"{facts['least']:.4g} to {facts['largest']:.4g} 1/sr",
        f"energy up to P, F = {facts['degree']}": ", ".join(f"{row.mean():.3f}" for row in facts["shares"]),
    }
    print_report(report, as_json, lines)


COMMANDS = (brdf,)
