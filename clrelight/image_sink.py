"""Where OpenImageIO writes pictures to: not the disk, for it does not hear what a full one says.

With no room left, its encoders of PNG and TIFF say that all is well, and libjpeg ends the process. So they fill memory,
and what arrives there is written by us.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager

from clrelight.durable import Part
from clrelight.streaming import one_thread

_PIECE_BYTES = 8 << 20
_MARGIN_BYTES = 1 << 16
"""Of a file, beside twice the pixels: more than any encoder makes of them."""


def has_memory() -> bool:
    """Return whether the system has files in memory that encoders find by a name."""
    return hasattr(os, "memfd_create") and os.path.isdir("/proc/self/fd")


@contextmanager
def sink_for(part: Part, extension: str, n_bytes: int) -> Iterator[str]:
    """Lend the name of a file to write a picture of `n_bytes` to; when the block has ended, `part` holds the file.

    Raises
    ------
    OSError
        What the system says against writing them.
    """
    if not has_memory():
        yield str(part.path)
    elif extension == ".jpg" and 2 * n_bytes + _MARGIN_BYTES > _most_bytes():
        # Only where memory may end, which libjpeg would not survive: OpenImageIO closes a file without letting other
        # threads of Python run, so that a pipe that is full then stays so for ever.
        with _pipe(part) as name:
            yield name
    else:
        if 2 * n_bytes + _MARGIN_BYTES > _most_bytes():
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
        with _memory(part) as name:
            yield name


@contextmanager
def _memory(part: Part) -> Iterator[str]:
    """Lend a file in memory, which is never full where a process may write files of that size at all."""
    descriptor = os.memfd_create("clrelight-image")
    try:
        yield f"/proc/self/fd/{descriptor}"
        os.lseek(descriptor, 0, os.SEEK_SET)
        while piece := os.read(descriptor, _PIECE_BYTES):
            part.write(piece)
    finally:
        os.close(descriptor)


@contextmanager
def _pipe(part: Part) -> Iterator[str]:
    """Lend a pipe, which is never full: for what is written from its beginning to its end, and may not fail."""
    source, target = os.pipe()
    with os.fdopen(source, "rb") as reader, one_thread() as pool:
        content = pool.submit(reader.read)
        try:
            yield f"/proc/self/fd/{target}"
        finally:
            os.close(target)
        part.write(content.result())


def _most_bytes() -> float:
    import resource  # not on Windows, which has no such memory either

    limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    return float("inf") if limit == resource.RLIM_INFINITY else limit
