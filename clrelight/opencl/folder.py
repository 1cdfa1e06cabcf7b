"""The folder where things are kept between runs that can be made again: compiled kernels, verdicts on drivers."""

from __future__ import annotations

import functools
import logging
import os
import tempfile
from pathlib import Path

import platformdirs

CACHE_VARIABLE = "CLRELIGHT_CACHE"

LEAST_ROOM = 1 << 20
"""Bytes that a compiler's files take at least: a disk without so many takes none."""

log = logging.getLogger("clrelight")


@functools.cache
def cache_folder() -> Path | None:
    """Return the folder, which ``CLRELIGHT_CACHE`` may name; None, with one line, where it cannot be written."""
    named = os.environ.get(CACHE_VARIABLE)
    folder = Path(named) if named else platformdirs.user_cache_path("clrelight", appauthor=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(LEAST_ROOM))
        return folder
    except OSError as error:
        log.warning(
            "clrelight: %s: %s: kernels are compiled anew in every run (name another folder with %s)",
            folder,
            error.strerror or error,
            CACHE_VARIABLE,
        )
        return None


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name and rename it when whole.

    Raises
    ------
    OSError
        If that cannot be done; nothing is left behind then.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise
