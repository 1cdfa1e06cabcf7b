"""Where OpenImageIO writes pictures to: not the disk, for it does not hear what a full one says.

With no room left, its encoders of PNG and TIFF say that all is well, and libjpeg ends the process. So they fill memory,
and what arrives there is written by us.
"""

from __future__ import annotations

import errno
import os
import tempfile
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
def named_content(content: bytes, ending: str) -> Iterator[str]:
    """Lend the name of a file, in memory where the system has such, that holds bytes: decoders open names alone."""
    if not has_memory():
        with tempfile.NamedTemporaryFile(suffix=ending) as copy:
            copy.write(content)
            copy.flush()
            yield copy.name
        return
    descriptor = os.memfd_create("clrelight-image")
    with os.fdopen(descriptor, "wb", buffering=0) as held:
        rest = memoryview(content)
        while rest:
            rest = rest[held.write(rest) :]
        yield f"/proc/self/fd/{descriptor}"


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
    elif extension == ".jpg" and not is_allowed(n_bytes):
        # Only where memory may end, which libjpeg would not survive: OpenImageIO closes a file without letting other
        # threads of Python run, so that a pipe that is full then stays so for ever.
        with _pipe(part) as name:
            yield name
    else:
        check_allowed(n_bytes)
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


def check_allowed(n_bytes: int) -> None:
    """Raise OSError where files of this process may get too small for a picture of so many bytes of pixels."""
    if not is_allowed(n_bytes):
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))


def is_allowed(n_bytes: int) -> bool:
    """Return whether files of this process may hold a picture of so many bytes of pixels, however it is coded."""
    import resource  # not on Windows, which has no such memory either

    limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    return limit == resource.RLIM_INFINITY or 2 * n_bytes + _MARGIN_BYTES <= limit
