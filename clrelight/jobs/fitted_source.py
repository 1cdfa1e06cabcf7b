"""Coefficients that are made of photographs when they are asked for, part by part: no map of them lies anywhere."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.registry import refuse_infinite
from clrelight.codec.finite import all_finite
from clrelight.codec.rooms import Room
from clrelight.codec.streams import Source, parts_of
from clrelight.dataset import LightStack
from clrelight.fit.precision import compute_dtype
from clrelight.fit.prepare import PreparedFit
from clrelight.fit.scaling import TileScaling
from clrelight.fit.tile import TileFit
from clrelight.harmonics.index import coefficient_count
from clrelight.streaming import Buffer, one_thread

BAND_BYTES = 1 << 26
"""Samples that are read at once; three bands are held."""


class Bands:
    """Rows of all images of a stack, read in bands; the next band is read meanwhile.

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
        self.rows = min(max(BAND_BYTES // row_bytes // chunk_rows, 1) * chunk_rows, height)
        self._stack, self._pool, self._height = stack, pool, height
        self._held: dict[int, NDArray] = {}
        self._coming: tuple[int, Future[NDArray]] | None = None

    def part(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray:
        """Return samples (n_light, rows, columns, channel), C-contiguous; those of floats are not looked at."""
        first, end = rows
        pieces = []
        for number in range(first // self.rows, (end - 1) // self.rows + 1):
            top = number * self.rows
            within = slice(max(first - top, 0), end - top)
            pieces.append(self._band(number)[:, within, slice(*columns)])
        return np.concatenate(pieces, axis=1) if len(pieces) > 1 else np.ascontiguousarray(pieces[0])

    def _band(self, number: int) -> NDArray:
        if number not in self._held:
            if self._coming is not None and self._coming[0] == number:
                found = self._coming[1].result()
            else:
                found = self._read(number)
            self._held = dict([*list(self._held.items())[-1:], (number, found)])
            self._coming = None
            if (number + 1) * self.rows < self._height:
                self._coming = number + 1, self._pool.submit(self._read, number + 1)
        return self._held[number]

    def _read(self, number: int) -> NDArray:
        top = number * self.rows
        return self._stack.load_rows(top, min(top + self.rows, self._height))


class FittedSource(Source):
    """The coefficients of a prepared fit, fitted anew whenever they are read; see `fitted_source`."""

    def __init__(self, prepared: PreparedFit, room: Room, bands: Bands) -> None:
        shape = (coefficient_count(prepared.degree), *prepared.stack.image_shape)
        super().__init__(shape, prepared.device, room)
        self._report, self._bands = prepared.report, bands
        self._scaling = TileScaling(prepared.stack, prepared.plan, compute_dtype(prepared.precision))
        self._fit = TileFit(prepared, self._scaling.curve, [Buffer(), Buffer()])

    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Source`."""
        return self.read_part((first, end), (0, self.shape[2]))

    def read_part(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """See `Source`."""
        since = time.perf_counter()
        scaled = self._scaling.scale(self._bands.part(rows, columns), rows[0], columns[0])
        since = self._report.add("read", since)
        return self._fit.run(*rows, scaled, since, slice(*columns)).coeffs_khwc

    @contextmanager
    def rows(self, multiple: int = 1) -> Iterator[Iterator[tuple[int, NDArray[np.float32]]]]:
        """See `Source`; nothing is fitted ahead: the device has other work meanwhile."""
        parts = parts_of(self.shape[1], self.room.part_rows(self.shape, multiple))
        yield ((part.start, self.read_rows(part.start, part.stop)) for part in parts)

    def check(self, coeffs_khwc: NDArray[np.float32], first_row: int) -> None:
        """Raise InputError that names a coefficient which is not finite."""
        if not all_finite(coeffs_khwc, self.device):
            refuse_infinite(coeffs_khwc, first_row)


@contextmanager
def fitted_source(prepared: PreparedFit, room: Room) -> Iterator[FittedSource]:
    """Lend the coefficients of a prepared fit to a codec."""
    with one_thread() as pool:
        yield FittedSource(prepared, room, Bands(prepared.stack, pool))
