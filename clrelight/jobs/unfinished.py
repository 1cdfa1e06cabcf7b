"""Pictures of a job that was interrupted: which are whole, so that the same job goes on behind them."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clrelight import __version__
from clrelight.codec.encoded import Encoded
from clrelight.dataset import CoefficientMap
from clrelight.durable import naming, replacing, sibling_stem
from clrelight.errors import counted
from clrelight.jobs.report import Report
from clrelight.lighting.light import Light
from clrelight.remote import is_remote

Input = tuple[str, int, int]
"""Where a file is, of how many bytes, and when it was changed."""
_ENDING = ".done"
_FEW = 1 << 10
"""Numbers of an array that are told one by one; of more their digest is."""


class Unfinished:
    """A list of finished pictures, beside them until all are there.

    Its first line stands for what was asked for, and one after it for each picture says what its file is: size and
    time of change, by which another's is told from it. What is asked for otherwise, or of files that have changed
    since, begins anew.

    Parameters
    ----------
    names : sequence of str
        All files, in order.
    inputs : sequence of Input
        Files that the pictures are made of.
    asked : object
        All else that they hang on: JSON values, arrays of numbers, dataclasses of these, and what has a `repr` of all
        its values.
    """

    def __init__(self, names: Sequence[str], inputs: Sequence[Input], asked: object) -> None:
        self._names = names
        first = Path(names[0])
        self._list = first.with_name(sibling_stem(first.name) + _ENDING)
        told = json.dumps([__version__, [os.path.basename(each) for each in names], inputs, asked], default=_plain)
        self._key = hashlib.sha256(told.encode()).hexdigest()
        self.facts: dict[int, Mapping[str, Any]] = {}
        """Of each picture that is whole, by its number: what is known of it."""
        self._lines = [self._key]
        """Of a list that is not begun; none afterwards."""
        self._read()

    def _read(self) -> None:
        try:
            if not stat.S_ISREG(os.lstat(self._list).st_mode):
                return
            head, *lines = self._list.read_text("utf-8").splitlines()
        except (OSError, ValueError):
            return
        if head != self._key:
            return
        for line in lines:
            with suppress(ValueError, TypeError, LookupError, OSError):  # cut short, or its picture is gone
                number, state, facts = json.loads(line)
                if tuple(state) == _state(self._names[number]):
                    self.facts[number] = facts
                    self._lines.append(line)

    @property
    def notes(self) -> list[str]:
        """What was said of the pictures that are whole."""
        return [note for facts in self.facts.values() for note in facts.get("notes", ())]

    @property
    def exposure(self) -> float | None:
        """What all pictures are shown at, where one that is whole tells it."""
        return next((facts["exposure"] for facts in self.facts.values() if "exposure" in facts), None)

    @property
    def below(self) -> float:
        """The greatest share of pixels below black of those that are whole."""
        return max((float(facts.get("below", 0.0)) for facts in self.facts.values()), default=0.0)

    def tell(self, report: Report) -> None:
        """Note which pictures are there, and what was said of them."""
        report.note(tell_known(len(self.facts), len(self._names)), *self.notes)

    def missing(self, together: int) -> Iterator[tuple[int, int]]:
        """Yield numbers first..end of pictures to make, in parts that begin at multiples of `together`."""
        count = len(self._names)
        groups = [(first, min(first + together, count)) for first in range(0, count, together)]
        begin = None
        for first, end in groups:
            is_whole = all(number in self.facts for number in range(first, end))
            if not is_whole and begin is None:
                begin = first
            if is_whole and begin is not None:
                yield begin, first
                begin = None
        if begin is not None:
            yield begin, count

    def numbers(self, together: int = 1) -> list[int]:
        """Return the numbers of the pictures of `missing`."""
        return [number for part in self.missing(together) for number in range(*part)]

    def add(self, number: int, facts: Mapping[str, Any]) -> None:
        """Note that a picture is written; InputError where the list cannot be."""
        self.facts[number] = facts
        with naming(self._list):
            line = json.dumps([number, _state(self._names[number]), dict(facts)])
            if not self._lines:
                with self._list.open("a", encoding="utf-8") as stream:
                    stream.write(line + "\n")
                return
        # An older list, whose last line may be cut short, stays until the new one is whole.
        with replacing(self._list) as part:
            part.write("".join(f"{each}\n" for each in (*self._lines, line)).encode())
        self._lines = []

    def end(self) -> None:
        """Take the list away: all pictures are there."""
        with suppress(OSError):
            self._list.unlink()


def seen_inputs(sources: Sequence[object]) -> list[Input] | None:
    """Return what files look like, before they are read; None where a source is no file of this machine."""
    paths = [os.fsdecode(each) for each in sources if isinstance(each, str | os.PathLike)]
    has_records = any(isinstance(each, CoefficientMap | Encoded | Light) for each in sources)
    if has_records or any(map(is_remote, paths)):
        return None
    try:
        return [(os.path.realpath(each), *_state(each)) for each in paths]
    except (OSError, ValueError):  # who reads it says what is wrong with it
        return None


def unfinished_images(names: Sequence[str], inputs: Sequence[Input] | None, asked: object) -> Unfinished | None:
    """Return what knows which images are there; None of a single one, or of inputs that may change unseen."""
    return None if len(names) < 2 or inputs is None else Unfinished(names, inputs, asked)


def tell_known(some: int, count: int) -> str:
    """Return what to say where an interrupted job left some of its images."""
    return f"{some} of {counted(count, 'image is', 'images are')} there, of this command when it was interrupted"


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {each.name: getattr(value, each.name) for each in fields(value)}
    if isinstance(value, np.ndarray) and value.size > _FEW:
        return [value.dtype.str, value.shape, hashlib.sha256(np.ascontiguousarray(value).data).hexdigest()]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else repr(value)


def _state(path: str) -> tuple[int, int]:
    found = os.stat(path)
    return found.st_size, found.st_mtime_ns
