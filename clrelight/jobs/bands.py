"""Rows of all photographs of a stack, read in bands, of which parts are taken."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.streaming import one_thread

_BAND_BYTES = 1 << 25
_HELD = 4


class Bands:
    """Parts of all images, of bands of rows that are held for a while; the next band is read meanwhile.

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
        chunk_rows = chunks[1] if chunks else 1
        self._rows = min(max(_BAND_BYTES // row_bytes // chunk_rows, 1) * chunk_rows, height)
        self._stack, self._pool, self._height = stack, pool, height
        self._held: dict[int, NDArray] = {}
        self._coming: tuple[int, Future[NDArray]] | None = None

    def part(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray:
        """Return samples (n_light, rows, columns, channel), C-contiguous; those of floats are not looked at."""
        first, end = rows
        pieces = []
        for number in range(first // self._rows, (end - 1) // self._rows + 1):
            top = number * self._rows
            within = slice(max(first - top, 0), end - top)
            pieces.append(self._band(number)[:, within, slice(*columns)])
        return np.concatenate(pieces, axis=1)  # a copy in any case

    def _band(self, number: int) -> NDArray:
        if number in self._held:
            return self._held[number]
        if self._coming is not None and self._coming[0] == number:
            found = self._coming[1].result()
        else:
            found = self._read(number)
        self._held = dict([*list(self._held.items())[1 - _HELD :], (number, found)])
        self._coming = None
        if (number + 1) * self._rows < self._height and number + 1 not in self._held:
            self._coming = number + 1, self._pool.submit(self._read, number + 1)
        return found

    def _read(self, number: int) -> NDArray:
        top = number * self._rows
        end, images = min(top + self._rows, self._height), self._stack.images_ihwc
        out = np.empty((images.shape[0], end - top, *images.shape[2:]), images.dtype)
        return self._stack.load_rows(top, end, out)


@contextmanager
def bands_of(stack: LightStack) -> Iterator[Bands]:
    """Lend the bands of a stack."""
    with one_thread() as pool:
        yield Bands(stack, pool)
