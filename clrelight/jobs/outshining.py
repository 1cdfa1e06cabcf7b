"""Whether a few pixels of a map are so bright that a codec has nothing left for all others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SHARE = 0.999
"""Of the sum of all squares: of what the others have, a codec at 30 dB keeps nothing."""
_FEW = 1e-3
"""Of the pixels."""


def outshining_notes(coeffs_khwc: NDArray[np.float32] | None) -> list[str]:
    """Return what to say of a map where nearly all of its squares are those of a few pixels.

    Codecs share out their bits by squared errors, PSNR is of values cut at the peak: what looks well spent to the one
    is lost to the other.

    Parameters
    ----------
    coeffs_khwc : ndarray, shape (n_coeff, height, width, channel), float32, or None
        Finite; of what does not lie in memory nothing is said.
    """
    if coeffs_khwc is None:
        return []
    square_hw = np.zeros(coeffs_khwc.shape[1:3])
    for maps_hwc in coeffs_khwc:
        for channel in range(maps_hwc.shape[2]):
            square_hw += np.square(maps_hwc[..., channel], dtype=np.float64)
    few = int(_FEW * square_hw.size)
    whole = float(square_hw.sum())
    if not few or not whole:
        return []
    brightest_p = np.partition(square_hw, square_hw.size - few, axis=None)[-few:]
    if brightest_p.sum() <= _SHARE * whole:
        return []
    row, column = (int(i) for i in np.unravel_index(int(square_hw.argmax()), square_hw.shape))
    many = "1 pixel" if few == 1 else f"{few} pixels"
    return [
        f"{many} of {square_hw.size} hold over {_SHARE:.1%} of the map's squares, the brightest at "
        f"row {row}, column {column}: bits go there, and little is left for the others (mask them, or see psnr)"
    ]
