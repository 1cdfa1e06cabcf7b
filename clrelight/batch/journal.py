"""What became of each stack, one line of JSON after the other, flushed to the disk line by line.

The driver alone writes it. A line begins with a checksum of the rest: one that a kill or a power cut has torn, or that
a disk has damaged, counts for nothing, and its stack is done again.
"""

from __future__ import annotations

import fcntl
import json
import os
import stat
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import xxhash

from clrelight.batch.task import Outcome
from clrelight.durable import naming
from clrelight.errors import InputError

FORMAT = "clrelight-batch/1"
_SUM = b'{"sum":"'
_FIRST_BYTES = 1 << 16
"""Among which a line of a journal is: they have a kilobyte or two."""
_FILES = ("inputs", "outputs")
"""Of outcomes: names of files, which stand in the journal as they are from its folder."""
_WAIT_SECONDS = 10.0
"""For the workers of a driver that was killed, which see its end and end themselves."""


class Journal:
    """A journal that is open for one driver.

    Parameters
    ----------
    path : path
        The file, made where it is not there.
    anew : bool
        Forget what it holds.

    Attributes
    ----------
    outcomes : dict of str to Outcome
        The last of each stack.
    damaged : int
        Lines that count for nothing.
    descriptor : int
        Holds the lock; workers inherit it, so that no second driver begins while one of them still writes.

    Raises
    ------
    InputError
        If another driver has it, it is another kind of file, or the system refuses.
    """

    def __init__(self, path: str | os.PathLike[str], *, anew: bool = False) -> None:
        self.path = Path(os.fsdecode(path))
        self.outcomes: dict[str, Outcome] = {}
        self.damaged = 0
        with naming(self.path):
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
            self.descriptor = os.open(self.path, flags, 0o666)
        try:
            with naming(self.path):
                if not stat.S_ISREG(os.fstat(self.descriptor).st_mode):
                    raise InputError(f"cannot write {self.path}: it is there and is no regular file")
                self._lock()
                if anew:
                    os.ftruncate(self.descriptor, 0)
                self._read()
                if not os.fstat(self.descriptor).st_size:
                    self._append({"format": FORMAT})
        except BaseException:
            self.close()
            raise

    def begin_run(self, facts: Mapping[str, Any]) -> None:
        """Note that a driver begins, with what and when; nothing is decided by it."""
        with naming(self.path):
            self._append({"run": {**facts, "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}})

    def add(self, outcome: Outcome) -> None:
        """Keep what became of a stack; it is on the disk when this returns."""
        with naming(self.path):
            told = outcome.to_json()
            for which in _FILES:
                files = told.get(which, {})
                told[which] = {os.path.relpath(path, self.path.parent): known for path, known in files.items()}
            self._append({"stack": told})
        self.outcomes[outcome.name] = outcome

    def close(self) -> None:
        """Give the journal to others."""
        with suppress(OSError):
            os.close(self.descriptor)

    def _lock(self) -> None:
        end = time.monotonic() + _WAIT_SECONDS
        while True:
            try:
                fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                if time.monotonic() > end:
                    raise InputError(
                        f"{self.path} is another batch's, still running: wait for its end, or choose another folder"
                    ) from None
                time.sleep(0.05)
            except OSError:  # a file system without locks, of which `claiming` has told
                return

    def _append(self, record: Mapping[str, Any]) -> None:
        rest = memoryview(_line_of(record))
        end = os.fstat(self.descriptor).st_size
        try:
            while rest:
                rest = rest[os.write(self.descriptor, rest) :]
            os.fsync(self.descriptor)
        except OSError:
            with suppress(OSError):  # a full disk took half of it
                os.ftruncate(self.descriptor, end)
            raise

    def _read(self) -> None:
        with self.path.open("rb") as file:
            content = file.read(_FIRST_BYTES)
            if content and not _is_ours(content):
                raise InputError(f"{self.path} is no journal of this version: it is no {FORMAT}; choose another folder")
            content += file.read()
        whole, newline, torn = content.rpartition(b"\n")
        records = [_record_of(line) for line in whole.split(b"\n")] if newline else []
        known = [record for record in records if record is not None]
        others = {str(record["format"]) for record in known if "format" in record} - {FORMAT}
        if others:
            what = f"it is {others.pop()[:80]}"
            raise InputError(f"{self.path} is no journal of this version: {what}; choose another folder")
        if torn:
            os.ftruncate(self.descriptor, len(whole) + len(newline))
        self.damaged = records.count(None) + bool(torn)
        for record in known:
            outcome = self._outcome_of(record["stack"]) if "stack" in record else None
            if outcome is not None:
                self.outcomes[outcome.name] = outcome

    def _outcome_of(self, told: Any) -> Outcome | None:
        """Return what a line says; None where another program wrote it, or a later version with more fields."""
        if not isinstance(told, dict) or not isinstance(told.get("name"), str):
            return None
        try:
            for which in _FILES:
                files = told.get(which, {})
                told[which] = {os.path.normpath(self.path.parent / name): dict(files[name]) for name in files}
            outcome = Outcome.from_json(told)
        except (TypeError, ValueError, AttributeError):
            return None
        return outcome if outcome.is_sound() else None


def _is_ours(content: bytes) -> bool:
    """Return whether what a file begins with is a journal's; if not, nothing is cut from it or added to it.

    A line of the first bytes is whole, whatever befell those before, or they are a first line that was torn.
    """
    *lines, _ = content.split(b"\n")
    return any(line.startswith(_SUM) and _record_of(line) is not None for line in lines) or _begins_ours(content)


def _begins_ours(content: bytes) -> bool:
    """Return whether a file without one whole line of ours begins as one does that was torn at once."""
    first = _line_of({"format": FORMAT})
    return content[: len(_SUM) + 16] == first[: len(content)][: len(_SUM) + 16]


def _line_of(record: Mapping[str, Any]) -> bytes:
    text = json.dumps(record, separators=(",", ":"), allow_nan=False).encode("ascii")
    return sealed(text) + b"\n"


def sealed(text: bytes) -> bytes:
    """Return a JSON object that begins with a checksum of its rest."""
    return _SUM + xxhash.xxh3_64_hexdigest(text).encode("ascii") + b'",' + text[1:]


def _record_of(line: bytes) -> dict[str, Any] | None:
    text = b"{" + line[len(_SUM) + 18 :]
    if line != sealed(text):
        return None
    with suppress(ValueError):
        record = json.loads(text)
        return record if isinstance(record, dict) else None
    return None
