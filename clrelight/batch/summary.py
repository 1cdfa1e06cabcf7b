"""The table of a batch: bytes, decibels and seconds of each stack, and why those that failed did."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from clrelight.batch.task import Outcome
from clrelight.durable import replacing

COLUMNS = ("stack", "state", "bytes", "psnr", "psnr_holdout", "seconds", "tries", "error")
"""Of the table: decibels are pooled, at the fitted lights and at those held out."""


def summary_rows(outcomes: Sequence[Outcome], kept: Collection[str] = ()) -> list[dict[str, Any]]:
    """Return a row for each stack: a mapping of `COLUMNS`, None where there is no such number."""
    rows = []
    for each in outcomes:
        state = "kept" if each.name in kept else each.state
        values = (
            *(each.name, state, each.bytes_written, each.psnr.get("pooled_fitted"), each.psnr.get("pooled_holdout")),
            *(round(each.seconds, 3), each.tries, each.error),
        )
        rows.append(dict(zip(COLUMNS, values, strict=True)))
    return rows


def summary_totals(outcomes: Sequence[Outcome], kept: Collection[str] = (), left: int = 0) -> dict[str, Any]:
    """Return the counts of a batch, all bytes, the mean PSNR, and the seconds of all workers."""
    done = [each for each in outcomes if each.is_done]
    totals: dict[str, Any] = {
        "stacks": len(outcomes) + left,
        "done": len(done),
        "kept": sum(each.name in kept for each in done),
        "failed": len(outcomes) - len(done),
        "left": left,
        "bytes": sum(each.bytes_written or 0 for each in done),
        "seconds": round(sum(each.seconds for each in outcomes), 3),
    }
    for name, key in (("psnr", "pooled_fitted"), ("psnr_holdout", "pooled_holdout")):
        known = [each.psnr[key] for each in done if math.isfinite(each.psnr.get(key, math.nan))]
        if known:
            totals[name] = sum(known) / len(known)
    return totals


def write_summary(
    folder: Path, outcomes: Sequence[Outcome], kept: Collection[str] = (), left: int = 0
) -> tuple[str, str]:
    """Write ``summary.csv`` and ``summary.json``, which holds all that is known of each stack; return their paths."""
    table = io.StringIO()
    writer = csv.DictWriter(table, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in summary_rows(outcomes, kept))
    whole = {"totals": summary_totals(outcomes, kept, left), "stacks": [each.to_json() for each in outcomes]}
    paths = folder / "summary.csv", folder / "summary.json"
    for path, text in zip(paths, (table.getvalue(), json.dumps(whole, indent=1) + "\n"), strict=True):
        with replacing(path) as part:
            part.write(text.encode("utf-8", "surrogateescape"))  # names need not be text
    return str(paths[0]), str(paths[1])


def _cell(value: Any) -> Any:
    return f"{value:.4f}" if isinstance(value, float) else "" if value is None else value
