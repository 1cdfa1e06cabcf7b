"""What benchmarks write: blocks of the pages in docs/, and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from clrelight.errors import InputError
from clrelight.speed.stage import Row
from clrelight.speed.tables import HEADERS, cells, markdown_table

BEGIN, END = "<!-- stages -->", "<!-- /stages -->"


def to_markdown(rows: Sequence[Row], facts: Mapping[str, str]) -> str:
    """Return the facts as a list and the rows as a table."""
    lines = [f"- {name}: {value}" for name, value in facts.items()]
    return "\n".join([*lines, "", markdown_table(HEADERS, [cells(row) for row in rows])])


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
