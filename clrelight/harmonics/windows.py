"""Windows over the degrees, against ringing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

WINDOWS = ("gaussian", "hann", "lanczos")
"""Windows over the degrees, see `window_factors`."""


def window_factors(window: str, degree: int, width: float | None = None) -> NDArray[np.float64]:
    """Return the factor of each degree l = 0 .. degree under a window that is `width` degrees wide.

    ``gaussian`` is ``exp(-2 l (l + 1) / width^2)``, diffusion on the sphere, whose kernel is nowhere negative before it
    is cut off. ``hann`` is ``(1 + cos(pi l / width)) / 2`` and ``lanczos`` ``sinc(l / width)``, both 0 from
    ``l = width`` on. The default width is ``degree + 1``. All are 1 at l = 0: the mean is kept.

    Raises
    ------
    InputError
        If the window is not one of `WINDOWS`, or the width is not positive.
    """
    wide = degree + 1.0 if width is None else float(width)
    if not 0 < wide < float("inf"):
        raise InputError(f"the width of a window must be a positive number of degrees, got {width}")
    l = np.arange(degree + 1, dtype=np.float64)
    if window == "gaussian":
        return np.exp(-2.0 * l * (l + 1.0) / wide**2)
    if window == "hann":
        return np.where(l < wide, 0.5 + 0.5 * np.cos(np.pi * l / wide), 0.0)
    if window == "lanczos":
        return np.where(l < wide, np.sinc(l / wide), 0.0)
    raise InputError(f"window must be one of {', '.join(WINDOWS)}, got {window!r}")
