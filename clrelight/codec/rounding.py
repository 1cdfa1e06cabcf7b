"""Round a coefficient map to binary16 tile by tile, as codec `half` rounds a whole one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.formats.half import check_not_vanishing, convert, count_overflows, largest_at_first
from clrelight.device import Device


@contextmanager
def rounding_rows(
    device: Device,
) -> Iterator[Callable[[NDArray[np.float32], NDArray[np.float16], int], NDArray[np.float16]]]:
    """Lend a function that rounds some rows of one map to the nearest binary16, ties to even.

    It takes ``coeffs_khwc``, C-contiguous float32; ``halves_khwc``, which it fills and returns; and the row where they
    begin, for messages.

    Raises
    ------
    InputError
        From the function, naming the coefficient, where one rounds to infinity; at the end of the block, if nothing
        would be left of the map: every coefficient rounded to 0, though not all were 0.
    """
    largest = 0.0

    def round_rows(
        coeffs_khwc: NDArray[np.float32], halves_khwc: NDArray[np.float16], first_row: int
    ) -> NDArray[np.float16]:
        nonlocal largest
        largest = largest_at_first(coeffs_khwc, largest)
        if convert("encode_half_p", halves_khwc.reshape(-1), coeffs_khwc.reshape(-1), device, clamp=False):
            count_overflows(coeffs_khwc, first_row, "binary16", clamp=False, otherwise="store float32")
        return halves_khwc

    yield round_rows
    check_not_vanishing(largest)
