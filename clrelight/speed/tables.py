"""The measured rows as text: cells, and Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from clrelight.speed.stage import Row
from clrelight.speed.timing import Quartiles

HEADERS = (
    *("stage", "beside", "ms", "peer ms", "speed", "goal", "GFLOP/s (of peak)"),
    *("first s", "error", "peer's", "error is the"),
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


def markdown_table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(headers) + " |", "|" + "---|" * len(headers)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])
