"""One pass over a stack: its rows tile by tile, the next being read while the caller has one."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.errors import InputError
from clrelight.memory import TILE_BYTES
from clrelight.streaming import Buffer, reading_ahead
from clrelight.tiles import Span, row_tiles


def rows_within(row_bytes: int, budget: int, of: str = "stack") -> int:
    """Return how many rows fit a budget; InputError where not one does."""
    if budget < row_bytes:
        raise InputError(f"one row of this {of} takes {row_bytes} bytes, more than the memory budget {budget}")
    return budget // row_bytes


def map_rows(coefficients: CoefficientMap, most_bytes: int = TILE_BYTES) -> Iterator[tuple[Span, NDArray[np.float32]]]:
    """Yield rows of a map, from the first to before the end, and their coefficients (n_coeff, rows, width, channel)."""
    height, width, channel = coefficients.image_shape
    for rows in row_tiles((0, height), max(most_bytes // (4 * coefficients.n_coeff * width * channel), 1)):
        shape = (coefficients.n_coeff, rows[1] - rows[0], width, channel)
        yield rows, coefficients.read_rows(*rows, np.empty(shape, np.float32))


@contextmanager
def stack_rows(stack: LightStack, step: int) -> Iterator[Iterator[tuple[int, int, NDArray]]]:
    """Lend the first row, the one behind the last, and the samples (n_light, rows, width, channel) of each tile.

    Samples are the caller's until the next tile but one is asked for. InputError as `LightStack.read_rows` raises it.
    """
    height, width, channel = stack.image_shape
    tiles = row_tiles((0, height), step)
    buffers = itertools.cycle([Buffer(), Buffer()])

    def read(rows: Span) -> NDArray:
        if len(tiles) == 1:
            return stack.read_rows(*rows)  # an array in memory as it lies
        shape = (stack.n_light, rows[1] - rows[0], width, channel)
        return stack.read_rows(*rows, next(buffers).lend(shape, stack.images_ihwc.dtype))

    with reading_ahead(read, tiles) as samples:
        yield ((first, end, tile_ihwc) for (first, end), tile_ihwc in zip(tiles, samples, strict=True))
