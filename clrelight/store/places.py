"""Where an HDF5 file is: on a disk, or on another machine that gives ranges of its bytes."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import h5py

from clrelight.errors import InputError, StoreFormatError
from clrelight.remote import is_remote

if TYPE_CHECKING:
    from clrelight.remote.ranges import RangedFile

MAGIC = b"\x89HDF\r\n\x1a\n"
CACHE_BYTES = 1 << 20
"""Chunk cache of each dataset of another program: a chunk of several rows, for who reads row by row."""

_USER_BLOCK = 512
"""HDF5 begins at byte 0, 512, 1024, 2048, ..."""


@dataclass(frozen=True)
class Place:
    """A file that begins as HDF5 does.

    Attributes
    ----------
    path : str
        For messages.
    size : int
        Bytes.
    begin : int
        Where HDF5 begins in it.
    remote : RangedFile, optional
        What it is read through where it is on another machine.
    """

    path: str
    size: int
    begin: int
    remote: RangedFile | None = None

    def open(self) -> h5py.File:
        """Return the open file."""
        if self.remote is not None:
            return h5py.File(self.remote, "r", rdcc_nbytes=CACHE_BYTES)
        return h5py.File(self.path, "r", locking=False, rdcc_nbytes=CACHE_BYTES)

    def read_at(self, start: int, end: int) -> bytes:
        """Return bytes `start` to `end`, or to where the file ends before."""
        if self.remote is not None:
            return self.remote.read_at(start, end)
        with open(self.path, "rb") as stream:
            stream.seek(start)
            return stream.read(end - start)

    def prefetch(self, ranges: Iterable[tuple[int, int]]) -> None:
        """Fetch ranges that are read next."""
        if self.remote is not None:
            self.remote.prefetch(ranges)

    def traffic(self) -> dict[str, int]:
        """Return what was fetched so far: bytes, of how many, and in how many requests; nothing of a file here."""
        if self.remote is None:
            return {}
        return {"bytes": self.remote.fetched_bytes, "of": self.size, "requests": self.remote.requests}


@contextmanager
def placed(path: str) -> Iterator[Place]:
    """Lend the place of a file; InputError or StoreFormatError where there is none that begins as HDF5 does."""
    if not is_remote(path):
        yield _place_here(path)
        return
    from clrelight.remote.ranges import RangedFile  # which loads what speaks HTTP

    remote = RangedFile(path)
    try:
        begin = _begin(path, remote.size, lambda at: remote.read_at(at, at + len(MAGIC)))
        yield Place(path, remote.size, begin, remote)
    finally:
        remote.close()


_FOLDER = ", but a folder: clrelight ingest makes a stack of the photographs in one, clrelight pack a file to relight"


def _place_here(path: str) -> Place:
    if "\0" in path:
        raise InputError(f"cannot read {path!r}: that is no file name")
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise StoreFormatError(f"{path} is no regular file{_FOLDER if os.path.isdir(path) else ' (a device)'}")
        with open(path, "rb") as stream:

            def look(at: int) -> bytes:
                stream.seek(at)
                return stream.read(len(MAGIC))

            size = os.fstat(stream.fileno()).st_size
            return Place(path, size, _begin(path, size, look))
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None


_AT_FIRST = dict.fromkeys((".ptm", ".rti"), ": clrelight import makes a stack of it")
"""What to do with files of other programs, by the ends of their names."""


def _begin(path: str, size: int, look: Callable[[int], bytes]) -> int:
    """Return where HDF5 begins, which may be behind what another program put before."""
    if not size:
        raise StoreFormatError(f"{path} is empty, expected an HDF5 file")
    at = 0
    while at < size and look(at) != MAGIC:
        at = 2 * at or _USER_BLOCK
    if at >= size:
        raise StoreFormatError(f"{path} is not an HDF5 file{_AT_FIRST.get(os.path.splitext(path)[1].lower(), '')}")
    return at
