"""From reflectance at wavelengths to the linear sRGB that it shows under white light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LOBES = (
    ((1.056, 599.8, 37.9, 31.0), (0.362, 442.0, 16.0, 26.7), (-0.065, 501.1, 20.4, 26.2)),
    ((0.821, 568.8, 46.9, 40.5), (0.286, 530.9, 16.3, 31.1)),
    ((1.217, 437.0, 11.8, 36.0), (0.681, 459.0, 26.0, 13.8)),
)
"""Height, place and width below and above it, in nm, of the lobes of x, y and z (Wyman, Sloan and Shirley 2013)."""

_XYZ_TO_RGB = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)
"""To linear sRGB, whose white is D65 (IEC 61966-2-1)."""


def matching_functions(wavelength_w: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the CIE 1931 observer's colour matching functions at wavelengths in nm, (3, n) float64.

    By the multi-lobe fit of Wyman, Sloan and Shirley (2013, eq. 4), which is within 1% of the tables' peaks.
    """
    rows = []
    for lobes in _LOBES:
        row_w = np.zeros(len(wavelength_w))
        for height, place, below, above in lobes:
            off_w = (wavelength_w - place) / np.where(wavelength_w < place, below, above)
            row_w += height * np.exp(-0.5 * off_w * off_w)
        rows.append(row_w)
    return np.stack(rows)


def xyz_weights(wavelength_w: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix (3, n) from reflectance at wavelengths in nm to X, Y, Z under light of equal energy.

    A perfect white has 1 in each.
    """
    weights_cw = matching_functions(np.asarray(wavelength_w, np.float64))
    return weights_cw / weights_cw.sum(axis=1, keepdims=True)


def rgb_of_xyz(xyz_jc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return linear red, green and blue of X, Y, Z as `xyz_weights` scales them, (..., 3); below 0 it is cut.

    The matrix's rows are scaled so that white, 1 in each, stays so.
    """
    matrix = _XYZ_TO_RGB / _XYZ_TO_RGB.sum(axis=1, keepdims=True)
    return np.maximum(xyz_jc @ matrix.T, 0.0)
