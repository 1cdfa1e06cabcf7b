"""What a growth has measured, as a JSON file: written whole, or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clrelight.durable import check_output, replacing
from clrelight.errors import InputError
from clrelight.speed.job import OURS, STAGES, TOTAL

SCHEMA = "speed/1"
SUFFIX = ".json"

# What a record must hold to be drawn: a type, an object's members, a list's items, or a tuple's.
_NUMBER = int | float
_QUARTILES = (_NUMBER, _NUMBER, _NUMBER)
_PLACE = {"size": int, "lights": int, "degree": int, "threads": int | None}
_STAGE = {
    **dict.fromkeys(("name", "peer", "error_unit"), str),
    **dict.fromkeys(("first_seconds", "error"), _NUMBER),
    **dict.fromkeys(("goal", "gigaflops", "peak_share", "peer_error"), _NUMBER | None),
    **dict.fromkeys(("our_seconds", "peer_seconds", "speed"), _QUARTILES),
    "rounds": int,
}
_RECORD = {
    "environment": {},
    "stages": [_STAGE],
    "notes": [str],
    "base": _PLACE,
    "axes": {axis: [int] for axis in _PLACE},
    "points": [_PLACE],
}
_BY_WAY = ("seconds", "memory", "psnr")
_FILES = dict.fromkeys(("stack", "fit", "encoded"), _NUMBER)
_TIMES = dict.fromkeys((*STAGES, TOTAL), _QUARTILES)


def check_record(path: str | os.PathLike[str]) -> None:
    """Raise InputError if `path` cannot take a record as it looks now."""
    if Path(path).suffix.lower() != SUFFIX:
        raise InputError(f"what --speed measures is kept as JSON: --out must end in {SUFFIX}, got {os.fspath(path)}")
    check_output(path)


def write_record(path: str | os.PathLike[str], record: Mapping[str, Any]) -> None:
    """Write what `measure_growth` returned; InputError if that cannot be written."""
    text = json.dumps({"clrelight_schema": SCHEMA, **record}, indent=1, ensure_ascii=False) + "\n"
    with replacing(path) as part:
        part.write(text.encode("utf-8"))


def read_record(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return a record; InputError if the file is none."""
    try:
        record: dict[str, Any] = json.loads(Path(path).read_text(encoding="utf-8"))
        schema = record["clrelight_schema"]
    except FileNotFoundError:
        raise InputError(f"there is no file {os.fspath(path)}") from None
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{os.fspath(path)} is no record of clrelight bench --speed") from None
    if schema != SCHEMA:
        raise InputError(f"{os.fspath(path)} is {schema}, expected {SCHEMA}")
    misfit = _misfit(record, _RECORD) or next(filter(None, map(_point_misfit, record["points"])), None)
    if misfit is not None:
        raise InputError(f"{os.fspath(path)} is no whole record of clrelight bench --speed: {misfit}")
    return record


def _point_misfit(point: Mapping[str, Any]) -> str | None:
    """Say what keeps a point, whose place is known, from being drawn; None if nothing does."""
    if "note" in point:
        return _misfit(point, {"note": str}, "a point")
    ways = sorted({OURS}.union(*(point[name] for name in _BY_WAY if isinstance(point.get(name), dict))))
    form: dict[str, Any] = {"rounds": int, "seconds": dict.fromkeys(ways, _TIMES), "bytes": _FILES}
    form |= {name: dict.fromkeys(ways, _NUMBER) for name in _BY_WAY[1:]}
    if "speed" in point:
        form["speed"] = {TOTAL: _QUARTILES}
    return _misfit(point, form, "a point")


def _misfit(value: Any, form: Any, name: str = "the file") -> str | None:
    """Say where a value is not of a form, or return None."""
    if isinstance(form, dict):
        if not isinstance(value, dict):
            return f"{name} is no object"
        missing = next((key for key in form if key not in value), None)
        if missing is not None:
            return f"{name} has no {missing}"
        inner = [(value[key], part, key) for key, part in form.items()]
    elif isinstance(form, list | tuple):
        if not isinstance(value, list) or (isinstance(form, tuple) and len(value) != len(form)):
            return f"{name} is no list" + (f" of {len(form)}" if isinstance(form, tuple) else "")
        parts = form if isinstance(form, tuple) else form * len(value)
        inner = [(item, part, f"an item of {name}") for item, part in zip(value, parts, strict=True)]
    else:
        return None if isinstance(value, form) else f"{name} is {value!r}, not what it must be"
    return next(filter(None, (_misfit(*each) for each in inner)), None)
