"""Whether a few pixels of a map are so bright that a codec has nothing left for all others."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

_SHARE = 0.999
"""Of the sum of all squares: of what the others have, a codec at 30 dB keeps nothing."""
_FEW = 1e-3
"""Of the pixels."""


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
        square_hw = np.zeros(coeffs_khwc.shape[1:3])
        for maps_hwc in coeffs_khwc:
            for channel in range(maps_hwc.shape[2]):
                square_hw += np.square(maps_hwc[..., channel], dtype=np.float64)
        whole += float(square_hw.sum())
        row, column = (int(i) for i in np.unravel_index(int(square_hw.argmax()), square_hw.shape))
        if square_hw[row, column] > top:
            top, place = float(square_hw[row, column]), (first + row, column)
        brightest_p = _largest(np.concatenate([brightest_p, _largest(square_hw.ravel(), few)]), few)
    if not whole or brightest_p.sum() <= _SHARE * whole:
        return []
    many = "1 pixel" if few == 1 else f"{few} pixels"
    return [
        f"{many} of {size} hold over {_SHARE:.1%} of the map's squares, the brightest at "
        f"row {place[0]}, column {place[1]}: bits go there, and little is left for the others (mask them, or see psnr)"
    ]


def _largest(values_p: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the largest of some numbers, at most `count`, in no order."""
    if values_p.size <= count:
        return values_p
    return np.partition(values_p, values_p.size - count)[-count:]
