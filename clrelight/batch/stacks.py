"""Which stacks a batch is about, and those of a folder."""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clrelight.batch.verb import Verb
from clrelight.errors import InputError, StoreFormatError, counted
from clrelight.images import IMAGE_EXTENSIONS

_STORES = (".h5", ".hdf5")


@dataclass(frozen=True)
class Stack:
    """A stack of a batch, and the options that it alone has."""

    name: str
    source: str
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Listing:
    """What a batch is about.

    Attributes
    ----------
    stacks : tuple of Stack
        In the order in which they are begun.
    base : str
        The folder from which names of files in options are meant.
    job, ending : str
        Empty where the list does not say.
    options : mapping
        Of the job, for all stacks.
    overrides : tuple of (str, mapping)
        Patterns of names, and options of those that match; later ones count more.
    notes : tuple of str
    """

    stacks: tuple[Stack, ...]
    base: str
    job: str = ""
    ending: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    overrides: tuple[tuple[str, Mapping[str, Any]], ...] = ()
    notes: tuple[str, ...] = ()


def list_folder(folder: Path, verb: Verb, out: str | os.PathLike[str] | None = None) -> Listing:
    """Return the stacks in a folder and in those below it, in the order of names: what the job takes.

    Files of another kind are left out, with a note; those that are not sound are kept, for they are to be told of.
    InputError if the folder holds photographs itself, or cannot be read.
    """
    stacks, others = [], 0
    for path in _stores_and_photographs(folder, verb, None if out is None else os.path.realpath(out)):
        if path.is_dir() or path.name.lower().endswith(verb.files) or _is_taken(path, verb.takes):
            stacks.append(_stack_at(path, folder))
        else:
            others += 1
    notes = (
        (f"left out {counted(others, 'file')} in {folder} of a kind that {verb.id} does not take",) if others else ()
    )
    return Listing(tuple(stacks), str(folder), notes=notes)


def _stores_and_photographs(folder: Path, verb: Verb, out: str | None) -> list[Path]:
    """Return files that a job may take, and folders that hold images, in all folders below, in the order of names."""
    found = []
    for place, folders, files in os.walk(folder, onerror=_refuse):
        folders[:] = [name for name in folders if name[0] != "." and os.path.realpath(os.path.join(place, name)) != out]
        shown = [name for name in files if name[0] != "."]
        endings = (*(_STORES if verb.takes else ()), *verb.files)
        found += [Path(place, name) for name in shown if name.lower().endswith(endings)]
        if verb.takes_folders and any(os.path.splitext(name)[1].lower() in IMAGE_EXTENSIONS for name in shown):
            if Path(place) == folder:
                raise InputError(f"{folder} holds photographs itself: give the folder above it, or a list")
            found.append(Path(place))
            folders[:] = []  # what lies below belongs to these photographs
    return sorted(found)


def _refuse(error: OSError) -> None:
    raise InputError(f"cannot read {error.filename}: {error.strerror or error}") from error


def _is_taken(path: Path, kinds: Iterable[str]) -> bool:
    """Return whether a file is of a kind, or is not sound, which is to be told of it in its turn."""
    from clrelight.store import file_schema

    try:
        return file_schema(path).partition("/")[0] in kinds
    except StoreFormatError:
        return True


def _stack_at(path: Path, folder: Path) -> Stack:
    name = path.relative_to(folder)
    return Stack((name if path.is_dir() else name.with_suffix("")).as_posix(), os.path.abspath(path))


def matches(name: str, patterns: Iterable[str]) -> bool:
    """Return whether a name matches one of some patterns such as ``coin-*``."""
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)
