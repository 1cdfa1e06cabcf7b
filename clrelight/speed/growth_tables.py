"""A record of `bench --speed` as tables: points in rows, for people and for machines."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from clrelight.speed.job import NUMPY, OURS, STAGES, TOTAL
from clrelight.speed.stage import Row
from clrelight.speed.tables import cells, markdown_table, spread

HEADERS = (
    "pixels",
    "lights",
    "degree",
    "threads",
    *(f"{stage} s" for stage in STAGES),
    "total s",
    "NumPy total s",
    "speed",
    "MB",
    "NumPy MB",
    "PSNR (dB)",
    "NumPy's",
)
EXPENDABLE = ("NumPy's", "NumPy MB", *(f"{stage} s" for stage in STAGES))
"""What a narrow terminal may leave out, first to last."""
STAGE_HEADERS = ("stage", "beside", "ms", "peer ms", "speed", "error", "peer's", "error is the")

_NONE = "–"
_AXES = ("size", "lights", "degree", "threads")


def point_cells(point: Mapping[str, Any]) -> list[str]:
    """Return the cells of a point; medians, with quartiles in brackets for the whole job."""
    place = [f"{point['size']}²", str(point["lights"]), str(point["degree"]), str(point["threads"] or "all")]
    if "note" in point:
        return [*place, *[_NONE] * (len(HEADERS) - len(place) - 1), point["note"]]
    seconds, memory, psnr = point["seconds"], point["memory"], point["psnr"]
    return [
        *place,
        *(spread((seconds[OURS][stage][1],) * 3) for stage in STAGES),
        spread(seconds[OURS][TOTAL]),
        spread(seconds[NUMPY][TOTAL]) if NUMPY in seconds else _NONE,
        spread(point["speed"][TOTAL]) if "speed" in point else _NONE,
        f"{memory[OURS] / 1e6:.0f}",
        f"{memory[NUMPY] / 1e6:.0f}" if NUMPY in memory else _NONE,
        f"{psnr[OURS]:.2f}",
        f"{psnr[NUMPY]:.2f}" if NUMPY in psnr else _NONE,
    ]


def stage_cells(row: Mapping[str, Any]) -> list[str]:
    """Return the cells of a stage beside another library."""
    name, peer, ours, theirs, speed, _, _, _, error, peer_error, unit = cells(
        Row(**{field.name: row[field.name] for field in fields(Row)})
    )
    return [name, peer, ours, theirs, speed, error, peer_error, unit]


def stages_markdown(record: Mapping[str, Any]) -> str:
    """Return the stages beside other libraries as Markdown, with a note for each library that is missing."""
    table = markdown_table(STAGE_HEADERS, [stage_cells(row) for row in record["stages"]])
    return "\n".join([table, *(f"\n{note}" for note in record["notes"])])


def points_markdown(record: Mapping[str, Any]) -> str:
    """Return all points as Markdown."""
    return markdown_table(HEADERS, [point_cells(point) for point in record["points"]])


def points_csv(record: Mapping[str, Any]) -> str:
    """Return all points as comma-separated values, every quartile with every digit; empty where not measured."""
    columns = [*_AXES, "rounds"]
    columns += [
        f"{way}_{stage}_seconds_{name}"
        for way in (OURS, NUMPY)
        for stage in (*STAGES, TOTAL)
        for name in ("low", "median", "high")
    ]
    columns += [f"{way}_{what}" for way in (OURS, NUMPY) for what in ("memory_bytes", "psnr")]
    columns += ["stack_bytes", "fit_bytes", "encoded_bytes", "note"]
    rows = [[_flat(point).get(column, "") for column in columns] for point in record["points"]]
    return _csv(columns, rows)


def stages_csv(record: Mapping[str, Any]) -> str:
    """Return the stages beside other libraries as comma-separated values, medians with every digit."""
    columns = ("name", "peer", "rounds", "seconds", "peer_seconds", "speed", "error", "peer_error", "error_unit")
    rows = [
        (
            *(row[key] for key in ("name", "peer", "rounds")),
            *(row[key][1] for key in ("our_seconds", "peer_seconds", "speed")),
            *(row[key] for key in ("error", "peer_error", "error_unit")),
        )
        for row in record["stages"]
    ]
    return _csv(columns, rows)


def _flat(point: Mapping[str, Any]) -> dict[str, Any]:
    values = {key: point[key] for key in (*_AXES, "rounds", "note") if key in point}
    for way, stages in point.get("seconds", {}).items():
        for stage, quartiles in stages.items():
            for name, value in zip(("low", "median", "high"), quartiles, strict=True):
                values[f"{way}_{stage}_seconds_{name}"] = value
        values[f"{way}_memory_bytes"], values[f"{way}_psnr"] = point["memory"][way], point["psnr"][way]
    values.update({f"{name}_bytes": count for name, count in point.get("bytes", {}).items()})
    return values


def _csv(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows([columns, *rows])
    return stream.getvalue()
