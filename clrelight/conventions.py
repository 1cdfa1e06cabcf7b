"""The conventions of clrelight: nothing else in the package defines an axis, a sign, an index or a curve.

* Axes are right-handed with z up; the hemisphere is z > 0. For image stacks x is right, y is up and z
  points towards the camera. A light direction is the unit vector from the surface to the light.
* Spherical harmonics are real and orthonormal on the full sphere, without the Condon-Shortley sign:
  ``Y11 = +0.488603 x`` (irradiance-environment-maps, eq. 3). Index ``k = l (l + 1) + m`` for degree ``l``
  and order ``m``; ``degree`` is the largest ``l``, so ``n_coeff = (degree + 1)**2``.
* Values are linear radiance in units of the stack's ``peak`` (the code value that means 1.0).
* Array letters: i light, k coefficient, h row, w column, c channel, p = pixel·channel flattened,
  r component of the singular value decomposition.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

TRANSFERS = ("linear", "srgb")
"""Names of the transfer curves between code values and linear radiance."""

# IEC 61966-2-1:1999, the constants of the sRGB curve.
SRGB_SLOPE = 12.92
SRGB_OFFSET = 0.055
SRGB_GAMMA = 2.4
SRGB_BREAK_ENCODED = 0.04045
SRGB_BREAK_LINEAR = 0.0031308


def default_peak(dtype: np.dtype) -> float:
    """Return the code value that means 1.0: the largest integer of an integer type, 1.0 for floats."""
    return float(np.iinfo(dtype).max) if np.issubdtype(dtype, np.integer) else 1.0


def srgb_to_linear(encoded: ArrayLike, dtype: DTypeLike = np.float64) -> NDArray:
    """Decode sRGB values in [0, 1] to linear radiance (IEC 61966-2-1), in `dtype`; others continue the curve."""
    v = np.asarray(encoded, dtype=dtype)
    power = ((np.maximum(v, 0.0) + SRGB_OFFSET) / (1.0 + SRGB_OFFSET)) ** SRGB_GAMMA
    return np.where(v <= SRGB_BREAK_ENCODED, v / SRGB_SLOPE, power)


def linear_to_srgb(linear: ArrayLike, dtype: DTypeLike = np.float64) -> NDArray:
    """Encode linear radiance with the sRGB curve (IEC 61966-2-1), in `dtype`; the inverse of `srgb_to_linear`."""
    v = np.asarray(linear, dtype=dtype)
    power = (1.0 + SRGB_OFFSET) * np.maximum(v, 0.0) ** (1.0 / SRGB_GAMMA) - SRGB_OFFSET
    return np.where(v <= SRGB_BREAK_LINEAR, v * SRGB_SLOPE, power)
