"""Read a folder of photographs under known lights."""

from __future__ import annotations

import inspect
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, overload

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.ingest import Folder, read_folder, write_photographs
from clrelight.ingest.filling import fill_scratch, plan_memory
from clrelight.jobs.inputs import path_text
from clrelight.jobs.memory import SPARE_SHARE, spare_memory
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.memory import IMAGE_MEMORY
from clrelight.store import check_output, open_stack
from clrelight.store.scratch_images import ScratchImages

_OWN = ("folder", "memory_bytes")
_OPTIONS = [name for name in inspect.signature(read_folder).parameters if name not in _OWN]


@overload
def ingest(
    folder: str | os.PathLike[str],
    out: None = None,
    *,
    memory: int | str = IMAGE_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> LightStack: ...


@overload
def ingest(
    folder: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    memory: int | str = IMAGE_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> Report: ...


def ingest(
    folder: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    memory: int | str = IMAGE_MEMORY,
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
        Of `clrelight.ingest.read_folder`: ``lights``, ``transfer``, ``peak``, ``crop``, ``mask``, ``downscale``,
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
    options = given_options(folder, options)
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


@contextmanager
def lend_photographs(
    found: Folder,
    place: str | os.PathLike[str],
    memory: int,
    report: Report,
    progress: Progress | None,
    outs: Sequence[str | os.PathLike[str]],
    look: Callable[[LightStack], object],
) -> Iterator[LightStack]:
    """Lend the photographs of a folder, read into spare memory or a file without a name in `place`; as `ingest`.

    The report's ``photographs_in_memory`` are the bytes of those in memory, which are not the process's own.
    InputError if one of the files `outs`, which are to be made of them, is one of those that are read. `look` may
    refuse what they will be, before any is read.
    """
    since = time.perf_counter()
    for out in outs:
        check_output(out, found.inputs)
    look(found.stack)
    plan = plan_memory(found.source, memory)
    shape, dtype = found.source.shape_ihwc, found.source.values.dtype
    n_bytes = math.prod(shape) * dtype.itemsize
    in_memory = SPARE_SHARE * n_bytes <= spare_memory()
    images = ScratchImages(place, shape, dtype, in_memory=in_memory)
    report.facts["photographs_in_memory"] = n_bytes if images.in_memory else 0
    with closing(images):
        with stage(progress, "reading images") as tell, closing(fill_scratch(images, found.source, plan)) as steps:
            for done in steps:
                tell(done, found.stack.n_light)
        report.note(*found.summarize().notes)
        report.add("ingest", since)
        yield replace(found.stack, images_ihwc=images)


def given_options(folder: str | os.PathLike[str], options: dict[str, Any]) -> dict[str, Any]:
    """Return the options that are given; InputError for those that there are not."""
    path_text(folder, "a folder")
    for name in options:
        if name not in _OPTIONS:
            raise InputError(f"ingest has no option {name!r}; it has: {', '.join(_OPTIONS)}")
    for name in ("lights", "mask"):
        if options.get(name) is not None:
            path_text(options[name], name)
    return {name: value for name, value in options.items() if value is not None}


def read_photographs(folder: str | os.PathLike[str], memory: int, report: Report, options: dict[str, Any]) -> Folder:
    """Return what headers and light files of a folder tell, with the time that took reported; as `ingest`."""
    since = time.perf_counter()
    found = read_folder(folder, memory_bytes=memory, **given_options(folder, options))
    report.add("ingest", since)
    return found


def _read(
    folder: str | os.PathLike[str],
    out: str | os.PathLike[str],
    memory: int,
    report: Report,
    progress: Progress | None,
    options: dict[str, Any],
) -> None:
    with stage(progress, "reading images") as tell:
        keep_photographs(read_photographs(folder, memory, report, options), out, memory, report, tell)


def keep_photographs(
    found: Folder,
    out: str | os.PathLike[str],
    memory: int,
    report: Report,
    progress: Callable[[int, int], None],
) -> None:
    """Write photographs whose headers are read to a stack file, and report what `ingest` does."""
    since = time.perf_counter()
    summary = write_photographs(found, out, memory, progress)
    report.add("ingest", since)
    report.facts |= asdict(summary)
    report.note(*report.facts.pop("notes"))
