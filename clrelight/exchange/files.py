"""Reading whole files of others."""

from __future__ import annotations

import os
from pathlib import Path

from clrelight.errors import InputError


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return a file's content; InputError where it cannot be read."""
    name = Path(os.fsdecode(path))
    try:
        return name.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {name}: {error.strerror or error}") from None
