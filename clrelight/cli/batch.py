"""``clrelight batch``: one job on many stacks."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import device_option, json_option, whole_number
from clrelight.cli.output import decibel, make_report, print_facts, print_json
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.batch import Batch, Task
    from clrelight.jobs.report import Report

_SHOWN = 40
"""Rows of a table on a terminal; the files have all."""


@click.command()
@click.argument("what", metavar="LIST.toml|FOLDER", type=click.Path())
@click.argument("out", metavar="OUTFOLDER", type=click.Path())
@click.option(
    "--job",
    help="pack, ingest, fit, encode, decode, unpack, relight, export, normals, bench, psnr, find-lights, import, "
    "transfer, to-sh or preview.",
)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="An option of the job; may be repeated.")
@click.option("--match", multiple=True, metavar="PATTERN", help="Only stacks with such names, such as coin*.")
@click.option(
    "--ending",
    metavar=".EXT",
    help="Of the files that are written, such as .exr (normals, relight, export, preview).",
)
@click.option("--engine", default="local", show_default=True, help="local, dask, or a scheduler, tcp://HOST:PORT.")
@click.option("--jobs", type=whole_number(1, 1024), metavar="N", help="Stacks at a time; local: 1, with all cores.")
@click.option("--keep-going", is_flag=True, help="Go on after a stack that fails.")
@click.option("--retries", type=whole_number(0, 100), default=1, show_default=True, help="Of stacks whose worker dies.")
@click.option("--timeout", type=click.FloatRange(0, min_open=True), metavar="S", help="Longest for a stack (local).")
@click.option("--memory-limit", default="auto", show_default=True, metavar="BYTES", help="Of a worker (dask).")
@click.option(
    "--tiles",
    is_flag=True,
    help="Share each stack among workers (pack, fit, decode, unpack, relight, psnr, transfer, bench).",
)
@click.option("--tile-rows", type=whole_number(1), metavar="ROWS", help="Of a tile (fit, decode).")
@click.option("--virtual", is_flag=True, help="Leave the tiles in files of their own; the result points to them.")
@click.option("--verify", is_flag=True, help="Compare contents of files, not only sizes and times, with the journal.")
@click.option("--force", is_flag=True, help="Do everything again.")
@click.option("--dry-run", is_flag=True, help="Only say what would be done to which stacks.")
@device_option
@json_option
@click.pass_context
def batch(
    context: click.Context,
    what: str,
    out: str,
    job: str | None,
    settings: tuple[str, ...],
    match: tuple[str, ...],
    ending: str | None,
    force: bool,
    dry_run: bool,
    tiles: bool,
    tile_rows: int | None,
    virtual: bool,
    as_json: bool,
    jobs: int | None,
    **asked: Any,
) -> None:
    """Do one job to many stacks; the same command goes on where it stopped.

    A folder holds stacks, or what else the job takes: files, or for pack, ingest and find-lights folders of
    photographs. A list in TOML names them, and has options for all or some. Results have the stacks' names. What is
    done already, by the same code, with the same options, from the same files, is kept; what failed is tried again.
    journal.jsonl, summary.csv and summary.json in OUTFOLDER tell of every stack.

    \b
    Example:
      clrelight batch photos/ packed/ --job pack --set bytes=200k --keep-going
      clrelight batch museum.toml packed/ --engine dask --jobs 4
      clrelight batch packed/ checked/ --job psnr --set stack=stacks/{name}.h5
    """
    from clrelight.batch import make_tasks, read_listing, run_batch
    from clrelight.batch.tiles import run_tiles

    report = make_report(as_json)
    listing = read_listing(what, job, match=match, out=out)
    report.note(*listing.notes)
    tasks = make_tasks(listing, out, job=job, ending=ending, options=_parse(settings))
    if dry_run:
        _print_plan(tasks, out, as_json, force, report)
        return
    with progress_bar(tasks[0].job) as bar:
        asked |= {"workers": jobs, "anew": force, "progress": bar, "report": report}
        if tiles or virtual or tile_rows:
            done = run_tiles(tasks, out, rows=tile_rows, virtual=virtual, **asked)
        else:
            done = run_batch(tasks, out, **asked)
    _print(done, as_json, report.notes)
    if done.failed or done.left:
        context.exit(1 if any(each.kind == "bug" for each in done.failed) else 2)


def _print_plan(tasks: Sequence[Task], out: str, as_json: bool, force: bool, report: Report) -> None:
    """Say what would be done; nothing is written where no batch was before."""
    from clrelight.batch.run import JOURNAL, run_batch

    kept: frozenset[str] = frozenset()
    if not force and Path(out, JOURNAL).exists():
        kept = run_batch(tasks, out, only_kept=True, report=report).kept
    rows = [
        {
            "stack": task.name,
            "state": "kept" if task.name in kept else "to do",
            "source": task.source,
            "out": task.out,
            "options": dict(task.options),
        }
        for task in tasks
    ]
    if as_json:
        print_json({"job": tasks[0].job, "stacks": len(tasks), "kept": len(kept), "rows": rows, "notes": report.notes})
        return
    given = [", ".join(f"{name}={value}" for name, value in task.options.items()) for task in tasks]
    cells = [[*map(str, [*row.values()][:4]), options] for row, options in zip(rows, given, strict=True)]
    print_table(("stack", "state", "source", "result", "options"), cells)


def _parse(settings: Sequence[str]) -> dict[str, Any]:
    """Return options as TOML has them; what is no value of TOML is a text."""
    found = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals or not name:
            raise InputError(f"--set takes KEY=VALUE, such as degree=6, got {setting!r}")
        try:
            value = tomllib.loads(f"value = {text}")
            found[name.replace("-", "_")] = value["value"] if len(value) == 1 else text
        except tomllib.TOMLDecodeError:
            found[name.replace("-", "_")] = text
    return found


def _print(done: Batch, as_json: bool, notes: Sequence[str]) -> None:
    from clrelight.batch.summary import COLUMNS, summary_rows, summary_totals

    totals = summary_totals(done.outcomes, done.kept, len(done.left))
    rows = summary_rows(done.outcomes, done.kept)
    if as_json:
        print_json({**totals, "files": list(done.files), "rows": rows, "notes": list(notes)})
        return
    shown = [row for row in rows if row["error"]] + [row for row in rows if not row["error"]]
    used = [name for name in COLUMNS if any(row[name] not in (None, "") for row in rows)]
    print_table(used, [[_cell(row[name]) for name in used] for row in shown[:_SHOWN]], expendable=("tries", "seconds"))
    counts = ", ".join(f"{totals[name]} {name}" for name in ("done", "kept", "failed", "left") if totals[name])
    lines: dict[str, Any] = {"stacks": f"{totals['stacks']} ({counts})", "bytes": totals["bytes"]}
    if len(rows) > _SHOWN:
        lines["not shown"] = f"{len(rows) - _SHOWN} more stacks"
    lines |= {
        label: f"{decibel(totals[key])} in the mean"
        for label, key in (("PSNR", "psnr"), ("held out", "psnr_holdout"))
        if key in totals
    }
    print_facts({**lines, "table": done.files[1], "journal": done.files[0]})


def _cell(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, float) else "" if value is None else str(value)


COMMANDS = (batch,)
"""``clrelight batch``."""
