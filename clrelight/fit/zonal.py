"""Functions on the sphere whose coefficients are Gaussian with a variance for each degree: the map that fits them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.places import Places, spread_points
from clrelight.fit.plan import is_sphere
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count, degrees_of_coefficients

LARGEST_DEGREE = 25
"""Degrees above have no variance."""
EDGE_SLOPE = 1.5
"""``(l (l + 1))^-1.5`` is the spectrum of a step along a curve: the edge of a cast shadow as the light moves."""

_L = np.arange(LARGEST_DEGREE + 1.0)
SHARE = (2.0 * _L + 1.0) / (4.0 * np.pi)
"""Variance at a point that a unit of each degree's variance makes, shape (LARGEST_DEGREE + 1,)."""
_ROUGH = (_L * (_L + 1.0) / 2.0)[1:]
_LOG_ROUGH = np.log(_ROUGH)

_SPREAD = 2000
_RIDGE = 1e-9, 1e-6
_LEAST_VARIANCE = 1e-4
_LEAST_SHARE = 1e-12
"""Of a function's variance: less is rounding."""


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
    limit : int
        Degrees above have no variance: what a band-limited function is told by.
    """

    level: float
    slope: float
    edge: float
    heat: float
    noise: float
    limit: int = LARGEST_DEGREE

    @classmethod
    def from_logs(cls, values: NDArray[np.float64], limit: int = LARGEST_DEGREE) -> Theta:
        """Return the parameters of the numbers that are searched: logarithms of the first five but the slope."""
        level, edge, heat, noise = (float(np.exp(values[k])) for k in (0, 2, 3, 4))
        return cls(level, float(values[1]), edge, heat, noise, limit)

    def to_logs(self) -> NDArray[np.float64]:
        """Return what `from_logs` takes, shape (5,)."""
        return np.array(
            [np.log(self.level), self.slope, np.log(self.edge), np.log(self.heat), np.log(self.noise)], np.float64
        )


def degree_variances(
    logs: NDArray[np.float64], limit: int = LARGEST_DEGREE
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the variance of each degree's coefficients, and its derivatives in the first four parameters.

    ``a_l = (s_l + w r_l) / (1 + w)`` for l >= 1, with ``s ~ L^-p exp(-tau (L - 1))``, ``r ~ L^-1.5`` and
    ``L = l (l + 1) / 2``, each 0 above the limit and scaled to variance 1 at a point; ``a_0 = 4 pi level``.

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
    return variance_l, slopes_tl


def legendre_terms(cosine: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(2 l + 1) / (4 pi) P_l``, shape (LARGEST_DEGREE + 1, ...): the kernel is their sum times a_l."""
    terms = np.empty((LARGEST_DEGREE + 1, *cosine.shape))
    terms[0], terms[1] = 1.0, cosine
    for l in range(1, LARGEST_DEGREE):
        terms[l + 1] = ((2 * l + 1) * cosine * terms[l] - l * terms[l - 1]) / (l + 1)
    return terms * SHARE.reshape(-1, *[1] * cosine.ndim)


@dataclass(frozen=True)
class ZonalModel:
    """The model at the lights of one stack.

    Attributes
    ----------
    places : Places
    theta : Theta
    variance_l : ndarray, shape (LARGEST_DEGREE + 1,)
    noise : float
        Variance of one photograph's noise.
    covariance_gg : ndarray, shape (n_place, n_place)
        C, of the means of each place's photographs.
    inverse_gg : ndarray, shape (n_place, n_place)
    """

    places: Places
    theta: Theta
    variance_l: NDArray[np.float64]
    noise: float
    covariance_gg: NDArray[np.float64]
    inverse_gg: NDArray[np.float64]

    @classmethod
    def make(cls, places: Places, theta: Theta) -> ZonalModel:
        """Return the model of these lights."""
        variance_l, _ = degree_variances(theta.to_logs(), theta.limit)
        noise = theta.noise * float(SHARE @ variance_l)
        covariance_gg = _kernel(variance_l, places.directions_g3, places.directions_g3) + np.diag(
            noise / places.count_g
        )
        return cls(places, theta, variance_l, noise, covariance_gg, np.asarray(np.linalg.inv(covariance_gg)))

    @cached_property
    def whole_ki(self) -> NDArray[np.float64]:
        """The map at `LARGEST_DEGREE`, ``diag(a) Y' C^-1`` of the means, shape (n_coeff, n_light)."""
        basis_gk = evaluate_basis(self.places.directions_g3, LARGEST_DEGREE)
        variance_k = self.variance_l[degrees_of_coefficients(LARGEST_DEGREE)]
        return np.asarray(variance_k[:, None] * (basis_gk.T @ self.inverse_gg @ self.places.mean_gi))

    @cached_property
    def _series(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Least squares over points spread evenly: the moments of the basis, and with the whole map."""
        points = spread_points(_SPREAD, is_sphere(self.places.directions_g3))
        basis_tk = evaluate_basis(points, LARGEST_DEGREE)
        normal_kk = basis_tk.T @ basis_tk / len(points)
        return normal_kk, normal_kk @ self.whole_ki

    def weights_at(self, targets_t3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the weight of each photograph in the value at each direction, shape (n_target, n_light)."""
        kernel_tg = _kernel(self.variance_l, targets_t3, self.places.directions_g3)
        return kernel_tg @ self.inverse_gg @ self.places.mean_gi

    def variance_at(self, targets_t3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the posterior variance of a photograph under each direction, noise included."""
        kernel_tg = _kernel(self.variance_l, targets_t3, self.places.directions_g3)
        explained_t = np.einsum("ij,jk,ik->i", kernel_tg, self.inverse_gg, kernel_tg)
        return np.maximum(SHARE @ self.variance_l - explained_t, 0.0) + self.noise

    def variance_of(self, sums_gz: NDArray[np.float64], slope: float) -> NDArray[np.float64]:
        """Return the variance of sums over the lights of a function without noise whose variances are ``L^-slope``."""
        variance_l = _power_variances(slope)
        covariance_gg = _kernel(variance_l, self.places.directions_g3, self.places.directions_g3)
        return _floored(np.einsum("iz,ij,jz->z", sums_gz, covariance_gg, sums_gz, optimize=True), variance_l)

    def error_variance_at(self, targets_t3: NDArray[np.float64], slope: float) -> NDArray[np.float64]:
        """Return the variance of this model's error at each direction for such a function."""
        variance_l, directions_g3 = _power_variances(slope), self.places.directions_g3
        weight_tg = _kernel(self.variance_l, targets_t3, directions_g3) @ self.inverse_gg
        cross_t = np.einsum("ij,ij->i", weight_tg, _kernel(variance_l, targets_t3, directions_g3))
        own_t = np.einsum("ij,ij->i", weight_tg @ _kernel(variance_l, directions_g3, directions_g3), weight_tg)
        return _floored(SHARE @ variance_l - 2.0 * cross_t + own_t, variance_l)

    def map_samples(self, degree: int) -> NDArray[np.float64]:
        """Return the matrix from samples to coefficients, shape (n_coeff, n_light).

        From the model's limit on it is ``diag(a) Y' C^-1``, further coefficients being 0. Below it is the series that
        is nearest to that over the hemisphere (the sphere, where there are lights below the horizon): least squares
        over points spread evenly, with a ridge that settles what they do not see.
        """
        if degree >= self.theta.limit:
            kept_ki = self.whole_ki[: coefficient_count(degree)]
            return np.pad(kept_ki, ((0, coefficient_count(degree) - len(kept_ki)), (0, 0)))
        normal_kk, whole_ki = (moments[: coefficient_count(degree)] for moments in self._series)
        relative_l = np.maximum(self.variance_l / self.variance_l.max(), _LEAST_VARIANCE)
        relative_k = relative_l[degrees_of_coefficients(degree)]
        ridge = float(np.clip(1e-3 * self.theta.noise, *_RIDGE))
        return np.asarray(np.linalg.solve(normal_kk[:, : len(normal_kk)] + np.diag(ridge / relative_k), whole_ki))


def _power_variances(slope: float) -> NDArray[np.float64]:
    """Return ``L^-slope`` for each degree, that of degree 0 as that of 1."""
    return np.append(1.0, np.exp(-slope * _LOG_ROUGH))


def _floored(variance: NDArray, variance_l: NDArray) -> NDArray[np.float64]:
    return np.maximum(variance, _LEAST_SHARE * float(SHARE @ variance_l))


def _kernel(variance_l: NDArray, first_t3: NDArray, second_g3: NDArray) -> NDArray[np.float64]:
    """Return the covariance of the function between directions: Clenshaw's sum, which holds no terms."""
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
