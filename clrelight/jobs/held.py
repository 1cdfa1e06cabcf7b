"""What a process keeps for the next part of the same work: files that are open, and what was made of them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from clrelight.errors import InputError


class Held(threading.local):
    """The last thing that this thread has made, with the files that it hangs on open."""

    def __init__(self) -> None:
        self._key: object = None
        self._value: Any = None
        self._open = ExitStack()

    def get(self, key: object, make: Callable[[ExitStack], Any]) -> Any:
        """Return what `make` returns of a stack of files to close; the last thing, where the key is the same."""
        if key != self._key:
            self._key, self._value = None, None
            self._open.close()
            self._open = ExitStack()
            self._value, self._key = make(self._open), key
        return self._value


def look_of(*paths: str) -> tuple[tuple[str, int, int, int], ...]:
    """Return by what files are known as long as nobody changes them; InputError where one cannot be read."""
    try:
        known = [(path, os.stat(path)) for path in paths]
    except OSError as error:
        raise InputError(f"cannot read {os.fsdecode(error.filename)}: {error.strerror or error}") from error
    return tuple((path, each.st_ino, each.st_size, each.st_mtime_ns) for path, each in known)
