"""What commands print: facts for people, one JSON object for machines, and progress on a terminal."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import click

_PATIENCE_SECONDS = 1.0
_PIPE_WIDTH = 400


def print_json(values: Mapping[str, Any]) -> None:
    """Print one JSON object; infinities become the strings ``inf`` and ``-inf``, NaN becomes null."""
    click.echo(json.dumps(_plain(values)))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if hasattr(value, "item") and getattr(value, "ndim", 0) == 0:
        value = value.item()
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def print_facts(facts: Mapping[str, Any], indent: str = "") -> None:
    """Print names and values in two columns; what is nested is indented."""
    width = max((len(name) for name in facts), default=0)
    for name, value in facts.items():
        if isinstance(value, Mapping) and value:
            click.echo(f"{indent}{name}")
            print_facts(value, indent + "  ")
        else:
            click.echo(f"{indent}{name:<{width}}  {_short(value)}")


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return " × ".join(str(v) for v in value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def print_notes(notes: Sequence[str]) -> None:
    """Print notes on standard error, so that they never mix with results."""
    for note in notes:
        click.echo(f"note: {note}", err=True)


def print_table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; numbers are aligned to the right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for index, header in enumerate(headers):
        numeric = all(_is_number(row[index]) for row in rows)
        table.add_column(header, justify="right" if numeric else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    # A pipe has no width, and a cut table is no table: give it what it needs there, and let a terminal wrap lines.
    console = Console(width=None if sys.stdout.isatty() else _PIPE_WIDTH)
    needed = console.measure(table).maximum
    Console(width=max(needed, console.width), soft_wrap=True).print(table, crop=False)


def _is_number(text: str) -> bool:
    try:
        float(text.replace("–", "0").replace("∞", "inf") or "0")
    except ValueError:
        return False
    return True


def decibel(value: float) -> str:
    """Return a PSNR as people read it."""
    return "inf dB (identical)" if math.isinf(value) else f"{value:.2f} dB"


def seconds_line(seconds: Mapping[str, float]) -> str:
    """Return times per stage in one line."""
    total = sum(seconds.values())
    parts = ", ".join(f"{stage} {value:.2f}" for stage, value in seconds.items())
    return f"{total:.2f} s ({parts})"


class ProgressBar:
    """A bar on standard error, shown once the work has taken a second."""

    def __init__(self, what: str) -> None:
        self._what, self._start = what, time.monotonic()
        self._bar: Any = None
        self._task: Any = None

    def __call__(self, done: int, total: int, what: str | None = None) -> None:
        """Show that `done` of `total` is done."""
        if not sys.stderr.isatty():
            return
        if self._bar is None:
            if time.monotonic() - self._start < _PATIENCE_SECONDS:
                return
            self._open()
        self._bar.update(self._task, completed=done, total=total, description=what or self._what)

    def _open(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._bar.add_task(self._what, total=None)
        self._bar.start()

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()


@contextmanager
def progress_bar(what: str) -> Iterator[ProgressBar]:
    """Show a bar while the block runs."""
    bar = ProgressBar(what)
    try:
        yield bar
    finally:
        bar.close()
