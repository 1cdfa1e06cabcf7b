"""Where jobs write: asked about and claimed before long work, so that it is not done in vain."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

from clrelight.durable import claiming, no_locks
from clrelight.errors import InputError
from clrelight.jobs.inputs import path_text
from clrelight.jobs.report import Report
from clrelight.store import check_output


@contextmanager
def claimed(
    names: Sequence[str | os.PathLike[str] | None], inputs: Sequence[str | os.PathLike[str]], report: Report
) -> Iterator[None]:
    """Keep every other program from files while the block works for them.

    InputError if one cannot be written as it looks now, is one of the inputs, or is named twice. None is no file.
    """
    wanted = [name for name in names if name is not None]
    places: set[str] = set()
    for name in wanted:
        text = path_text(name, "a file to write")
        check_output(text, inputs)
        place = os.path.realpath(text)
        if place in places:
            raise InputError(f"cannot write {text} twice: two results of this command have that name")
        places.add(place)
    with ExitStack() as claims:
        for name in wanted[:1]:  # and so the others: two programs share all of them, or none
            if not claims.enter_context(claiming(name)):
                report.note(no_locks(name))
        yield


def check_new_folder(folder: str) -> None:
    """Raise InputError where something is that is no empty folder: before long work, as `check_output` of a file."""
    if os.path.lexists(folder) and not (os.path.isdir(folder) and not os.listdir(folder)):
        raise InputError(f"cannot write {folder}: it is there, choose the name of a new folder")
