"""Parts of a job that other processes do: what a job may ask of those who run it, and how it gets what they found.

A job goes its own way, in one process: it plans, decides and writes the result. What takes long and can be done alone
it hands to a farm as chores, and goes on with what comes back. So its result is the one of a process alone, as long as
the results of chores are.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.durable import naming, replacing
from clrelight.errors import InputError
from clrelight.remote import is_remote

Arrays = Mapping[str, NDArray]


@dataclass(frozen=True)
class Chore:
    """A part of a job.

    Attributes
    ----------
    job : str
        What does it: a function of this room that takes `source`, ``out`` and options, and writes ``out``.
    source : str
        A file.
    options : mapping
        JSON values.
    reads : tuple of str
        Other files that it hangs on, which options name.
    near : str
        What whoever did the last chore of this name has in memory, and others would make again.
    """

    job: str
    source: str
    options: Mapping[str, Any]
    reads: tuple[str, ...] = ()
    near: str = ""


class Farm(Protocol):
    """Does chores in other processes.

    Attributes
    ----------
    folder : str
        Where files lie that all processes read; gone when the job is done.
    """

    folder: str

    def do(self, chores: Sequence[Chore], what: str) -> Iterator[Arrays]:
        """Do chores, and return the arrays that each wrote, in order.

        What was done before, of the same files with the same options, is not done again. `what` says to people what it
        is. `ChoreError` if one fails; those that could be done are kept.
        """

    def begin(self) -> None:
        """Hear that there will be chores: processes may start while the job plans."""

    def write(self, chores: Sequence[tuple[Chore, str]], what: str) -> list[str]:
        """Do chores that each write a file of its own; return the notes on them."""

    def share(self, name: str, arrays: Arrays) -> str:
        """Write arrays for all processes to read; return the path, which hangs on what they hold."""


class ChoreError(InputError):
    """A chore has failed: its name and why, in a line.

    Attributes
    ----------
    kind : str
        What failed, as a batch names it: ``"input"``, ``"device"``, ``"died"``, ``"late"`` or ``"bug"``.
    """

    def __init__(self, message: str, kind: str) -> None:
        super().__init__(message)
        self.kind = kind


def shared_path(source: object, what: str) -> str:
    """Return the name of a file that other processes read too; InputError where `what` is none, or lies elsewhere."""
    if not isinstance(source, str | os.PathLike) or is_remote(os.fsdecode(source)):
        raise InputError(f"other processes read {what} too: give the path of a file on this machine")
    return os.path.abspath(os.fsdecode(source))


def shared_source(farm: Farm | None, source: object, what: str, out: object) -> str:
    """Return the name of what other processes of a farm, if there are any, read to make `out`; InputError as above."""
    if farm is None:
        return ""
    path = shared_path(source, what)
    check_written(out)
    return path


def check_written(out: object) -> None:
    """Raise InputError where what other processes make is not to be written."""
    if not out:
        raise InputError("what other processes make is written: give the name of a file")


def pack_arrays(arrays: Arrays) -> bytes:
    """Return arrays as the bytes of an ``.npz`` file, the same for the same arrays."""
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def unpack_arrays(content: bytes) -> Arrays:
    """Return what `pack_arrays` was given; nothing in it is run."""
    with np.load(io.BytesIO(content), allow_pickle=False) as held:
        return {name: held[name] for name in held.files}


def text_array(facts: Any) -> NDArray[np.uint8]:
    """Return JSON values as an array, the same for the same values."""
    return np.frombuffer(json.dumps(facts, sort_keys=True).encode("ascii"), np.uint8)


def facts_of(array: NDArray[np.uint8]) -> Any:
    """Return what `text_array` was given."""
    return json.loads(array.tobytes())


def write_arrays(path: str | os.PathLike[str], arrays: Arrays) -> None:
    """Write arrays as an ``.npz`` file, which stands once it is whole."""
    with replacing(path) as part, naming(path), os.fdopen(os.dup(part.descriptor), "wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


class StoredArrays(Mapping[str, NDArray]):
    """The arrays of an ``.npz`` file, each read when it is asked for."""

    def __init__(self, path: str) -> None:
        self._path = path
        with np.load(path, allow_pickle=False) as held:
            self._names = list(held.files)

    def __getitem__(self, name: str) -> NDArray:
        """Return an array; InputError if it cannot be read."""
        return read_one_array(self._path, name)

    def __iter__(self) -> Iterator[str]:
        """Go through the names."""
        return iter(self._names)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._names)


def read_arrays(path: str | os.PathLike[str]) -> Arrays:
    """Return what `write_arrays` wrote; InputError if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return unpack_arrays(file.read())
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {os.fsdecode(path)}: {error}") from error


def read_one_array(path: str | os.PathLike[str], name: str) -> NDArray:
    """Return one of the arrays that `write_arrays` wrote, without reading the others; InputError if it cannot be."""
    try:
        with np.load(path, allow_pickle=False) as held:
            return held[name]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"cannot read {os.fsdecode(path)}: {error}") from error
