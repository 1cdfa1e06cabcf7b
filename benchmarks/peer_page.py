"""The tables of the benchmark of coding peers, and what they say in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from benchmarks.peer_search import CODING, HELD_OUT, SEEN, Point
from benchmarks.peer_ways import KLT, Measurement, Row
from clrelight.speed.tables import markdown_table

SUMMARY_HEADERS = ("way", "equal", "cases", "bytes / klt, median", "least", "most", "encode s / klt", "decode s / klt")


def _ways(rows: Sequence[Row]) -> list[tuple[str, str]]:
    return list(dict.fromkeys((row.way, row.equal) for row in rows))


def _klt_of(rows: Sequence[Row]) -> dict[tuple[str, float], Row]:
    return {(row.stack, row.rate): row for row in rows if row.way == KLT}


def summary_rows(rows: Sequence[Row]) -> list[list[str]]:
    """Return a row for each way: the bytes that it takes beside klt at equal PSNR, and its seconds."""
    klt, table = _klt_of(rows), []
    for way, equal in _ways(rows):
        if way == KLT:
            continue
        these = [row for row in rows if (row.way, row.equal) == (way, equal)]
        ratios = [row.ratio for row in these]
        encode, decode = (
            [
                getattr(row.point, name) / max(getattr(klt[row.stack, row.rate].point, name), 1e-9)
                for row in these
                if (row.stack, row.rate) in klt
            ]
            for name in ("encode_seconds", "decode_seconds")
        )
        missed = sum(not row.reached for row in these)
        cases = f"{len(these)}" + (f", {missed} †" if missed else "")
        table.append(
            [way, equal, cases, *(f"{f(ratios):.2f}" for f in (median, min, max)), _ratio(encode), _ratio(decode)]
        )
    return table


def stack_headers(rates: Sequence[float]) -> list[str]:
    """Return the headers of `stack_rows`."""
    return ["stack", "way", "equal", *(f"{rate:g} bit" for rate in rates)]


def stack_rows(rows: Sequence[Row], rates: Sequence[float]) -> list[list[str]]:
    """Return a row for each stack and way: kB, times klt's, decibel and seconds at each rate."""
    table = []
    for stack in dict.fromkeys(row.stack for row in rows):
        here = [row for row in rows if row.stack == stack]
        for way, equal in _ways(here):
            by_rate = {row.rate: row for row in here if (row.way, row.equal) == (way, equal)}
            cells = [_cell(by_rate[rate]) if rate in by_rate else "–" for rate in rates]
            table.append([stack, f"**{way}**" if way == KLT else way, "" if way == KLT else equal, *cells])
    return table


def _cell(row: Row) -> str:
    size = f"{_digits(row.byte_count / 1000.0)} kB"
    if row.way == KLT:
        decibel = " / ".join(f"{row.point.psnr[name]:.2f}" for name in (CODING, HELD_OUT, SEEN))
        return f"{size}, {decibel} dB, {seconds(row.point)}"
    at = "" if row.reached else f" † at {row.psnr:.2f} dB"
    return f"{size}, {row.ratio:.2f} ×{at}, {seconds(row.point)}"


def seconds(point: Point) -> str:
    """Return seconds to encode and to decode, a dash where they are not known apart."""
    return f"{_digits(point.encode_seconds)} / {_digits(point.decode_seconds)} s"


def _ratio(values: Sequence[float]) -> str:
    known = [value for value in values if not math.isnan(value)]
    return f"{median(known):.2f}" if known else "–"


def _digits(value: float) -> str:
    if math.isnan(value):
        return "–"
    return f"{value:.0f}" if value >= 100.0 else f"{value:.1f}" if value >= 1.0 else f"{value:.3f}"


def where_behind(rows: Sequence[Row]) -> str:
    """Return a sentence of where klt does not lead on bytes, and one of where it does not on seconds."""
    peers = [row for row in rows if row.way != KLT]
    behind = []
    for way, equal in _ways(peers):
        these = [row for row in peers if (row.way, row.equal) == (way, equal)]
        lost = [row for row in these if row.ratio < 1.0]
        if lost:
            worst = min(lost, key=lambda row: row.ratio)
            place = f"{worst.stack} at {worst.rate:g} bit, {worst.ratio:.2f} ×"
            behind.append(f"{way} ({equal}) in {len(lost)} of {len(these)} cases, at worst {place}")
    least = (
        f"klt does not take the fewest bytes beside {'; '.join(behind)}." if behind else "klt takes the fewest bytes."
    )
    table = {row[0]: row for row in summary_rows(rows)}
    encode, decode = (
        [way for way, row in table.items() if row[column] != "–" and float(row[column]) < 1.0] for column in (6, 7)
    )
    return f"{least} In the median {_list(encode, table)} encode in less time, and {_list(decode, table)} decode."


def _list(ways: Sequence[str], known: Mapping[str, Any]) -> str:
    """Return names, by those that are absent where these are fewer."""
    others = [way for way in known if way not in ways]
    if len(ways) <= len(others):
        return ", ".join(ways) or "none"
    return f"all but {', '.join(others)}" if others else "all"


def to_page(measurement: Measurement, facts: Mapping[str, str], rates: Sequence[float]) -> str:
    """Return what stands between the markers."""
    rows = measurement.rows
    lines = [f"- {name}: {facts[name]}" for name in ("measured", "commit", "machine", "threads", "load", "device")]
    lines += [f"- left out: {name}: {why}" for name, why in measurement.left_out.items()]
    parts = [
        "\n".join(lines),
        markdown_table(SUMMARY_HEADERS, summary_rows(rows)),
        where_behind(rows),
        markdown_table(stack_headers(rates), stack_rows(rows, rates)),
    ]
    return "\n\n".join(parts)


def to_json(measurement: Measurement, facts: Mapping[str, str]) -> dict[str, Any]:
    """Return everything as JSON has it."""
    rows = [
        {
            **{name: getattr(row, name) for name in ("stack", "way", "rate", "equal", "psnr", "reached", "byte_count")},
            "klt_bytes": row.klt_bytes,
            "setting": row.point.setting,
            "psnr_of_setting": dict(row.point.psnr),
            "encode_seconds": row.point.encode_seconds,
            "decode_seconds": None if math.isnan(row.point.decode_seconds) else row.point.decode_seconds,
        }
        for row in measurement.rows
    ]
    return {"environment": dict(facts), "rows": rows, "left_out": dict(measurement.left_out)}
