"""``clrelight devices``."""

from __future__ import annotations

from dataclasses import asdict

import click

from clrelight.cli.options import json_option
from clrelight.cli.output import print_json
from clrelight.cli.tables import print_table


@click.command()
@json_option
def devices(as_json: bool) -> None:
    """List the OpenCL devices, and which one is the default.

    \b
    Example:
      clrelight devices
      clrelight fit stack.h5 fit.h5 --device gpu
    """
    from clrelight.device import list_devices, open_device

    infos = list_devices()
    if not infos:
        open_device()  # says how to install one
    if as_json:
        print_json({"devices": [asdict(info) for info in infos]})
        return
    rows = [
        [
            f"{info.index}{' *' if info.default else ''}",
            info.kind,
            info.style,
            info.name,
            info.version.split("  ")[0],
            info.driver,
            "yes" if info.float64 else "no",
            f"{info.memory_bytes / 2**30:.1f} GiB",
        ]
        for info in infos
    ]
    print_table(
        ["index", "kind", "kernels", "name", "version", "driver", "float64", "memory"],
        rows,
        expendable=("driver", "memory"),
    )
    click.echo("* taken when neither --device nor CLRELIGHT_DEVICE names one")


COMMANDS = (devices,)
