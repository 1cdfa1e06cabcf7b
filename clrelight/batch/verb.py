"""What a batch knows of a job: what it takes and writes, and which options it has."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from clrelight.batch.task import Task
from clrelight.errors import InputError
from clrelight.jobs.farm import Farm
from clrelight.jobs.report import Progress, Report

_NOT_OPTIONS = {
    "source",
    "path",
    "mesh",
    "fitted",
    "folder",
    "out",
    "progress",
    "report",
    "options",
    "device",
    "memory_bytes",
    "farm",
}
_FOUR_NUMBERS = ("crop", "region")
_LIGHT = "light"


def _none() -> set[str]:
    return set()


def parameters_of(function: Callable[..., Any]) -> set[str]:
    """Return the names of a job's options, as its function has them."""
    return set(inspect.signature(function).parameters) - _NOT_OPTIONS


@dataclass(frozen=True)
class Verb:
    """A job, as a batch does it.

    Attributes
    ----------
    id : str
    home : str
        Module and name of the function.
    summary : str
    ending : str
        Of the file that it writes; empty where that is a folder, or where it writes nothing.
    takes : tuple of str
        Kinds of the files that it takes (`store.schemas`).
    takes_folders : bool
        Whether it takes folders of photographs.
    files : tuple of str
        Endings of other programs' files that it takes.
    endings : tuple of str
        Other endings of its file.
    reads : tuple of str
        Options that name files to read.
    writes : tuple of str
        Options that name more files to write, in the folder of results.
    is_measure : bool
        Whether it writes nothing.
    writes_many : bool
        Whether the name of its file may have a number field, for several.
    more : callable
        Returns names of options that do not stand in the function's signature.
    """

    id: str
    home: str
    summary: str
    ending: str
    takes: tuple[str, ...]
    takes_folders: bool = False
    files: tuple[str, ...] = ()
    endings: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    is_measure: bool = False
    writes_many: bool = False
    more: Callable[[], set[str]] = _none

    def function(self) -> Callable[..., Any]:
        """Return the job's function, whose module is loaded now."""
        module, _, name = self.home.partition(":")
        return getattr(importlib.import_module(module), name)

    @functools.cache  # noqa: B019, there are as many as `verbs` lists
    def options(self) -> list[str]:
        """Return the names of all options."""
        return sorted(parameters_of(self.function()) | self.more())

    def is_on(self, name: str) -> bool:
        """Return whether an option stands for yes, or for as is best, where it is not given: then no has to be said."""
        given = inspect.signature(self.function()).parameters.get(name)
        return given is not None and given.default in (True, None)

    def check(self, options: Mapping[str, Any]) -> None:
        """Raise InputError where an option is not one of the job's."""
        known = self.options()
        for name in options:
            if name not in known:
                raise InputError(f"{self.id} has no option {name!r}; it has: {', '.join(known)}")

    def run(
        self, task: Task, device: str | None, report: Report, progress: Progress | None = None, farm: Farm | None = None
    ) -> Any:
        """Do a task; the report is filled."""
        function = self.function()
        given = {name: _argument(name, value) for name, value in task.options.items()}
        for name, value in (("device", device), ("progress", progress), ("farm", farm)):
            if name in inspect.signature(function).parameters:
                given[name] = value
        if not self.is_measure:
            given["out"] = task.out
        elif "stack" not in given:
            raise InputError(f"{self.id} needs the option stack: what to compare with, such as stacks/{{name}}.h5")
        return function(task.source, report=report, **given)


def _argument(name: str, value: Any) -> Any:
    """Return an option as its job takes it, which JSON cannot: tuples, and numbers in a text."""
    if name in _FOUR_NUMBERS and isinstance(value, str):
        try:
            return tuple(int(part) for part in value.split(","))
        except ValueError:
            raise InputError(f"{name} must be four whole numbers such as 0,0,512,512, got {value!r}") from None
    if name == _LIGHT and is_direction(value):
        return tuple(map(float, value.split(",")))
    return tuple(value) if isinstance(value, list) else value


def is_direction(value: Any) -> bool:
    """Return whether an option is three numbers in a text, which name no file."""
    try:
        return isinstance(value, str) and len([float(part) for part in value.split(",")]) == 3
    except ValueError:
        return False
