"""Where jobs write: asked about before long work, so that it is not done in vain."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from clrelight.jobs.inputs import path_text
from clrelight.store import check_output


@contextmanager
def claimed(names: Sequence[str | os.PathLike[str]], inputs: Sequence[str | os.PathLike[str]] = ()) -> Iterator[None]:
    """Do the work of the block for files that can be written as they look now, and are none of the inputs."""
    for name in names:
        check_output(path_text(name, "a file to write"), inputs)
    yield
