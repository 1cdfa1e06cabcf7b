"""Arrays in blocks: which blocks a selection touches, and reading and writing them with a checksum each.

A block is a chunk of the dataset, cut where the array ends; a dataset without chunks is one block. Its checksum is that
of its values, uncompressed and in C order, so that a copy by another HDF5 tool keeps it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import h5py
import numpy as np
import xxhash
from numpy.typing import NDArray

SUM_DTYPE = np.dtype("<u8")

Box = tuple[slice, ...]
"""A contiguous part of an array: start and stop along each axis."""


def checksum(values: NDArray) -> int:
    """Return XXH3-64 of an array's bytes in C order."""
    return xxhash.xxh3_64_intdigest(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)


@dataclass(frozen=True)
class Blocks:
    """How an array is divided.

    Attributes
    ----------
    shape, extent : tuple of int
        Of the array, and of a block.
    """

    shape: tuple[int, ...]
    extent: tuple[int, ...]

    @classmethod
    def of(cls, dataset: h5py.Dataset) -> Blocks:
        """Return the blocks of a dataset."""
        return cls(tuple(dataset.shape), tuple(dataset.chunks or dataset.shape))

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Number of blocks along each axis."""
        return tuple(-(-n // e) if e else 0 for n, e in zip(self.shape, self.extent, strict=True))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return math.prod(self.counts)

    def touched(self, box: Box) -> Iterator[tuple[int, Box]]:
        """Yield the number and the place of each block that has a part in `box`, in C order."""
        axes = []
        for part, n, extent in zip(box, self.shape, self.extent, strict=True):
            if part.start >= part.stop:
                return
            first, end = part.start // extent, -(-part.stop // extent)
            axes.append([(i, slice(i * extent, min((i + 1) * extent, n))) for i in range(first, end)])
        for found in itertools.product(*axes):
            number = 0
            for (i, _), count in zip(found, self.counts, strict=True):
                number = number * count + i
            yield number, tuple([place for _, place in found])

    @property
    def everything(self) -> Box:
        """The box that is the array."""
        return tuple(slice(0, n) for n in self.shape)


def box_of(key: Any, shape: tuple[int, ...]) -> tuple[Box, tuple[Any, ...]]:
    """Return the least box that holds what an index selects, and the index within that box.

    Raises IndexError as NumPy does where the array ends before.
    """
    pieces = key if isinstance(key, tuple) else (key,)
    at = next((i for i, piece in enumerate(pieces) if piece is Ellipsis), len(pieces))
    filling = [slice(None)] * (len(shape) - len(pieces) + (at < len(pieces)))
    pieces = (*pieces[:at], *filling, *pieces[at + 1 :])
    if len(pieces) != len(shape):
        raise IndexError(f"an array of {len(shape)} axes has no {len(pieces)} indices")
    found = [_range_of(piece, n) for piece, n in zip(pieces, shape, strict=True)]
    return tuple(part for part, _ in found), tuple(rest for _, rest in found)


def _range_of(piece: Any, n: int) -> tuple[slice, Any]:
    if isinstance(piece, slice):
        start, stop, step = piece.indices(n)
        if step < 1:
            raise IndexError(f"expected a step of at least 1, got {step}")
        stop = max(start, stop)
        return slice(start, stop), slice(0, stop - start, step)
    index = np.asarray(piece)
    if index.dtype == np.bool_:
        index = np.flatnonzero(index)
    index = np.where(index < 0, index + n, index)
    if index.size and not (index.min() >= 0 and index.max() < n):
        raise IndexError(f"index {piece} is not within 0 and {n - 1}")
    start = int(index.min()) if index.size else 0
    stop = int(index.max()) + 1 if index.size else 0
    return slice(start, stop), (index - start if index.ndim else int(index - start))


def _overlap(a: Box, b: Box) -> Box:
    return tuple(slice(max(p.start, q.start), min(p.stop, q.stop)) for p, q in zip(a, b, strict=True))


def _within(inner: Box, outer: Box) -> Box:
    """Return where `inner` lies, counted from where `outer` begins."""
    return tuple(slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))


def _runs(rows_n: NDArray[np.intp], images_n: NDArray[np.intp]) -> Iterator[tuple[int, int, int]]:
    """Yield row, image and number where both go on one by one: NumPy copies slices once, and lists twice."""
    starts_r = np.flatnonzero(np.append(True, (np.diff(rows_n) != 1) | (np.diff(images_n) != 1)))
    for start, stop in itertools.pairwise([*starts_r.tolist(), len(rows_n)]):
        yield int(rows_n[start]), int(images_n[start]), stop - start


class BlockReader:
    """Reads a dataset block by block; nothing of a block is handed on before its checksum was found right."""

    def __init__(self, dataset: h5py.Dataset, sums_b: NDArray[np.uint64]) -> None:
        self._dataset, self._sums = dataset, sums_b
        self._blocks = Blocks.of(dataset)
        self._is_plain = dataset.chunks is not None and not dataset.id.get_create_plist().get_nfilters()
        self._number = -1  # of the block in `_held`: who reads row by row reads a block once
        self._held = np.empty(0, dataset.dtype)
        self._buffer = np.empty(0, np.uint8)

    def read_into(self, box: Box, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """Read `box` to `out`, of that shape; or ``[picked_n, *box[1:]]``, where box[0] must span `picked_n`.

        Raises OSError for a damaged block.
        """
        runs: dict[int, list[tuple[int, int, int]]] = {}  # by a block's first image
        for number, place in self._blocks.touched(box):
            inner = _overlap(box, place)
            source, target = _within(inner, place), _within(inner, box)
            if picked_n is None:
                out[target] = self._read_block(number, place)[source]
                continue
            start = place[0].start
            if start not in runs:
                rows_n = np.flatnonzero((picked_n >= start) & (picked_n < place[0].stop))
                runs[start] = list(_runs(rows_n, picked_n[rows_n] - start)) if rows_n.size else []
            if runs[start]:
                block = self._read_block(number, place)
                for row, image, count in runs[start]:
                    out[(slice(row, row + count), *target[1:])] = block[(slice(image, image + count), *source[1:])]

    def _read_block(self, number: int, place: Box) -> NDArray:
        if number != self._number:
            self._number = -1
            self._held = self._read_chunk(place) if self._is_plain else self._dataset[place]
            if checksum(self._held) != self._sums[number]:
                raise OSError(f"the checksum of its block {number} is wrong")
            self._number = number
        return self._held

    def _read_chunk(self, place: Box) -> NDArray:
        extent = self._blocks.extent
        if not self._buffer.size:
            self._buffer = np.empty(math.prod(extent) * self._dataset.dtype.itemsize, np.uint8)
        _, stored = self._dataset.id.read_direct_chunk(tuple(part.start for part in place), out=self._buffer)
        if len(stored) != self._buffer.size:
            raise OSError(f"a block has {len(stored)} bytes, expected {self._buffer.size}")
        values = self._buffer.view(self._dataset.dtype).reshape(extent)
        return values[tuple(slice(0, part.stop - part.start) for part in place)]


class BlockWriter:
    """Writes a dataset without filters, and takes the checksum of each block.

    A block that is written at once is summed on its way to the file; of others the file is read once, at the end.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._dataset, self.blocks = dataset, Blocks.of(dataset)
        self._is_chunked = dataset.chunks is not None
        self._sums = np.zeros(self.blocks.count, SUM_DTYPE)
        self._is_summed = np.zeros(self.blocks.count, np.bool_)
        self._buffer = np.empty(0, dataset.dtype)

    def write(self, box: Box, values: NDArray) -> None:
        """Write an array of the shape of `box` and the dataset's type."""
        for number, place in self.blocks.touched(box):
            inner = _overlap(box, place)
            part = values[_within(inner, box)]
            if inner == place:
                self._write_block(number, place, part)
            else:
                self._dataset[inner] = part
                self._is_summed[number] = False

    def sums(self) -> NDArray[np.uint64]:
        """Return the checksums of all blocks, which must be written."""
        missing = np.flatnonzero(~self._is_summed)
        if missing.size:
            waiting = set(missing.tolist())
            for number, place in self.blocks.touched(self.blocks.everything):
                if number in waiting:
                    self._sums[number] = checksum(self._dataset[place])
            self._is_summed[:] = True
        return self._sums

    def _write_block(self, number: int, place: Box, values: NDArray) -> None:
        self._is_summed[number] = True
        if not self._is_chunked:
            self._dataset[place] = values
            self._sums[number] = checksum(values)
            return
        if not self._buffer.size:
            self._buffer = np.zeros(self.blocks.extent, self._dataset.dtype)
        block = self._buffer
        if values.shape != block.shape:
            block.view(np.uint8)[...] = 0  # what the array's edge cuts off
            block = block[tuple(slice(0, n) for n in values.shape)]
        block[...] = values
        self._sums[number] = checksum(block)
        self._dataset.id.write_direct_chunk(tuple([part.start for part in place]), self._buffer)
