"""Bytes, seconds and decibel of klt beside other ways to keep the same photographs, in one run.

    CLRELIGHT_DATA=data python -m benchmarks.coding_peers [--stack GLOB] [--way GLOB | --markdown docs/peers.md]

klt at three rates sets qualities; each peer's own setting is searched for the same, and bytes are compared. JPEG 2000,
HTJ2K, JPEG XL and SPERR code klt's principal planes and the raw maps, RTI tools have planes in JPEG, HEVC, AV1 and
SPERR in three dimensions code the photographs. What is not installed is left out, and named.
"""

from __future__ import annotations

import json
from fnmatch import fnmatch
from pathlib import Path

import click

from benchmarks.pages import check_markdown, replace_block
from benchmarks.peer_page import (
    SUMMARY_HEADERS,
    seconds,
    stack_headers,
    stack_rows,
    summary_rows,
    to_json,
    to_page,
    where_behind,
)
from benchmarks.peer_stacks import fit_stack, requests
from benchmarks.peer_ways import RATES, WAYS, Measurement, Row, measure_stack
from clrelight.cli.output import print_facts
from clrelight.cli.tables import print_table
from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.speed.environment import describe_environment

BEGIN, END = "<!-- peers -->", "<!-- /peers -->"


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--stack", "patterns", multiple=True, metavar="GLOB", help="Such as ring or 'Real/*'; repeatable.")
@click.option("--way", "ways", multiple=True, metavar="GLOB", help="Such as 'JPEG*principal*'; repeatable.")
@click.option("--quick", is_flag=True, help="Tiny parts of the stacks: shows that it works.")
@click.option("--device", "device_name", help="Index, gpu, cpu, pocl or a part of a name.")
@click.option("--json", "json_path", type=click.Path(dir_okay=False, path_type=Path), help="Keep all figures.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help=f"Fill what stands between {BEGIN}s.")
def main(
    patterns: tuple[str, ...],
    ways: tuple[str, ...],
    quick: bool,
    device_name: str | None,
    json_path: Path | None,
    markdown: Path | None,
) -> None:
    """Measure klt and its peers on all stacks."""
    try:
        chosen = [each for each in requests() if _fits(each.name, patterns)]
        if not chosen:
            raise InputError(f"no stack's name fits {', '.join(patterns)}; there are {', '.join(_names())}")
        for pattern in ways:
            if not any(_fits(way, (pattern,)) for way in WAYS):
                raise InputError(f"no way fits {pattern}; there are {'; '.join(WAYS)}")
        if markdown is not None and ways:
            raise InputError("--markdown replaces rows of all ways: it takes no --way")
        if markdown is not None:
            check_markdown(markdown, BEGIN, END)
        device = open_device(device_name)
    except InputError as error:
        raise click.UsageError(str(error)) from None
    measurement = Measurement()
    for request in chosen:
        try:
            stack = fit_stack(request, device, quick=quick)
        except InputError as error:
            measurement.left_out[request.name] = str(error)
            click.echo(f"{request.name} is left out: {error}", err=True)
            continue
        measure_stack(stack, device, measurement, _tell, wanted=lambda way: _fits(way, ways))
        del stack
        facts = describe_environment(device)
        if json_path is not None:
            json_path.write_text(json.dumps(to_json(measurement, facts), indent=1) + "\n", encoding="utf-8")
    if not measurement.rows:
        raise click.ClickException("no stack could be measured")
    click.echo()
    print_table(stack_headers(RATES), stack_rows(measurement.rows, RATES))
    click.echo()
    print_table(SUMMARY_HEADERS, summary_rows(measurement.rows))
    click.echo(f"\n{where_behind(measurement.rows)}\n")
    print_facts({**facts, **{f"left out: {name}": why for name, why in measurement.left_out.items()}})
    if markdown is not None:
        replace_block(markdown, to_page(measurement, facts, RATES), BEGIN, END)


def _fits(name: str, patterns: tuple[str, ...]) -> bool:
    return not patterns or any(fnmatch(name, pattern) for pattern in patterns)


def _names() -> list[str]:
    return [each.name for each in requests()]


def _tell(row: Row) -> None:
    what = "" if row.reached else ", not reached"
    click.echo(
        f"{row.stack:26} {row.way:32} {row.rate:5g} bit  {row.byte_count:10.0f} B {row.ratio:7.3f} × at"
        f" {row.psnr:.2f} dB {row.equal}{what}  {seconds(row.point)}"
        f"  {row.point.setting}"
    )


if __name__ == "__main__":
    main()
