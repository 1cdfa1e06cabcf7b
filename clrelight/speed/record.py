"""What a growth has measured, as a JSON file: written whole, or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clrelight.errors import InputError
from clrelight.store.durable import check_output, replacing

SCHEMA = "speed/1"
SUFFIX = ".json"


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
    return record
