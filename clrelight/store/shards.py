"""``tiles/1``: a fit whose rows lie in several files, its shards, each a fit of some of them.

This program reads the shards themselves, whose seals stand in the file: one that is missing, damaged or another one is
an error. Other programs find a virtual dataset, which shows NaN where a shard is missing.
"""

from __future__ import annotations

import os
import re
import stat
import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import StoreFormatError
from clrelight.store.blocks import box_of
from clrelight.store.opening import Opened, opening, parse_config, refusing
from clrelight.store.schemas import FIT, TILES
from clrelight.store.seal import SEAL_ATTRIBUTE
from clrelight.store.stored import StoredArray
from clrelight.tiles import Rectangle, check_shape

MOST_SHARDS = 1 << 10
MOST_OPEN = 8
"""Shards that are held open: opening one takes as long as reading some megabytes of it."""
TILED = {"coefficients": 1, "lambda": 0, "rank": 0}
"""Arrays that lie in shards, and the axis of their rows."""
_FOLDER = re.compile(r"(?!\.\.?$)[^/\0]{1,255}")
_SEAL = re.compile(r"xxh3-64 [0-9a-f]{16}")


@dataclass(frozen=True)
class Shard:
    """One of the files: its name from the folder of the fit's file, its rows, and its seal."""

    file: str
    first: int
    end: int
    seal: str


def shard_name(first: int, end: int) -> str:
    """Return the name of the file of some rows."""
    return f"{first:06d}-{end:06d}.h5"


@contextmanager
def opening_fit(path: str | os.PathLike, *kinds: str) -> Iterator[Opened]:
    """Open a file as `opening` does; where fits are wanted, one in tiles is a fit like any other.

    Every shard is opened and its seal compared before this lends anything. Errors as of `opening`.
    """
    wanted = (*kinds, TILES.kind) if FIT.kind in kinds else kinds
    with ExitStack() as stack:
        opened = stack.enter_context(opening(path, *wanted))
        if opened.schema.kind == TILES.kind:
            with refusing(opened.path):
                opened.arrays.update(_arrays_of(opened, stack))
        yield opened


def seal_in(opened: Opened) -> str:
    """Return the seal of an open file, which covers all it holds."""
    holder = opened.schema.sealed
    return opened.attribute(SEAL_ATTRIBUTE, str, of=None if holder == "/" else holder)


def shards_of(opened: Opened) -> list[Shard]:
    """Return the shards that a file in tiles names; StoreFormatError where they are none."""
    manifest = parse_config(opened.attributes()["shards"], "shards")
    folder, ends, seals = (manifest.get(name) for name in ("folder", "ends", "seals"))
    if not isinstance(folder, str) or not _FOLDER.fullmatch(folder):
        raise StoreFormatError(f"its shards lie in {str(folder)[:80]!r}, expected a folder beside it")
    if not isinstance(ends, list) or not isinstance(seals, list) or not 0 < len(ends) == len(seals) <= MOST_SHARDS:
        raise StoreFormatError(f"it has no list of 1 to {MOST_SHARDS} shards with a seal for each")
    rows = list(zip([0, *ends], ends, strict=False))
    if not all(type(end) is int and first < end for first, end in rows):
        raise StoreFormatError("its shards do not follow each other")
    if not all(isinstance(seal, str) and _SEAL.fullmatch(seal) for seal in seals):
        raise StoreFormatError("a seal of its shards is none")
    return [Shard(f"{folder}/{shard_name(*each)}", *each, seal) for each, seal in zip(rows, seals, strict=True)]


def _arrays_of(opened: Opened, stack: ExitStack) -> dict[str, Any]:
    if opened.place.remote is not None:
        raise StoreFormatError("it lies in several files, which are not fetched: join them first")
    shards = shards_of(opened)
    files = _Files(os.path.dirname(opened.path), shards)
    for shard in shards:  # of a thousand that are to be opened the last may be the one that is missing
        files.path(shard)
    stack.callback(files.close)
    found: dict[str, list[tuple[int, ...]]] = {}
    types: dict[str, np.dtype] = {}
    for index, shard in enumerate(shards):
        for name, array in files.arrays(index).items():
            if name in TILED:
                found.setdefault(name, []).append(array.shape)
                count = array.shape[TILED[name]]
                if types.setdefault(name, array.dtype) != array.dtype or count != shard.end - shard.first:
                    raise StoreFormatError(f"{shard.file} has other rows or types than the others")
    merged: dict[str, Any] = {}
    for name, shapes in found.items():
        axis = TILED[name]
        if len(shapes) != len(shards) or len({(s[:axis], s[axis + 1 :]) for s in shapes}) != 1:
            raise StoreFormatError(f"its shards differ in the shape of {name}")
        shape = (*shapes[0][:axis], shards[-1].end, *shapes[0][axis + 1 :])
        merged[name] = TiledArray(files, name, axis, shape, types[name])
    if "coefficients" not in merged:
        raise StoreFormatError("its shards hold no coefficients")
    return merged


class _Files:
    """The shards on the disk, of which the few that were asked for last are open."""

    def __init__(self, folder: str, shards: Sequence[Shard]) -> None:
        self.shards = shards
        self._folder = folder
        self._held: OrderedDict[int, tuple[ExitStack, dict[str, StoredArray]]] = OrderedDict()
        self.one_at_a_time = threading.RLock()

    def path(self, shard: Shard) -> str:
        """Return where a shard lies; StoreFormatError if there is no file."""
        path = os.path.join(self._folder, shard.file)
        try:
            mode = os.lstat(path).st_mode
        except OSError:
            raise StoreFormatError(f"its shard {shard.file[:300]} is missing") from None
        if not stat.S_ISREG(mode):
            raise StoreFormatError(f"its shard {shard.file} is no regular file")
        return path

    def arrays(self, index: int) -> dict[str, StoredArray]:
        """Return the arrays of a shard, until `MOST_OPEN` others were asked for."""
        if index not in self._held:
            shard = self.shards[index]
            with ExitStack() as stack:
                opened = stack.enter_context(opening(self.path(shard), FIT.kind))
                if seal_in(opened) != shard.seal:
                    raise StoreFormatError(f"its shard {shard.file} is not the one that was written")
                self._held[index] = stack.pop_all(), opened.arrays
            while len(self._held) > MOST_OPEN:
                self._held.popitem(last=False)[1][0].close()
        self._held.move_to_end(index)
        return self._held[index][1]

    def close(self) -> None:
        while self._held:
            self._held.popitem()[1][0].close()


class TiledArray:
    """An array whose rows lie in several files, read as a `StoredArray` is.

    Attributes
    ----------
    shape, dtype, ndim, size, chunks
        As of an HDF5 dataset; chunks are those of the first shard.
    """

    def __init__(self, files: _Files, name: str, axis: int, shape: tuple[int, ...], dtype: np.dtype) -> None:
        self.shape, self.dtype, self.ndim = shape, dtype, len(shape)
        self.size = int(np.prod(shape, dtype=object))
        self._files, self._name, self._axis = files, name, axis
        self.chunks = files.arrays(0)[name].chunks

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> NDArray:
        """Read a selection: integers, slices, and lists of integers."""
        box, rest = box_of(key, self.shape)
        out = np.empty([part.stop - part.start for part in box], self.dtype)
        rows, before, behind = box[self._axis], box[: self._axis], box[self._axis + 1 :]
        self._fill(rows.start, rows.stop, out, lambda array, part: array[(*before, part, *behind)])
        return out[rest]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        """Read everything."""
        whole = self[...]
        return whole if dtype is None else whole.astype(dtype, copy=False)

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """See `clrelight.tiles.PixelArray`; the axis of tiles is the second."""
        check_shape(tile, out, self.shape, picked_n)
        which = slice(None) if picked_n is None else picked_n
        self._fill(tile.top, tile.bottom, out, lambda array, part: array[:, part, tile.columns][which])

    def _fill(self, first: int, end: int, out: NDArray, read: Any) -> None:
        with self._files.one_at_a_time:
            for index, shard in enumerate(self._files.shards):
                low, high = max(first, shard.first), min(end, shard.end)
                if low < high:
                    part = slice(low - shard.first, high - shard.first)
                    place = (*(slice(None),) * self._axis, slice(low - first, high - first))
                    out[place] = read(self._files.arrays(index)[self._name], part)
