"""Where jobs write: asked about and claimed before long work, so that it is not done in vain."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

from clrelight.durable import claiming, no_locks
from clrelight.jobs.inputs import path_text
from clrelight.jobs.report import Report
from clrelight.store import check_output


@contextmanager
def claimed(
    names: Sequence[str | os.PathLike[str] | None], inputs: Sequence[str | os.PathLike[str]], report: Report
) -> Iterator[None]:
    """Keep every other program from files while the block works for them.

    InputError if one cannot be written as it looks now, or is one of the inputs. None is no file.
    """
    wanted = [name for name in names if name is not None]
    for name in wanted:
        check_output(path_text(name, "a file to write"), inputs)
    with ExitStack() as claims:
        for name in wanted[:1]:  # and so the others: two programs share all of them, or none
            if not claims.enter_context(claiming(name)):
                report.note(no_locks(name))
        yield
