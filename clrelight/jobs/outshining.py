"""Whether a few pixels of a map are so bright that a codec has nothing left for all others."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.errors import counted

_SHARE = 0.999
"""Of the sum of all squares: of what the others have, a codec at 30 dB keeps nothing."""
_FEW = 1e-3
"""Of the pixels."""
_CACHED, _LEAST = 1 << 17, 1e-20
"""Values of a block, whose squares and sums stay in the caches; and the greatest sum at least where float32 holds what
matters of squares."""


def outshining_notes(parts: Iterable[tuple[int, NDArray[np.float32]]], shape: tuple[int, int, int, int]) -> list[str]:
    """Return what to say of a map where nearly all of its squares are those of a few pixels.

    Codecs share out their bits by squared errors, PSNR is of values cut at the peak: what looks well spent to the one
    is lost to the other.

    Parameters
    ----------
    parts : iterable of (int, ndarray)
        The first row of each, and its rows (n_coeff, rows, width, channel), float32, finite; all of the map. Of what
        was looked at a thousandth of the pixels is held.
    shape : four int
        (n_coeff, height, width, channel) of the map.
    """
    size = shape[1] * shape[2]
    few = int(_FEW * size)
    if not few:
        return []
    whole, top, place, brightest_p = 0.0, 0.0, (0, 0), np.empty(0)
    for first, coeffs_khwc in parts:
        square_hw = _squares(coeffs_khwc)
        whole += float(square_hw.sum())
        row, column = (int(i) for i in np.unravel_index(int(square_hw.argmax()), square_hw.shape))
        if square_hw[row, column] > top:
            top, place = float(square_hw[row, column]), (first + row, column)
        brightest_p = _largest(np.concatenate([brightest_p, _largest(square_hw.ravel(), few)]), few)
    if not whole or brightest_p.sum() <= _SHARE * whole:
        return []
    held = counted(few, f"pixel of {size} holds", f"pixels of {size} hold")
    return [
        f"{held} over {_SHARE:.1%} of the map's squares, the brightest at "
        f"row {place[0]}, column {place[1]}: bits go there, and little is left for the others (mask them, or see psnr)"
    ]


def _squares(coeffs_khwc: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return each pixel's sum of squares, by float32 where it holds them."""
    _, height, width, channel = coeffs_khwc.shape
    square_hw, step = np.empty((height, width)), max(_CACHED // (width * channel), 1)
    for top in range(0, height, step):
        block_khwc = coeffs_khwc[:, top : top + step]
        with np.errstate(over="ignore", under="ignore"):
            sums_hwc = _sums(block_khwc, np.float32)
        if not _LEAST <= sums_hwc.max() < np.inf:
            sums_hwc = _sums(block_khwc, np.float64)
        square_hw[top : top + step] = sums_hwc.sum(axis=2, dtype=np.float64)
    return square_hw


def _sums(block_khwc: NDArray[np.float32], dtype: DTypeLike) -> NDArray[np.floating]:
    sums_hwc, square_hwc = np.zeros((2, *block_khwc.shape[1:]), dtype)
    for maps_hwc in block_khwc:
        sums_hwc += np.square(maps_hwc, out=square_hwc, dtype=dtype)
    return sums_hwc


def _largest(values_p: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the largest of some numbers, at most `count`, in no order."""
    if values_p.size <= count:
        return values_p
    return np.partition(values_p, values_p.size - count)[-count:]
