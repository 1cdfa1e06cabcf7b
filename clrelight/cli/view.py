"""``clrelight view``: a page that relights files in a browser."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

import click

from clrelight.cli.options import device_option, json_option, whole_number
from clrelight.cli.output import make_report, print_json, print_report
from clrelight.cli.progress import progress_bar
from clrelight.errors import InputError


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=click.Path())
@click.option("--out", type=click.Path(), metavar="PAGE.html", help="Write one page that works from disk instead.")
@click.option("--reference", type=click.Path(), metavar="FILE", help="Stack, fit or encoding to compare with.")
@click.option(
    "--environment",
    "environments",
    type=click.Path(),
    multiple=True,
    metavar="FILE",
    help="Environment map (zenith up) or light file to offer; may be repeated.",
)
@click.option("--exposure", type=float, default=0.0, show_default=True, help="Stops to begin with.")
@click.option(
    "--planes",
    type=click.Choice(["half", "uint8"]),
    default="half",
    show_default=True,
    help="What is sent of files that the page does not decode itself (all but klt).",
)
@click.option("--port", type=whole_number(0, 65535), default=0, show_default=True, help="On loopback; 0: any.")
@click.option("--open", "opens", is_flag=True, help="Open the page in the browser.")
@device_option
@json_option
def view(
    files: tuple[str, ...],
    out: str | None,
    reference: str | None,
    environments: tuple[str, ...],
    exposure: float,
    planes: str,
    port: int,
    opens: bool,
    device: str | None,
    as_json: bool,
) -> None:
    """Show fits and encodings in a browser, under a lamp, a sky or an environment that one drags.

    The page is served to this machine alone, until Ctrl-C; with --out it becomes one file that needs no server.
    Several files of one view are compared side by side.

    \b
    Example:
      clrelight view view.h5
      clrelight view small.h5 fit.h5 --reference stack.h5 --environment grace_probe.hdr
      clrelight view view.h5 --out viewer.html
    """
    from clrelight.view.session import served_viewer, write_viewer

    shown: dict[str, Any] = {"environments": environments, "reference": reference, "planes": planes}
    shown |= {"exposure": exposure, "device": device, "report": make_report(as_json)}
    if out is not None:
        if port or opens:
            raise InputError("--port and --open are for a page that is served: leave them out with --out")
        with progress_bar("writing") as bar:
            report = write_viewer(files, out, progress=bar, **shown)
        print_report(report, as_json, {"page": out, "size": f"{report.facts['bytes']} bytes"})
        return
    with served_viewer(files, port=port, **shown) as server:
        if as_json:
            print_json({"address": server.address})
        else:
            click.echo(f"{server.address}\nCtrl-C ends it.")
        sys.stdout.flush()
        if opens:
            click.launch(server.address)
        with suppress(KeyboardInterrupt):  # that is how it ends
            server.serve_forever(poll_interval=0.2)


COMMANDS = (view,)
