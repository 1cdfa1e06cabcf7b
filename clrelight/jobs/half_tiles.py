"""The tiles of a fit that go to a file: what they hold, and those of coefficients of 16 bits."""

from __future__ import annotations

import itertools
import time
from collections.abc import Generator
from contextlib import closing
from dataclasses import replace

import numpy as np

from clrelight.codec.rounding import rounding_rows
from clrelight.fit import FittedTile, PreparedFit, fit_tiles
from clrelight.fit.run import rows_per_tile
from clrelight.harmonics.index import coefficient_count
from clrelight.streaming import Buffer

WRITTEN = 2
"""Tiles of float32 coefficients that are held: one is made while one is written."""


def check_rows(prepared: PreparedFit, dtype: np.dtype, memory: int) -> None:
    """Raise InputError where the budget does not hold a row of a fit to a file: before any file is begun."""
    halves = {"beside": _beside(prepared)} if dtype == np.float16 else {"held": WRITTEN}
    rows_per_tile(prepared, memory, **halves)


def _beside(prepared: PreparedFit) -> int:
    """Return the bytes that two tiles of halves, and maps of the method, take for each pixel and channel."""
    map_bytes = 4 * (prepared.method.has_lambda + prepared.method.has_rank)
    return 2 * 2 * coefficient_count(prepared.degree) + map_bytes


def tiles_of(
    prepared: PreparedFit,
    dtype: np.dtype,
    memory: int,
    held: int = 1,
    row_step: int = 1,
    rows: tuple[int, int] | None = None,
) -> Generator[FittedTile, None, None]:
    """Return the tiles of a fit whose coefficients are of type `dtype`; else as `fit_tiles`."""
    if dtype == np.float16:
        return _float16_tiles(prepared, memory, row_step, rows)
    return fit_tiles(prepared, memory_bytes=memory, held=held, row_step=row_step, rows=rows)


def _float16_tiles(
    prepared: PreparedFit, memory: int, row_step: int, rows: tuple[int, int] | None
) -> Generator[FittedTile, None, None]:
    """Yield each tile rounded to halves: of one tile the float32 are held, of two, one being written, the halves."""
    halves_of = itertools.cycle([Buffer(), Buffer()])
    tiles = fit_tiles(prepared, memory_bytes=memory, row_step=row_step, beside=_beside(prepared), rows=rows)
    with rounding_rows(prepared.device) as round_rows, closing(tiles):
        for tile in tiles:
            since = time.perf_counter()
            halves_khwc = next(halves_of).lend(tile.coeffs_khwc.shape, np.float16)
            rounded = replace(tile, coeffs_khwc=round_rows(tile.coeffs_khwc, halves_khwc, tile.first))
            prepared.report.add("round", since)
            yield rounded
