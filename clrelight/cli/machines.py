"""``clrelight devices`` and ``clrelight selftest``."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from clrelight.cli.options import device_option, json_option
from clrelight.cli.output import print_json
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table

if TYPE_CHECKING:
    from clrelight.opencl.devices import DeviceInfo


@click.command()
@click.option("--again", is_flag=True, help="Test all of them anew, whatever was found before.")
@json_option
def devices(again: bool, as_json: bool) -> None:
    """List the OpenCL devices, whether each computes soundly, and which one is the default.

    Each device is tested once per driver, processor and version of the kernels: a process apart runs small jobs of
    every kind and compares their numbers. Lanes is the width of vectors that was found sound and fastest; @4, @8 or
    @16 behind a device's name asks for another, tested or not.

    \b
    Example:
      clrelight devices
      clrelight fit stack.h5 fit.h5 --device gpu
      clrelight fit stack.h5 fit.h5 --device pocl@8
    """
    from clrelight.device import open_device
    from clrelight.opencl.devices import list_devices
    from clrelight.opencl.drivers import leave_out_drivers

    infos = list_devices(again=again)
    left_out = leave_out_drivers()
    if not infos:
        open_device("")  # says how to install one
    if as_json:
        print_json({"devices": [asdict(info) for info in infos], "left_out": left_out})
    else:
        _print_devices(infos, left_out)
    if not any(info.default for info in infos):
        open_device("")  # says what is wrong with each


def _print_devices(infos: list[DeviceInfo], left_out: dict[str, str]) -> None:
    rows = [
        [
            f"{info.index}{' *' if info.default else ''}",
            info.kind,
            info.style,
            str(info.lanes) if info.lanes else "-",
            info.name,
            info.version.split("  ")[0],
            info.driver,
            "yes" if info.float64 else "no",
            f"{info.memory_bytes / 2**30:.1f} GiB",
            "no" if info.fault else "yes",
        ]
        for info in infos
    ]
    print_table(
        ["index", "kind", "kernels", "lanes", "name", "version", "driver", "float64", "memory", "sound"],
        rows,
        expendable=("driver", "memory"),
    )
    click.echo("* taken when neither --device nor CLRELIGHT_DEVICE names one")
    for info in infos:
        if info.processor:
            click.echo(f"{info.index}: told to compile for {info.processor}, as its LLVM is older than this processor")
        if info.fault:
            click.echo(f"{info.index}: {info.name} {info.fault}")
    for file, fault in left_out.items():
        click.echo(f"left out: {file}: {fault}")


@click.command()
@click.option("--markdown", "as_markdown", is_flag=True, help="Print the table as Markdown.")
@device_option
@json_option
@click.pass_context
def selftest(context: click.Context, as_markdown: bool, device: str | None, as_json: bool) -> None:
    """Compare what a device computes with float64: fits, codecs and images, at ordinary and extreme numbers.

    Each statement has a figure and the limit that it must keep. Ends with exit code 1 where one does not hold.

    \b
    Example:
      clrelight selftest
      clrelight selftest --device gpu --json
    """
    from clrelight.device import open_device
    from clrelight.selftest import run_selftest

    if as_json and as_markdown:
        raise click.UsageError("--json and --markdown exclude each other")
    opened = open_device(device)
    with progress_bar("testing"):
        statements = list(run_selftest(opened))
    failed = [statement for statement in statements if not statement.holds]
    headers = ["part", "case", "what", "figure", "limit", "holds"]
    rows = [
        [s.part, s.case, s.what, f"{s.figure:.1e}", f"{s.limit:.0e}", "yes" if s.holds else "NO"] for s in statements
    ]
    if as_json:
        entries = [{**asdict(statement), "holds": statement.holds} for statement in statements]
        print_json({"device": opened.info.label, "failed": len(failed), "statements": entries})
    elif as_markdown:
        for cells in (headers, ["---"] * len(headers), *rows):
            click.echo(f"| {' | '.join(cells)} |")
    else:
        print_table(headers, rows)
        click.echo(f"{len(statements) - len(failed)} of {len(statements)} statements hold on {opened.info.label}")
    if failed:
        context.exit(1)


COMMANDS = (devices, selftest)
