"""Read a folder of photographs under known lights."""

from __future__ import annotations

import inspect
import os
import tempfile
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, overload

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.ingest import ingest_folder
from clrelight.jobs.inputs import path_text
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.store import open_stack

DEFAULT_MEMORY = 1 << 30
"""Bytes of image data that are held where nothing else is said."""

_OWN = ("folder", "out_path", "memory_bytes", "progress")
_OPTIONS = [name for name in inspect.signature(ingest_folder).parameters if name not in _OWN]


@overload
def ingest(
    folder: str | os.PathLike[str],
    out: None = None,
    *,
    memory: int | str = DEFAULT_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> LightStack: ...


@overload
def ingest(
    folder: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    memory: int | str = DEFAULT_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> Report: ...


def ingest(
    folder: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    memory: int | str = DEFAULT_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> LightStack | Report:
    """Read a folder of photographs under known lights into one stack.

    Parameters
    ----------
    folder : path
    out : path, optional
        A stack file to write, piece by piece; without it the stack is returned, read from a temporary one.
    memory : int or str
        Bytes of decoded images that are held, such as ``"1GiB"``; a stack that is returned comes on top.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).
    **options
        Of `clrelight.ingest.ingest_folder`: ``lights``, ``transfer``, ``peak``, ``crop``, ``mask``, ``subset``,
        ``allow_below``, ``name``, ...

    Returns
    -------
    LightStack
        With `out` instead the report.

    Raises
    ------
    InputError
        Naming the file, line or light that is wrong.
    """
    path_text(folder, "a folder")
    for name in options:
        if name not in _OPTIONS:
            raise InputError(f"ingest has no option {name!r}; it has: {', '.join(_OPTIONS)}")
    for name in ("lights", "mask"):
        if options.get(name) is not None:
            path_text(options[name], name)
    options = {name: value for name, value in options.items() if value is not None}
    kept, budget = report_for(report), count_bytes(memory)
    if out is None:
        with tempfile.TemporaryDirectory(prefix="clrelight.") as place:
            stack = Path(place, "stack.h5")
            _read(folder, stack, budget, kept, progress, options)
            with open_stack(stack) as stored:
                return replace(stored, images_ihwc=stored.images_ihwc[...])
    with claimed([out], [], kept):
        _read(folder, out, budget, kept, progress, options)
    kept.facts = {"file": os.fsdecode(out), **kept.facts}
    return kept


def _read(
    folder: str | os.PathLike[str],
    out: str | os.PathLike[str],
    memory: int,
    report: Report,
    progress: Progress | None,
    options: dict[str, Any],
) -> None:
    since = time.perf_counter()
    with stage(progress, "reading images") as tell:
        summary = ingest_folder(folder, out, memory_bytes=memory, progress=tell, **options)
    report.add("ingest", since)
    report.facts |= asdict(summary)
    report.note(*report.facts.pop("notes"))
