"""Run a fit over a stack, tile by tile."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import closing

import numpy as np
from numpy.typing import DTypeLike

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.fit.precision import DOUBLE, compute_dtype
from clrelight.fit.prepare import PreparedFit
from clrelight.fit.scaling import ScaledTile
from clrelight.fit.tile import FittedTile, TileFit
from clrelight.harmonics.index import coefficient_count
from clrelight.memory import DEFAULT_MEMORY
from clrelight.recycling import kept_within
from clrelight.streaming import Buffer, reading_ahead
from clrelight.tiles import chunk_rows, row_tiles


def collect_fit(
    prepared: PreparedFit,
    *,
    memory_bytes: int = DEFAULT_MEMORY,
    progress: Callable[[int, int], None] | None = None,
) -> CoefficientMap:
    """Run a prepared fit and return the whole map."""
    with closing(fit_tiles(prepared, memory_bytes=memory_bytes)) as tiles:
        return collect_tiles(prepared, tiles, progress=progress)


def collect_tiles(
    prepared: PreparedFit,
    tiles: Iterable[FittedTile],
    *,
    dtype: DTypeLike = np.float32,
    progress: Callable[[int, int], None] | None = None,
) -> CoefficientMap:
    """Return the whole map of a fit from its tiles, whose coefficients are of type `dtype`."""
    stack, method = prepared.stack, prepared.method
    n_coeff = coefficient_count(prepared.degree)
    coeffs_khwc = np.empty((n_coeff, *stack.image_shape), dtype)
    lambda_hwc = np.empty(stack.image_shape, np.float32) if method.has_lambda else None
    rank_hwc = np.empty(stack.image_shape, np.int32) if method.has_rank else None
    for tile in tiles:
        rows = slice(tile.first, tile.end)
        if rows == slice(0, stack.image_shape[0]):
            # One tile is the whole map: no second copy.
            coeffs_khwc, lambda_hwc, rank_hwc = tile.coeffs_khwc, tile.lambda_hwc, tile.rank_hwc
        else:
            coeffs_khwc[:, rows] = tile.coeffs_khwc
            if lambda_hwc is not None and tile.lambda_hwc is not None:
                lambda_hwc[rows] = tile.lambda_hwc
            if rank_hwc is not None and tile.rank_hwc is not None:
                rank_hwc[rows] = tile.rank_hwc
        if progress is not None:
            progress(tile.end, stack.image_shape[0])
    return prepared.record.to_map(coeffs_khwc, lambda_hwc, rank_hwc)


def rows_per_tile(
    prepared: PreparedFit, memory_bytes: int, *, held: int = 1, row_step: int = 1, beside: int = 0
) -> int:
    """Return how many rows a tile has within the budget; see `fit_tiles`."""
    stack = prepared.stack
    height, width, channel = stack.image_shape
    sample = stack.n_light * np.dtype(stack.images_ihwc.dtype).itemsize
    n_coeff, plan = coefficient_count(prepared.degree), prepared.plan
    # Components, the bound and its doubt; and what is handed on: coefficients, lambda or rank.
    work = compute_dtype(prepared.arithmetic).itemsize * (len(plan.singular_r) + 1) + 4
    if prepared.arithmetic == DOUBLE and plan.synthesis_kr is not None:
        work += 8 * n_coeff  # before they are rounded
    result = 4 * (n_coeff + 1)
    if memory_bytes // (width * channel * (sample + work + result + beside)) >= height:
        return height  # one tile: nothing is read ahead
    row_bytes = width * channel * (2 * sample + work + held * result + beside)
    rows = memory_bytes // row_bytes
    if rows < 1:
        raise InputError(f"one row of this fit takes {row_bytes} bytes, more than the memory budget {memory_bytes}")
    # Whole chunks of the images as well, where there is room for both.
    for step in (math.lcm(row_step, chunk_rows(stack.images_ihwc)), row_step):
        if step <= rows:
            rows -= rows % step
            break
    return int(min(rows, height))


def fit_tiles(
    prepared: PreparedFit,
    *,
    memory_bytes: int = DEFAULT_MEMORY,
    held: int = 1,
    row_step: int = 1,
    beside: int = 0,
    rows: tuple[int, int] | None = None,
) -> Generator[FittedTile, None, None]:
    """Yield the fitted rows from top to bottom; times go to ``prepared.report``.

    The next tile is read in a thread meanwhile, into memory that tiles use in turns. Close the generator where it is
    left before its end (`contextlib.closing`): then the thread has ended.

    Parameters
    ----------
    prepared : PreparedFit
    memory_bytes : int
        Bytes that tiles may take: samples of the one being read, samples and components of the one being fitted, and
        the coefficients of those held.
    held : int
        A tile's coefficients keep their values until so many more have been asked for; its other maps are its own.
    row_step : int
        Tiles have a multiple of this many rows where the budget has room: those of a chunk of where they are written.
    beside : int
        Bytes that the caller takes of the budget for each pixel and channel of a tile.
    rows : (first, end), optional
        Only these; their coefficients are those that they have in the whole image.

    Raises
    ------
    InputError
        If a row does not fit the budget, or samples are negative or not finite.
    """
    stack, report = prepared.stack, prepared.report
    scaling = prepared.scaling()
    height, width, channel = stack.image_shape
    step = rows_per_tile(prepared, memory_bytes, held=held, row_step=row_step, beside=beside)
    tiles = row_tiles(rows or (0, height), step)
    work = TileFit(prepared, scaling.curve, [Buffer() for _ in tiles[:held]])
    samples_of = itertools.cycle([Buffer() for _ in tiles[:2]])

    def read(part: tuple[int, int]) -> ScaledTile:
        if len(tiles) == 1:
            return scaling.load(*part)
        shape = (stack.n_light, part[1] - part[0], width, channel)
        return scaling.load(*part, next(samples_of).lend(shape, stack.images_ihwc.dtype))

    since = time.perf_counter()
    with kept_within(memory_bytes), reading_ahead(read, tiles) as samples:
        for part, scaled in zip(tiles, samples, strict=True):
            since = report.add("read", since)
            yield work.run(*part, scaled, since)
            since = time.perf_counter()
