"""How far samples are off at their brightness, told from what a fit leaves of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

_CLASSES, _LEAST = 24, 0.02
"""Classes of brightness; the least variance as a share of that of white."""
_FLOOR = 1e-30


@dataclass(frozen=True)
class ErrorLaw:
    """A variance that is a polynomial of brightness: constant noise, steps of codes behind a curve, what a law misses.

    Attributes
    ----------
    law_3 : ndarray, shape (3,), float64
        Of 1, brightness and its square, as a share of `top`; none is negative.
    top : float
        The greatest brightness.
    """

    law_3: NDArray[np.float64]
    top: float

    @classmethod
    def of(cls, bright_n: NDArray[np.float64], left_n: NDArray[np.float64]) -> ErrorLaw:
        """Return the law of some samples' brightness and of what is left of each, both (n,).

        Classes of brightness count by the relative error of their variance; a part of the mean is added to each, so
        that none is trusted beyond all measure.
        """
        top, squared_n = max(float(bright_n.max()), _FLOOR), left_n**2
        shares_n = bright_n / top
        edges = np.unique(np.quantile(shares_n, np.linspace(0.0, 1.0, _CLASSES + 1)))
        class_n = np.searchsorted(edges[1:-1], shares_n, side="right")
        count_c = np.bincount(class_n)
        seen_c = count_c > 0
        count_c = count_c[seen_c]
        variance_c = np.bincount(class_n, squared_n)[seen_c] / count_c + 1e-3 * squared_n.mean() + _FLOOR
        columns_c3 = _powers(np.bincount(class_n, shares_n)[seen_c] / count_c)
        law_3 = optimize.nnls(columns_c3 * (np.sqrt(count_c) / variance_c)[:, None], np.sqrt(count_c))[0]
        law_3[0] += _LEAST * law_3.sum() + _FLOOR
        return cls(law_3, top)

    def variance(self, bright_p: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the variance of samples by their brightness, (P,)."""
        found_p: NDArray[np.float64] = _powers(bright_p / self.top) @ self.law_3
        return found_p


def _powers(share_p: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([np.ones_like(share_p), share_p, share_p**2], axis=1)
