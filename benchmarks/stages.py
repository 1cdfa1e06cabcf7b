"""Print how fast every stage is beside a peer timed in the same run: ``python -m benchmarks.stages``."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click

from benchmarks import pages
from benchmarks.coding import codec_stages
from benchmarks.fitting import fit_stages, projection_stages
from benchmarks.imaging import imaging_stages
from benchmarks.workload import Workload, make_workload
from clrelight.cli.output import print_facts
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.speed import tables
from clrelight.speed.environment import describe_environment
from clrelight.speed.stage import Row, Stage, measure
from clrelight.speed.timing import SETTLE_SECONDS


@dataclass(frozen=True)
class Scale:
    """How much to measure: pixels along a side, lights, degree of the fits, samples, and the pause before each."""

    size: int
    lights: int
    degree: int
    rounds: int
    settle_seconds: float


FULL = Scale(size=256, lights=256, degree=6, rounds=15, settle_seconds=SETTLE_SECONDS)
QUICK = Scale(size=16, lights=32, degree=2, rounds=1, settle_seconds=0.0)

_FILE = click.Path(dir_okay=False, path_type=Path)


def all_stages(work: Workload) -> Iterator[Stage]:
    """Yield every stage, made when it is its turn, so that only one's arrays are held."""
    return itertools.chain(projection_stages(work), fit_stages(work), codec_stages(work), imaging_stages(work))


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--quick", is_flag=True, help="A small picture and one round: shows that it works, not how fast.")
@click.option("--rounds", type=click.IntRange(min=1), help=f"Samples of each contender.  [default: {FULL.rounds}]")
@click.option("--only", metavar="TEXT", default="", help="Only stages whose name holds TEXT.")
@click.option("--device", metavar="NAME", help="Index, gpu, cpu, pocl or a part of a name.")
@click.option("--json", "json_file", type=_FILE, help="Write the figures to a file.")
@click.option("--markdown", "markdown_file", type=_FILE, help="Replace the table between the file's stages markers.")
def main(
    quick: bool, rounds: int | None, only: str, device: str | None, json_file: Path | None, markdown_file: Path | None
) -> None:
    """Time every stage in turns with a peer, and print ratios, spread and errors against float64.

    \b
    Example:
      python -m benchmarks.stages --only project
      python -m benchmarks.stages --markdown docs/performance.md
    """
    if markdown_file is not None:
        pages.check_markdown(markdown_file)  # before minutes of work
    scale = QUICK if quick else FULL
    opened = open_device(device)
    facts = describe_environment(opened)
    work = make_workload(opened, size=scale.size, lights=scale.lights, degree=scale.degree)
    facts["work"] = (
        f"ring scene, {scale.lights} lights, {work.columns} columns ({scale.size} × {scale.size} pixels, RGB), "
        f"uint8, degree {scale.degree} unless a stage says otherwise"
    )
    rows: list[Row] = []
    with progress_bar("stages") as progress:
        for stage in all_stages(work):
            if only.lower() in stage.name.lower():
                progress(len(rows), len(rows) + 1, stage.name)
                rows.append(measure(stage, opened, rounds=rounds or scale.rounds, settle_seconds=scale.settle_seconds))
    if not rows:
        raise InputError(f"no stage has {only!r} in its name")
    print_facts(facts)
    click.echo()
    print_table(tables.HEADERS, [tables.cells(row) for row in rows], expendable=tables.EXPENDABLE)
    if json_file is not None:
        json_file.write_text(pages.to_json(rows, facts), encoding="utf-8")
    if markdown_file is not None:
        pages.replace_block(markdown_file, pages.to_markdown(rows, facts))


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.stages")
    except InputError as error:
        sys.exit(f"benchmarks.stages: {error}")
