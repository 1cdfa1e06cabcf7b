"""Rows of all photographs of a stack, read in bands, of which parts are taken."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.recycling import empty
from clrelight.streaming import Buffer, one_thread
from clrelight.tiles import Rectangle, chunk_rows, has_columns, read_tile

_BAND_BYTES = 1 << 25
_HELD = 4


class Bands:
    """Parts of all images, of bands of rows that are held for a while; the next band is read meanwhile.

    Whole rows of what is not stored in chunks are read as they are asked for, and the next ones meanwhile.

    Parameters
    ----------
    stack : LightStack
    pool : ThreadPoolExecutor
        Of one thread.
    """

    def __init__(self, stack: LightStack, pool: ThreadPoolExecutor) -> None:
        height, width, channel = stack.image_shape
        row_bytes = stack.n_light * width * channel * np.dtype(stack.images_ihwc.dtype).itemsize
        chunks = getattr(stack.images_ihwc, "chunks", None)
        self._together = chunk_rows(stack.images_ihwc)
        self._rows = min(max(_BAND_BYTES // row_bytes // self._together, 1) * self._together, height)
        self._alone: tuple[int, NDArray] | None = None
        self._stack, self._pool, self._height = stack, pool, height
        self._held: dict[int, NDArray] = {}
        self._coming: tuple[int, Future[NDArray]] | None = None
        self._ahead: tuple[tuple[int, int], Future[NDArray]] | None = None
        # What was returned last, which a device may still read; what was read ahead, wanted or not; what is returned
        # now; and what is read ahead then.
        self._buffers = itertools.cycle([Buffer() for _ in range(4)])
        self._has_chunks, self._width, self._channel = chunks is not None, width, channel
        self._is_free = has_columns(stack.images_ihwc)

    def part(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray:
        """Return samples (n_light, rows, columns, channel), C-contiguous; those of floats are not looked at.

        They are the caller's until the next part but one has been asked for.
        """
        first, end = rows
        if columns == (0, self._width) and not self._has_chunks:
            return self._whole_rows(first, end)
        shape = (self._stack.n_light, end - first, columns[1] - columns[0], self._channel)
        found = empty(shape, self._stack.images_ihwc.dtype)
        if self._is_free:
            return read_tile(self._stack.images_ihwc, Rectangle(first, columns[0], end, columns[1]), found)
        pieces = []
        for number in range(first // self._rows, (end - 1) // self._rows + 1):
            top = number * self._rows
            within = slice(max(first - top, 0), end - top)
            pieces.append(self._band(number)[:, within, slice(*columns)])
        return np.concatenate(pieces, axis=1, out=found)  # a copy in any case

    def row(self, row: int) -> NDArray:
        """Return all samples of a row, (n_light, 1, width, channel), of rows that lie far from each other.

        Of what is stored in chunks those are read that hold it, where its band is not there already.
        """
        number, top = row // self._rows, row // self._together * self._together
        if not self._has_chunks or number in self._held or (self._coming is not None and self._coming[0] == number):
            return self.part((row, row + 1), (0, self._width))
        if self._alone is None or self._alone[0] != top:
            images, bottom = self._stack.images_ihwc, min(top + self._together, self._height)
            shape = (images.shape[0], bottom - top, *images.shape[2:])
            self._alone = top, self._stack.load_rows(top, bottom, empty(shape, images.dtype))
        return np.ascontiguousarray(self._alone[1][:, row - top : row - top + 1])

    def _whole_rows(self, first: int, end: int) -> NDArray:
        if self._ahead is not None and self._ahead[0] == (first, end):
            found = self._ahead[1].result()
        else:
            if self._ahead is not None:
                self._ahead[1].result()
            found = self._read(first, end, next(self._buffers))
        following = (end, min(2 * end - first, self._height))
        self._ahead = None
        if following[0] < following[1]:
            self._ahead = following, self._pool.submit(self._read, *following, next(self._buffers))
        return found

    def _band(self, number: int) -> NDArray:
        if number in self._held:
            return self._held[number]
        if self._coming is not None and self._coming[0] == number:
            found = self._coming[1].result()
        else:
            found = self._read_band(number)
        self._held = dict([*list(self._held.items())[1 - _HELD :], (number, found)])
        self._coming = None
        if (number + 1) * self._rows < self._height and number + 1 not in self._held:
            self._coming = number + 1, self._pool.submit(self._read_band, number + 1)
        return found

    def _read_band(self, number: int) -> NDArray:
        top = number * self._rows
        bottom = min(top + self._rows, self._height)
        images = self._stack.images_ihwc
        shape = (images.shape[0], bottom - top, *images.shape[2:])
        return self._stack.load_rows(top, bottom, empty(shape, images.dtype))

    def _read(self, first: int, end: int, buffer: Buffer) -> NDArray:
        images = self._stack.images_ihwc
        return self._stack.load_rows(
            first, end, buffer.lend((images.shape[0], end - first, *images.shape[2:]), images.dtype)
        )


@contextmanager
def bands_of(stack: LightStack) -> Iterator[Bands]:
    """Lend the bands of a stack."""
    with one_thread() as pool:
        yield Bands(stack, pool)
