"""Reading whole files of others."""

from __future__ import annotations

import os
from pathlib import Path

from clrelight.errors import InputError

MOST_NUMBER = 1e9
"""Beyond which scales, biases and bases of such files make no sense, and their products would leave float32."""


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return a file's content; InputError where it cannot be read."""
    name = Path(os.fsdecode(path))
    try:
        return name.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {name}: {error.strerror or error}") from None


def read_start(path: str | os.PathLike[str], count: int) -> tuple[bytes, int]:
    """Return the first bytes of a file, and how many it has; InputError where it cannot be read."""
    name = Path(os.fsdecode(path))
    try:
        with open(name, "rb") as file:
            return file.read(count), os.fstat(file.fileno()).st_size
    except OSError as error:
        raise InputError(f"cannot read {name}: {error.strerror or error}") from None
