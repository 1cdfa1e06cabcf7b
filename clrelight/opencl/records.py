"""Small records of what was found out about drivers, each sealed with a digest; a damaged one counts as absent."""

from __future__ import annotations

import hashlib
import json
import time
from contextlib import suppress
from pathlib import Path

from clrelight.opencl.folder import cache_folder, write_whole

_TRUST_SECONDS = 86400.0
"""A fault is believed for so long: the driver may have been short of something."""


def read_record(kind: str, key: str) -> dict | None:
    """Return what was kept under this key; None where nothing was, or a fault long ago."""
    path = _path(kind, key)
    if path is None:
        return None
    try:
        kept = json.loads(path.read_bytes())
        if kept["digest"] != _digest(kept["record"], kept["seconds"]):
            return None
        # One from the future is of a clock that was set back, and no younger than any other.
        old = not 0 <= time.time() - kept["seconds"] <= _TRUST_SECONDS
        return None if kept["record"]["fault"] and old else kept["record"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_record(kind: str, key: str, record: dict) -> None:
    """Keep a record, whose ``fault`` is empty where all is well; where nothing can be kept, the next run asks again."""
    path, now = _path(kind, key), time.time()
    if path is not None:
        with suppress(OSError):
            kept = {"record": record, "seconds": now, "digest": _digest(record, now)}
            write_whole(path, json.dumps(kept).encode())


def _path(kind: str, key: str) -> Path | None:
    folder = cache_folder()
    return None if folder is None else folder / kind / f"{hashlib.sha256(key.encode()).hexdigest()[:40]}.json"


def _digest(record: dict, seconds: float) -> str:
    return hashlib.sha256(json.dumps([record, seconds], sort_keys=True).encode()).hexdigest()
