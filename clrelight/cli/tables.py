"""Tables on a terminal, and in pipes."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence

import click

Column = tuple[str, Sequence[str]]

_GAP = "  "


def print_table(headers: Sequence[str], rows: Sequence[Sequence[str]], expendable: Sequence[str] = ()) -> None:
    """Print a table; numbers are aligned to the right.

    On a terminal that is too narrow headers are wrapped; if that is not enough, what all rows share moves to a line
    below, and then columns are left out and named there: the `expendable` ones in this order, then from the right. A
    pipe has no width and gets everything.
    """
    cells = zip(*rows, strict=True) if rows else [()] * len(headers)
    columns: list[Column] = list(zip(headers, cells, strict=True))
    lines = _lines(columns, wrap=False)
    below: list[str] = []
    width = shutil.get_terminal_size().columns
    if sys.stdout.isatty() and len(lines[0]) > width:
        if _narrowest(columns) > width and len(rows) > 1:
            shared = [f"{name} {cells[0]}" for name, cells in columns if len(set(cells)) == 1]
            columns = [column for column in columns if len(set(column[1])) > 1]
            below += ["all rows: " + ", ".join(shared)] if shared else []
        dropped: list[str] = []
        while _narrowest(columns) > width and len(columns) > 1:
            names = [name for name, _ in columns]
            dropped.append(next((name for name in expendable if name in names), names[-1]))
            columns = [column for column in columns if column[0] != dropped[-1]]
        below += [f"not shown for lack of room: {'; '.join(dropped)}"] if dropped else []
        lines = _lines(columns, wrap=True)
    for line in [*lines, *below]:
        click.echo(line.rstrip())


def _lines(columns: Sequence[Column], *, wrap: bool) -> list[str]:
    headers = [_wrapped(*column) if wrap else [column[0]] for column in columns]
    height = max(map(len, headers), default=0)
    blocks = []
    for header, (_, cells) in zip(headers, columns, strict=True):
        width = max(map(len, [*header, *cells]))
        pad = str.rjust if all(map(_is_number, cells)) else str.ljust
        # Headers stand on the rule.
        block = [*[""] * (height - len(header)), *header, "─" * width, *cells]
        blocks.append([pad(text, width) for text in block])
    return [_GAP.join(parts) for parts in zip(*blocks, strict=True)]


def _narrowest(columns: Sequence[Column]) -> int:
    """Return the width of the table with wrapped headers."""
    return len(_lines(columns, wrap=True)[0])


def _wrapped(header: str, cells: Sequence[str]) -> list[str]:
    """Return the header in lines that are no wider than the cells, or than its longest word."""
    words = header.split()
    width = max(map(len, [*words, *cells]))
    lines = words[:1]
    for word in words[1:]:
        if len(lines[-1]) + 1 + len(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def _is_number(text: str) -> bool:
    try:
        float(text.replace("–", "0").replace("∞", "inf") or "0")
    except ValueError:
        return False
    return True
