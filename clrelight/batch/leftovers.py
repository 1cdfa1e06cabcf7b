"""What killed workers leave beside the files that they were to write; nobody else may have it."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import stat
from collections.abc import Iterable
from contextlib import suppress

from clrelight.durable import sibling_stem


def sweep(paths: Iterable[str]) -> int:
    """Remove siblings ``.NAME.part``, ``.NAME.lock`` and ``.NAME.*.part`` of files that no process has locked.

    For drivers, which hold the lock of a folder whose workers are gone. Returns how many there were.
    """
    names: dict[str, set[str]] = {}
    for path in paths:
        folder, name = os.path.split(path)
        names.setdefault(folder, set()).add(sibling_stem(name))
    return sum(_sweep_folder(folder, stems) for folder, stems in names.items())


def _sweep_folder(folder: str, stems: set[str]) -> int:
    count = 0
    with suppress(OSError):
        for entry in [*os.scandir(folder)]:
            if entry.name[0] != "." or not entry.name.endswith((".part", ".lock")):
                continue
            stem = re.sub(r"(\.[a-z0-9_]{8})?\.(part|lock)$", "", entry.name)
            if stem in stems or entry.name.rpartition(".")[0] in stems:
                count += _remove(entry)
    return count


def _remove(entry: os.DirEntry[str]) -> int:
    with suppress(OSError):
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry.path)
            return 1
        descriptor = os.open(entry.path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                return 0
            with suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(entry.path)
                return 1
        finally:
            os.close(descriptor)
    return 0
