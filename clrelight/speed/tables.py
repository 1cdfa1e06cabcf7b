"""The measured rows as text: cells, a Markdown block, JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from clrelight.errors import InputError
from clrelight.speed.stage import Row
from clrelight.speed.timing import Quartiles

BEGIN, END = "<!-- stages -->", "<!-- /stages -->"

HEADERS = (
    "stage",
    "beside",
    "ms",
    "peer ms",
    "speed",
    "goal",
    "GFLOP/s (of peak)",
    "first s",
    "error",
    "peer's",
    "error is the",
)
EXPENDABLE = ("first s", "peer ms", "peer's")
"""What a narrow terminal may leave out, first to last."""
_NONE = "–"


def cells(row: Row) -> list[str]:
    """Return the cells of a row; medians with quartiles in brackets."""
    met = "" if row.goal is None else " ✓" if row.speed[1] >= row.goal else " ✗"
    return [
        row.name,
        row.peer,
        spread(row.our_seconds, 1e3),
        spread(row.peer_seconds, 1e3),
        spread(row.speed),
        _NONE if row.goal is None else f"{row.goal:.2f}{met}",
        _NONE if row.gigaflops is None else f"{row.gigaflops:.0f} ({row.peak_share:.0%})",
        f"{row.first_seconds:.2f}",
        f"{row.error:.1e}",
        _NONE if row.peer_error is None else f"{row.peer_error:.1e}",
        row.error_unit,
    ]


def spread(values: Quartiles, factor: float = 1.0) -> str:
    """Return a median with its quartiles in brackets, three digits each; no brackets where there was but one value."""
    low, middle, high = (f"{factor * value:#.3g}".rstrip(".") for value in values)
    return middle if values[0] == values[2] else f"{middle} ({low}–{high})"


def to_markdown(rows: Sequence[Row], facts: Mapping[str, str]) -> str:
    """Return the facts as a list and the rows as a table."""
    lines = [f"- {name}: {value}" for name, value in facts.items()]
    return "\n".join([*lines, "", markdown_table(HEADERS, [cells(row) for row in rows])])


def markdown_table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(headers) + " |", "|" + "---|" * len(headers)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def check_markdown(path: Path, begin: str = BEGIN, end: str = END) -> None:
    """Raise InputError unless a file has the two markers, once each and in order."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; it must exist and hold the lines {begin} and {end}")
    text = path.read_text(encoding="utf-8")
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise InputError(f"{path}: expected the lines {begin} and {end}, once each and in this order")


def replace_block(path: Path, block: str, begin: str = BEGIN, end: str = END) -> None:
    """Replace what stands between the markers of a file; InputError where it has none."""
    check_markdown(path, begin, end)
    text = path.read_text(encoding="utf-8")
    before, after = text[: text.index(begin)], text[text.index(end) :]
    path.write_text(f"{before}{begin}\n{block}\n{after}", encoding="utf-8")


def to_json(rows: Sequence[Row], facts: Mapping[str, str]) -> str:
    """Return facts and rows as a JSON object; times are [lower quartile, median, upper quartile] in seconds."""
    return json.dumps({"environment": dict(facts), "rows": [asdict(row) for row in rows]}, indent=1) + "\n"
