"""A page of tables, charts and pictures in one file, which asks nothing of the network and trusts no name."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

from clrelight.report.markup import column_strings, to_csv
from clrelight.report.tables import Table

_LONGEST_WORD = 16
"""Characters of a table's words that a sheet of paper has room for; longer ones are broken on it."""
_MOST_COLUMNS = 12
"""Of tables that are printed upright."""


@dataclass(frozen=True)
class Section:
    """A part of a page.

    Attributes
    ----------
    heading : str
    level : int
        2 or 3.
    notes : tuple of str
        Paragraphs before the content, plain text.
    body : str
        HTML.
    """

    heading: str
    level: int
    notes: tuple[str, ...] = ()
    body: str = ""


def plain(text: str) -> str:
    """Return text that HTML shows as it is, also in an attribute; what turns lines around or is no sign is marked."""
    seen = " ".join(text.split())
    marked = "".join("\N{REPLACEMENT CHARACTER}" if unicodedata.category(c) in ("Cc", "Cf", "Cs") else c for c in seen)
    return escape(marked, quote=True)


def page(title: str, facts: Sequence[tuple[str, str]], sections: Sequence[Section]) -> str:
    """Return a whole page.

    Parameters
    ----------
    title : str
    facts : sequence of (name, text)
        What was measured, and on what.
    sections : sequence of Section
        In reading order; those of level 2 are its chapters.
    """
    style, script = (_asset(f"report.{kind}") for kind in ("css", "js"))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    told = "".join(f"<dt>{plain(name)}</dt><dd>{plain(text)}</dd>" for name, text in facts)
    lines = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{plain(title)}</title>",
        f"<style>{style}</style>",
        "</head>",
        "<body>",
        '<a class="skip" href="#content">Skip to the content</a>',
        f'<header><h1>{plain(title)}</h1><dl class="facts">{told}</dl></header>',
        f'<nav aria-label="Contents"><h2>Contents</h2>{_contents(sections)}</nav>',
        '<main id="content">',
        *(_section(section, i) for i, section in enumerate(sections)),
        "</main>",
        f"<script>{script}</script>",
        "</body>",
        "</html>",
    ]
    return "\n".join(lines) + "\n"


def _asset(name: str) -> str:
    return (files("clrelight.report") / "assets" / name).read_text(encoding="utf-8")


def _contents(sections: Sequence[Section]) -> str:
    """Return links to all sections, those of level 3 below their chapter."""
    lists: list[list[str]] = []
    for i, section in enumerate(sections):
        link = f'<a href="#part-{i}">{plain(section.heading)}</a>'
        if section.level == 2 or not lists:
            lists.append([link])
        else:
            lists[-1].append(f"<li>{link}</li>")
    return "".join(f"<p>{first}</p><ul>{''.join(rest)}</ul>" if rest else f"<p>{first}</p>" for first, *rest in lists)


def _section(section: Section, number: int) -> str:
    head = f'<h{section.level} id="part-{number}">{plain(section.heading)}</h{section.level}>'
    return "\n".join([head, *(f'<p class="how">{plain(note)}</p>' for note in section.notes), section.body])


def table_html(table: Table, *, file: str = "") -> str:
    """Return a table that sorts by a click on a heading; `file` names the CSV that a link below it saves."""
    shown = table.measured()
    heads, columns = [], []
    for column in shown.columns:
        values = shown.values(column.key)
        words = any(isinstance(value, str) for value in values)
        mark = ' class="words"' if words else ""
        heads.append(f'<th scope="col"{mark}><button type="button">{plain(column.title)}</button></th>')
        strings = column_strings(column, values)
        if any(len(word) > _LONGEST_WORD for string in strings for word in string.split()):
            mark = ' class="words long"'
        cells = zip(strings, values, strict=True)
        columns.append([f'<td{mark} data-value="{_sorted_by(value)}">{plain(string)}</td>' for string, value in cells])
    rows = "\n".join(f"<tr>{''.join(row)}</tr>" for row in zip(*columns, strict=True))
    caption = plain(shown.caption)
    link = f'<p class="downloads">{data_link(file, "text/csv", to_csv(table).encode())}</p>' if file else ""
    scroll = "scroll wide" if len(heads) > _MOST_COLUMNS else "scroll"
    return (
        f'<div class="{scroll}" role="region" tabindex="0" aria-label="{caption}">\n<table class="sortable">'
        f"<caption>{caption}</caption>\n<thead><tr>{''.join(heads)}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>"
        f"\n{link}"
    )


def _sorted_by(value: str | int | float) -> str:
    if isinstance(value, str):
        return plain(value)
    if isinstance(value, float) and not math.isfinite(value):
        return "" if math.isnan(value) else f"{'-' * (value < 0)}Infinity"
    return repr(value)


def data_uri(kind: str, content: bytes) -> str:
    """Return an address that holds its content."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def data_link(name: str, kind: str, content: bytes) -> str:
    """Return a link that saves a file."""
    return f'<a download="{plain(name)}" href="{data_uri(kind, content)}">{plain(name)}</a>'


def image_html(png: bytes, alt: str) -> str:
    """Return a picture."""
    return f'<figure><img src="{data_uri("image/png", png)}" alt="{plain(alt)}"></figure>'


def list_html(items: Iterable[str]) -> str:
    """Return a list of plain lines."""
    return f"<ul>{''.join(f'<li>{plain(item)}</li>' for item in items)}</ul>"


def json_block(values: Any) -> str:
    """Return values for a script to parse; no text within ends the element."""
    text = json.dumps(values, separators=(",", ":")).replace("<", "\\u003c").replace(">", "\\u003e")
    return f'<script type="application/json">{text}</script>'
