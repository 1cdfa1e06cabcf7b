"""Variances of the coefficients of functions on the sphere, by degree and by order, and their parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.index import degrees_of_coefficients

LARGEST_DEGREE = 25
"""Degrees above have no variance."""
EDGE_SLOPE = 1.5
"""``(l (l + 1))^-1.5`` is the spectrum of a step along a curve: the edge of a cast shadow as the light moves."""

_L = np.arange(LARGEST_DEGREE + 1.0)
SHARE = (2.0 * _L + 1.0) / (4.0 * np.pi)
"""Variance at a point, in the mean over the sphere, that a unit of each degree's variance makes,
shape (LARGEST_DEGREE + 1,)."""
_ROUGH = (_L * (_L + 1.0) / 2.0)[1:]
_LOG_ROUGH = np.log(_ROUGH)

_L_K = degrees_of_coefficients(LARGEST_DEGREE)
ORDERS = np.arange(len(_L_K)) - _L_K * (_L_K + 1)
"""m of each coefficient, shape (n_coeff,)."""
_TURNING_K = 3.0 * ORDERS**2 / np.maximum(_L_K * (_L_K + 1.0), 1.0) - (_L_K > 0)
"""``3 m^2 / (l (l + 1)) - 1``: 0 in the mean of a degree."""


@dataclass(frozen=True)
class Theta:
    """The parameters of the model.

    Attributes
    ----------
    level : float
        Variance of the mean over the sphere, in units of that of all other degrees together.
    slope : float
        p of ``(l (l + 1) / 2)^-p``.
    edge : float
        Weight of the edges' spectrum.
    heat : float
        tau of ``exp(-tau l (l + 1) / 2)``.
    noise : float
        Variance of one photograph's noise, in units of that of the function.
    azimuth : float
        k of ``exp(k (3 m^2 / (l (l + 1)) - 1))``: below 0 a light that is turned about the zenith changes less than
        one that is raised. 0: the sphere knows no zenith.
    tilt : float
        Factor of the variance of degree 1.
    limit : int
        Degrees above have no variance: what a band-limited function is told by.
    """

    level: float
    slope: float
    edge: float
    heat: float
    noise: float
    azimuth: float = 0.0
    tilt: float = 1.0
    limit: int = LARGEST_DEGREE

    @classmethod
    def from_logs(cls, values: NDArray[np.float64], limit: int = LARGEST_DEGREE) -> Theta:
        """Return the parameters of the numbers that are searched: logarithms of all but slope and azimuth."""
        level, edge, heat, noise, tilt = (float(np.exp(values[k])) for k in (0, 2, 3, 4, 6))
        return cls(level, float(values[1]), edge, heat, noise, float(values[5]), tilt, limit)

    def to_logs(self) -> NDArray[np.float64]:
        """Return what `from_logs` takes, shape (7,)."""
        logs = (np.log(value) for value in (self.level, self.edge, self.heat, self.noise, self.tilt))
        level, edge, heat, noise, tilt = logs
        return np.array([level, self.slope, edge, heat, noise, self.azimuth, tilt], np.float64)


def degree_variances(
    logs: NDArray[np.float64], limit: int = LARGEST_DEGREE
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the variance of each degree's coefficients, and its derivatives in the first four parameters.

    ``a_l = (s_l + w r_l) / (1 + w)`` for l >= 1, with ``s ~ L^-p exp(-tau (L - 1))``, ``r ~ L^-1.5`` and
    ``L = l (l + 1) / 2``, each 0 above the limit and scaled to variance 1 at a point; ``a_0 = 4 pi level``; a_1 times
    `Theta.tilt` beside.

    Returns
    -------
    ndarray, shape (LARGEST_DEGREE + 1,)
    ndarray, shape (4, LARGEST_DEGREE + 1)
    """
    b, slope, log_edge, log_heat = logs[:4]
    heat, edge, share = np.exp(log_heat), np.exp(log_edge), SHARE[1:]
    held_l = np.arange(1, LARGEST_DEGREE + 1) <= limit
    exponent = -slope * _LOG_ROUGH - heat * (_ROUGH - 1.0)
    s = np.exp(exponent - exponent[held_l].max()) * held_l
    s /= share @ s
    r = np.exp(-EDGE_SLOPE * _LOG_ROUGH) * held_l
    r /= share @ r
    variance_l = np.concatenate([[np.exp(b) / SHARE[0]], (s + edge * r) / (1.0 + edge)])
    slopes_tl = np.zeros((4, LARGEST_DEGREE + 1))
    slopes_tl[0, 0] = variance_l[0]
    slopes_tl[1, 1:] = -s * (_LOG_ROUGH - (share * s) @ _LOG_ROUGH) / (1.0 + edge)
    slopes_tl[2, 1:] = edge * (r - s) / (1.0 + edge) ** 2
    slopes_tl[3, 1:] = -heat * s * (_ROUGH - (share * s) @ _ROUGH) / (1.0 + edge)
    tilt = np.exp(logs[6])
    variance_l[1] *= tilt
    slopes_tl[:, 1] *= tilt
    return variance_l, slopes_tl


def order_factors(azimuth: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return by what each coefficient's variance differs from its degree's mean, and the derivative of its logarithm.

    ``exp(k (3 m^2 / (l (l + 1)) - 1))``, scaled to a mean of 1 over the orders of each degree.
    """
    factor_k = np.exp(azimuth * _TURNING_K)
    count_l = 2.0 * _L + 1.0
    factor_k /= (np.bincount(_L_K, factor_k) / count_l)[_L_K]
    return factor_k, _TURNING_K - (np.bincount(_L_K, factor_k * _TURNING_K) / count_l)[_L_K]


def coefficient_variances(theta: Theta) -> NDArray[np.float64]:
    """Return the variance of each coefficient up to `LARGEST_DEGREE`, shape (n_coeff,)."""
    variance_l, _ = degree_variances(theta.to_logs(), theta.limit)
    return np.asarray(variance_l[_L_K] * order_factors(theta.azimuth)[0])


def power_variances(slope: float) -> NDArray[np.float64]:
    """Return ``L^-slope`` for each degree, that of degree 0 as that of 1."""
    return np.append(1.0, np.exp(-slope * _LOG_ROUGH))


def zonal_kernel(variance_l: NDArray, first_t3: NDArray, second_g3: NDArray) -> NDArray[np.float64]:
    """Return the covariance of a function between directions where all orders of a degree have one variance.

    Clenshaw's sum, which holds no terms.
    """
    cosine = np.clip(first_t3 @ second_g3.T, -1.0, 1.0)
    after, next_after = np.zeros_like(cosine), np.zeros_like(cosine)
    for l in range(LARGEST_DEGREE, -1, -1):
        scratch = cosine * after
        scratch *= (2.0 * l + 1.0) / (l + 1.0)
        next_after *= -(l + 1.0) / (l + 2.0)
        next_after += scratch
        next_after += variance_l[l] * SHARE[l]
        after, next_after = next_after, after
    return after
