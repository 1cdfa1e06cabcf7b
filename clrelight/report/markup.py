"""Tables as Markdown, CSV, LaTeX, and as strings for a terminal."""

from __future__ import annotations

import csv
import io
import math
import re

from clrelight.report.tables import Cell, Column, Table, summary
from clrelight.results import Results

SCIENTIFIC_FROM = 1e7
"""A column with a larger number than this shows all of its numbers with an exponent."""

_TEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    **{c: "\\" + c for c in "&%$#_{}"},
}


def escape_tex(text: str) -> str:
    """Return text with everything that LaTeX would read as a command made harmless."""
    return "".join(_TEX.get(c, c) for c in " ".join(text.split()))


def escape_markdown(text: str) -> str:
    """Return text that Markdown shows as it is, also within a table cell."""
    escaped = re.sub(r"([\\`*_\[\]|#~])", r"\\\1", " ".join(text.split()))
    return escaped.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def column_strings(column: Column, values: list[Cell]) -> list[str]:
    """Return a column's numbers with equal decimals (so that right-aligned points line up), ∞, and – for NaN."""
    numbers = [abs(v) for v in values if isinstance(v, float) and math.isfinite(v)]
    pattern = f".{column.digits}{'e' if max(numbers, default=0.0) >= SCIENTIFIC_FROM else 'f'}"
    strings = []
    for value in values:
        if not isinstance(value, float):
            strings.append(str(value))
        elif math.isnan(value):
            strings.append("–")
        elif math.isinf(value):
            strings.append("∞" if value > 0 else "-∞")
        else:
            strings.append(format(value, pattern))
    return strings


def _columns(table: Table) -> list[tuple[Column, list[str], bool]]:
    """Return per column: itself, its strings, and whether it holds words (left-aligned) or numbers."""
    columns = []
    for column in table.columns:
        values = table.values(column.key)
        columns.append((column, column_strings(column, values), any(isinstance(v, str) for v in values)))
    return columns


def to_strings(table: Table) -> tuple[list[str], list[list[str]]]:
    """Return headers and rows as unescaped strings, for a terminal."""
    columns = _columns(table)
    return [c.title for c, _, _ in columns], [list(row) for row in zip(*(s for _, s, _ in columns), strict=True)]


def summary_rows(results: Results) -> tuple[list[str], list[list[str]]]:
    """Return headers and rows of a table for a terminal: the essential columns of every row."""
    return to_strings(summary(results))


def to_markdown(table: Table) -> str:
    """Return a GitHub-flavoured table whose source is aligned too."""
    lines: list[list[str]] = [[] for _ in range(len(table.rows) + 2)]
    for column, strings, words in _columns(table):
        cells = [escape_markdown(column.title), *map(escape_markdown, strings)]
        width = max(map(len, cells))
        cells = [cell.ljust(width) if words else cell.rjust(width) for cell in cells]
        rule = ":" + "-" * (width - 1) if words else "-" * (width - 1) + ":"
        for line, cell in zip(lines, [cells[0], rule, *cells[1:]], strict=True):
            line.append(cell)
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def to_csv(table: Table) -> str:
    """Return comma-separated values with every digit; ``inf`` as such, NaN as an empty field."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(column.key for column in table.columns)
    for row in table.rows:
        writer.writerow("" if isinstance(v, float) and math.isnan(v) else v for v in row)
    return stream.getvalue()


def _tex_cell(string: str, words: bool) -> str:
    if words:
        return escape_tex(string)
    if string == "–":
        return "--"
    if "∞" in string:
        return "$" + string.replace("∞", r"\infty") + "$"
    exponent = re.fullmatch(r"(-?[\d.]+)e([+-]\d+)", string)
    return rf"${exponent[1]}\cdot10^{{{int(exponent[2])}}}$" if exponent else string


def to_latex(table: Table) -> str:
    r"""Return a bare ``tabular`` to ``\input``; it needs the package booktabs."""
    columns = _columns(table)
    header = [column.tex or escape_tex(column.title) for column, _, _ in columns]
    cells = [[_tex_cell(string, words) for string in strings] for _, strings, words in columns]
    body = [f"{' & '.join(row)} \\\\" for row in zip(*cells, strict=True)]
    lines = [
        f"% {' '.join(table.caption.split())}",
        r"% needs \usepackage{booktabs}",
        rf"\begin{{tabular}}{{{''.join('l' if words else 'r' for _, _, words in columns)}}}",
        r"\toprule",
        f"{' & '.join(header)} \\\\",
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"
