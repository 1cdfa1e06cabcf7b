"""Rows as text; see `clrelight.speed.tables`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import click

from clrelight.cli.tables import print_table
from clrelight.speed.tables import (
    EXPENDABLE,
    HEADERS,
    cells,
    check_markdown,
    replace_block,
    to_json,
    to_markdown,
)

__all__ = ["EXPENDABLE", "HEADERS", "cells", "check_markdown", "replace_block", "show_parts", "to_json", "to_markdown"]


def show_parts(parts: Mapping[str, tuple[list[str], list[list[str]]]], markdown: Path | None) -> None:
    """Print tables, headers and rows by name, and put them between the markers of their names in a page if given."""
    for headers, rows in parts.values():
        click.echo()
        print_table(headers, rows)
    for name, (headers, rows) in parts.items() if markdown is not None else ():
        lines = ["| " + " | ".join(headers) + " |", "|" + "---|" * len(headers)]
        lines += ["| " + " | ".join(row) + " |" for row in rows]
        replace_block(markdown, "\n".join(lines), f"<!-- {name} -->", f"<!-- /{name} -->")
