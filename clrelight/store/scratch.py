"""Files without a name: maps and payloads that memory should not hold, gone with the process whatever happens."""

from __future__ import annotations

import errno
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import BodyWriter
from clrelight.codec.workspace import BoundedWorkspace, Planes, Progress
from clrelight.durable import Part, naming
from clrelight.interrupts import holding
from clrelight.recycling import empty, kept_within
from clrelight.streaming import write_at
from clrelight.tiles import Rectangle, check_shape

_COPIED = 1 << 12
"""Bytes between two rows that are copied in less time than one more call of the system takes."""


class Scratch:
    """A file of a fixed size, written and read at any place.

    Parameters
    ----------
    folder : path
        Of what disk.
    n_bytes : int
        Reserved at once: InputError, where the disk has no room.
    in_memory : bool
        Keep the bytes in memory that the system has beside the process's own, where it has such files: writing takes a
        third of the time, and waits for no disk.

    Attributes
    ----------
    in_memory : bool
        Whether they are there.
    """

    def __init__(self, folder: str | os.PathLike, n_bytes: int, *, in_memory: bool = False) -> None:
        # What is said of a full disk: the file has no name.
        self._what = Path(f"temporary files in {os.path.abspath(os.fsdecode(folder))}")
        self.in_memory = False
        if in_memory and hasattr(os, "memfd_create"):
            with suppress(OSError):  # where a sandbox forbids it, the disk does as well
                self._file: BinaryIO = os.fdopen(os.memfd_create("clrelight-scratch"), "r+b", buffering=0)
                self.in_memory = True
        if self.in_memory:
            with naming(self._what):
                os.ftruncate(self._file.fileno(), n_bytes)
            return
        with naming(self._what), holding():  # it has a name for an instant, where the system cannot do without
            self._file = tempfile.TemporaryFile(prefix=".clrelight.", suffix=".part", dir=os.fsdecode(folder))  # noqa: SIM115
            if n_bytes:
                Part(self._what, self._what, self._file.fileno()).reserve(n_bytes)

    def write(self, at: int, values: NDArray) -> None:
        """Write a C-contiguous array's bytes."""
        with naming(self._what):
            write_at(self._file.fileno(), values.reshape(-1).view(np.uint8).data, at)

    def read_into(self, at: int, out: NDArray) -> None:
        """Fill a C-contiguous array with the bytes that were written there."""
        rest, descriptor = out.reshape(-1).view(np.uint8).data, self._file.fileno()
        while rest:
            done = os.preadv(descriptor, [rest], at)
            if done == 0:
                raise OSError(errno.EIO, f"{self._what} ends at byte {at}")
            rest, at = rest[done:], at + done

    def read_strided_into(self, at: int, stride: int, out_rb: NDArray) -> None:
        """Fill the rows of a C-contiguous array with bytes that begin so far from each other."""
        size, descriptor = out_rb[0].nbytes if len(out_rb) else 0, self._file.fileno()
        if self.in_memory and len(out_rb) and stride <= size + _COPIED:
            held = empty(((len(out_rb) - 1) * stride + size,), np.uint8)
            self.read_into(at, held)
            out_rb.view(np.uint8)[...] = np.lib.stride_tricks.as_strided(held, (len(out_rb), size), (stride, 1))
            return
        content = b"".join([os.pread(descriptor, size, at + row * stride) for row in range(len(out_rb))])
        if len(content) != out_rb.nbytes:
            raise OSError(errno.EIO, f"{self._what} ends before byte {at + len(out_rb) * stride}")
        out_rb.reshape(-1).view(np.uint8)[...] = np.frombuffer(content, np.uint8)

    def read_tile_into(
        self, shape: tuple[int, ...], tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None
    ) -> None:
        """Fill `out` with a tile of an array (n, height, width, ...) of its type; other columns are not touched."""
        check_shape(tile, out, shape, picked_n)
        row_bytes = math.prod(shape[2:]) * out.itemsize
        at = tile.top * row_bytes + tile.left * (row_bytes // shape[2])
        for number, part_hwc in zip(range(shape[0]) if picked_n is None else picked_n.tolist(), out, strict=True):
            start = number * shape[1] * row_bytes + at
            if tile.shape[1] == shape[2] and part_hwc.flags.c_contiguous:
                self.read_into(start, part_hwc)
            elif part_hwc.size:
                self.read_strided_into(start, row_bytes, part_hwc.reshape(len(part_hwc), -1))

    def close(self) -> None:
        """Give the disk its room back."""
        self._file.close()


class ScratchPlanes:
    """`Planes` in a file, one map after another."""

    chunks: tuple[int, ...] | None = None

    def __init__(self, shape: tuple[int, ...], scratch: Scratch) -> None:
        self.shape, self.dtype = shape, np.dtype(np.float32)
        self._scratch = scratch
        self._row_bytes = 4 * math.prod(shape[2:])
        self._map_bytes = self._row_bytes * shape[1]

    def put_maps(self, first: int, maps: NDArray[np.float32]) -> None:
        """See `Planes`."""
        self._scratch.write(first * self._map_bytes, maps)

    def put_rows(self, first: int, rows: NDArray[np.float32]) -> None:
        """See `Planes`."""
        for k, rows_of_map in enumerate(rows):
            self._scratch.write(k * self._map_bytes + first * self._row_bytes, rows_of_map)

    def maps(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Planes`."""
        found = np.empty((end - first, *self.shape[1:]), np.float32)
        self._scratch.read_into(first * self._map_bytes, found)
        return found

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """See `clrelight.tiles.PixelArray`."""
        self._scratch.read_tile_into(self.shape, tile, out, picked_n)


class ScratchBody(BodyWriter):
    """A codec's body in a file: written, then read by slices."""

    def __init__(self, workspace: ScratchWorkspace) -> None:
        super().__init__()
        self._workspace, self._length = workspace, 0
        self._scratch: Scratch | None = None

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(self._length)
        found = np.empty(max(stop - start, 0), np.uint8)
        if self._scratch is not None and found.size:
            self._scratch.read_into(start, found)
        return found.tobytes()

    def _allocate(self, n_bytes: int) -> None:
        self._scratch, self._length = self._workspace.make_scratch(n_bytes), n_bytes

    def _put(self, at: int, values_b: NDArray[np.uint8]) -> None:
        if self._scratch is None:
            raise ValueError("reserve a body's bytes before they are written")
        self._scratch.write(at, values_b)


class ScratchWorkspace(BoundedWorkspace):
    """A bounded workspace whose intermediate maps lie in files; see `scratch_workspace`."""

    def __init__(self, folder: str | os.PathLike, memory_bytes: int, progress: Progress | None = None) -> None:
        super().__init__(memory_bytes, progress)
        self._folder, self._files = folder, ExitStack()

    def make_planes(self, shape: tuple[int, ...]) -> Planes:
        """See `Workspace`."""
        return ScratchPlanes(shape, self.make_scratch(4 * math.prod(shape)))

    def make_scratch(self, n_bytes: int) -> Scratch:
        """Return a file that lasts as long as the workspace."""
        scratch = Scratch(self._folder, n_bytes)
        self._files.callback(scratch.close)
        return scratch

    def close(self) -> None:
        """Close all files."""
        self._files.close()


@contextmanager
def scratch_workspace(
    folder: str | os.PathLike, memory_bytes: int, progress: Progress | None = None
) -> Iterator[ScratchWorkspace]:
    """Lend a workspace that keeps to `memory_bytes`; its files in `folder` are gone when the block ends."""
    workspace = ScratchWorkspace(folder, memory_bytes, progress)
    try:
        with kept_within(memory_bytes):
            yield workspace
    finally:
        workspace.close()
