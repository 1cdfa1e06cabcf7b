"""The jobs that a batch can do to each stack: what they take and write, and which options they have."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from clrelight.batch.task import Task
from clrelight.errors import InputError
from clrelight.jobs.farm import Farm
from clrelight.jobs.report import Progress, Report

_NOT_OPTIONS = {"source", "fitted", "folder", "out", "progress", "report", "options", "device", "memory_bytes", "farm"}
_FOUR_NUMBERS = ("crop", "region")
_LIGHT = "light"


def _none() -> set[str]:
    return set()


def _of_folders() -> set[str]:
    from clrelight.ingest import read_folder

    return _parameters(read_folder)


def _of_methods() -> set[str]:
    from clrelight.fit import method_class, method_ids

    return _fields_of(map(method_class, method_ids()))


def _of_codecs() -> set[str]:
    from clrelight.codec import codec_class, codec_ids

    return _fields_of(map(codec_class, codec_ids())) - {"byte_budget"}


def _fields_of(kinds: Iterable[type]) -> set[str]:
    return {each.name for kind in kinds for each in fields(kind)}


def _parameters(function: Callable[..., Any]) -> set[str]:
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

    @functools.cache  # noqa: B019, there are as many as stand below
    def options(self) -> list[str]:
        """Return the names of all options."""
        return sorted(_parameters(self.function()) | self.more())

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


def find_verb(name: str) -> Verb:
    """Return the verb of a name; InputError lists them."""
    for each in _OF_TILES:
        if each.id == name:
            return each
    if name not in VERBS:
        raise InputError(f"there is no job {name!r} for batches; there are {', '.join(VERBS)}")
    return VERBS[name]


_EVERY = (
    Verb(
        "pack",
        "clrelight.jobs.pack:pack",
        "photographs to one small file that can be relit",
        ".h5",
        ("stack",),
        takes_folders=True,
        reads=("lights", "mask"),
        writes=("keep_stack",),
        more=_of_folders,
    ),
    Verb(
        "ingest",
        "clrelight.jobs.ingest:ingest",
        "photographs to a stack",
        ".h5",
        (),
        takes_folders=True,
        reads=("lights", "mask"),
        more=_of_folders,
    ),
    Verb(
        "fit",
        "clrelight.jobs.fit:fit",
        "a stack to its coefficients",
        ".h5",
        ("stack",),
        writes=("confidence",),
        more=_of_methods,
    ),
    Verb(
        "encode",
        "clrelight.jobs.encode:encode",
        "a fit to a small file",
        ".h5",
        ("fit", "tiles"),
        reads=("stack",),
        more=_of_codecs,
    ),
    Verb("decode", "clrelight.jobs.decode:decode", "a small file to a fit", ".h5", ("encoded",)),
    Verb(
        "unpack",
        "clrelight.jobs.unpack:unpack",
        "a small file to photographs",
        "",
        ("encoded",),
        reads=("lights",),
    ),
    Verb(
        "relight",
        "clrelight.jobs.relight:relight",
        "a fit or a small file to a picture under a light",
        ".png",
        ("fit", "tiles", "encoded"),
        endings=(".exr", ".hdr", ".tif", ".jpg"),
        reads=("light", "lights"),
        writes_many=True,
    ),
    Verb(
        "export",
        "clrelight.jobs.export:export",
        "a fit or a small file to textures",
        "",
        ("fit", "tiles", "encoded"),
        endings=(".dds",),
    ),
    Verb(
        "normals",
        "clrelight.jobs.variation.normals:normals",
        "a stack to its normals",
        ".exr",
        ("stack",),
        endings=(".png", ".tif", ".tiff"),
        writes=("albedo", "confidence", "height", "ply"),
    ),
    Verb(
        "bench",
        "clrelight.batch.bench:bench",
        "a stack to a table of fits and codecs",
        ".h5",
        ("stack",),
    ),
    Verb(
        "psnr",
        "clrelight.jobs.measure:measure",
        "a fit or a small file beside its photographs",
        "",
        ("fit", "tiles", "encoded"),
        reads=("stack",),
        is_measure=True,
    ),
)
_OF_TILES = (
    Verb(
        "transfer",
        "clrelight.jobs.surface.transfer:transfer",
        "a mesh to its transfer functions",
        ".h5",
        (),
        reads=("lights",),
    ),
    Verb(
        "transfer-part",
        "clrelight.jobs.surface.transfer_chores:transfer_part",
        "functions of some vertices",
        ".npz",
        (),
    ),
    Verb("fit-rows", "clrelight.jobs.shards:fit_rows", "rows of a fit", ".h5", ("stack",), more=_of_methods),
    Verb("fit-join", "clrelight.jobs.shards:join_rows", "a fit of its rows", ".h5", ("stack",)),
    Verb("fit-part", "clrelight.jobs.fit_chores:fit_part", "rows of a fit and their errors", ".npz", ("stack",)),
    Verb("decode-rows", "clrelight.jobs.decoding_rows:decode_rows", "rows of a decoded fit", ".h5", ("encoded",)),
    Verb("decode-join", "clrelight.jobs.shards:join_rows", "a decoded fit of its rows", ".h5", ("encoded",)),
    Verb(
        "relight-some",
        "clrelight.jobs.relighting_chores:relight_some",
        "some pictures",
        ".npz",
        ("fit", "tiles", "encoded"),
    ),
    Verb("unpack-part", "clrelight.jobs.unpacking_chores:relight_part", "a part under lights", ".npz", ("encoded",)),
    Verb("unpack-light", "clrelight.jobs.unpacking_chores:write_light", "a photograph", "", ("encoded",)),
    Verb("pack-tile", "clrelight.jobs.packing_chores:code_tile", "streams of a tile", ".npz", ("stack",)),
    Verb("pack-try", "clrelight.jobs.packing_chores:try_pieces", "bytes of pieces", ".npz", ("stack",)),
    Verb("measure-windows", "clrelight.jobs.packing_chores:measure_coded", "errors of windows", ".npz", ("stack",)),
)
"""Parts of the jobs that are done in tiles."""
VERBS = {each.id: each for each in _EVERY}
"""Every job, in the order in which it is told of them."""
