"""What commands print: facts for people, one JSON object for machines."""

from __future__ import annotations

import json
import math
import sys
import unicodedata
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.quiet import asked_output, is_quiet

if TYPE_CHECKING:
    from clrelight.jobs.report import Report


def print_json(values: Mapping[str, Any]) -> None:
    """Print one JSON object; infinities become the strings ``inf`` and ``-inf``, NaN becomes null."""
    click.echo(json.dumps(_plain(values)), file=asked_output())


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
        return (", " if any(isinstance(v, str) for v in value) else " × ").join(str(v) for v in value) or "none"
    return f"{value:.6g}" if isinstance(value, float) else _shown(str(value))


def _shown(text: str) -> str:
    """Return a text in one line, with escapes in place of what a terminal would obey: names come from anybody."""
    return "".join(repr(c)[1:-1] if unicodedata.category(c) == "Cc" else c for c in text)


def print_notes(notes: Sequence[str]) -> None:
    """Print notes on standard error, so that they never mix with results."""
    for note in () if is_quiet() else notes:
        with suppress(OSError):  # nobody may be there to read it
            print(f"note: {note}", file=sys.stderr)  # which a bar keeps above itself; click goes past it


def make_report(as_json: bool) -> Report:
    """Return a report whose notes are printed as they arise, before long work; a JSON object holds them at its end."""
    from clrelight.jobs.report import Report

    return Report(tell=None if as_json else lambda note: print_notes([note]))


def print_report(report: Report, as_json: bool, lines: Mapping[str, Any]) -> None:
    """Print what a job told: one JSON object, or its notes that are not printed yet, some lines, and the time."""
    if as_json:
        print_json(report.to_json())
        return
    if report.tell is None:
        print_notes(report.notes)
    print_facts({**lines, **_fetched_line(report.facts), "time": seconds_line(report.seconds)})


def preview_line(facts: Mapping[str, Any]) -> dict[str, str]:
    """Return the line of a picture that was written beside a file, if one was."""
    return (
        {"preview": "{}, {}×{}".format(facts["preview"]["file"], *facts["preview"]["size"])}
        if "preview" in facts
        else {}
    )


def _fetched_line(facts: Mapping[str, Any]) -> dict[str, str]:
    if "fetched" not in facts:
        return {}
    fetched = facts["fetched"]
    return {"fetched": f"{fetched['bytes']} of {fetched['of']} bytes, in {fetched['requests']} requests"}


def decibel(value: float) -> str:
    """Return a PSNR as people read it."""
    return "inf dB (identical)" if math.isinf(value) else f"{value:.2f} dB"


def seconds_line(seconds: Mapping[str, float]) -> str:
    """Return times per stage in one line."""
    total = sum(seconds.values())
    parts = ", ".join(f"{stage} {value:.2f}" for stage, value in seconds.items())
    return f"{total:.2f} s" + (f" ({parts})" if parts else "")
