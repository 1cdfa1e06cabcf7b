"""``--engine`` and ``--jobs`` of commands that share one stack among workers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import Command, whole_number

if TYPE_CHECKING:
    from clrelight.jobs.report import Progress, Report

_OPTIONS = (
    click.option(
        "--engine",
        metavar="ENGINE",
        help="Have parts done by workers: local, dask, or a scheduler, tcp://HOST:PORT; default: this process alone.",
    ),
    click.option("--jobs", type=whole_number(1, 1024), metavar="N", help="Workers (local, dask)."),
)


def engine_options(command: Command) -> Command:
    """Add the options that say who works."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def is_shared(engine: str | None, jobs: int | None) -> bool:
    """Return whether workers are asked for."""
    return engine is not None or jobs is not None


def run_shared(
    job: str,
    source: str,
    out: str | None,
    options: dict[str, Any],
    engine: str | None,
    jobs: int | None,
    device: str | None,
    progress: Progress,
    report: Report,
) -> None:
    """Do a job with parts done by workers."""
    from clrelight.batch.single import run_single

    run_single(
        job,
        source,
        out,
        options=options,
        engine=engine or "local",
        workers=jobs,
        device=device,
        progress=progress,
        report=report,
    )
