"""Kriging on the sphere: the map from samples to the functions that are expected under a prior, and its variance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.axial import AxialStep
from clrelight.fit.places import Places, spread_points
from clrelight.fit.plan import is_sphere
from clrelight.fit.zonal import (
    LARGEST_DEGREE,
    SHARE,
    Theta,
    coefficient_variances,
    degree_variances,
    power_variances,
    zonal_kernel,
)
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count, degrees_of_coefficients

_SPREAD = 2000
_RIDGE = 1e-9, 1e-6
_LEAST_VARIANCE = 1e-4
_LEAST_SHARE = 1e-12
"""Of a function's variance: less is rounding."""


@dataclass(frozen=True)
class KrigingModel:
    """The model at the lights of one stack.

    Attributes
    ----------
    places : Places
    theta : Theta
    step : AxialStep or None
        What the samples add to the prior of the parameters.
    variance_l : ndarray, shape (LARGEST_DEGREE + 1,)
        Of the parameters' prior, the mean of each degree.
    variance_k : ndarray, shape (n_coeff,)
        The same of each coefficient.
    scaled_gk : ndarray, shape (n_place, n_coeff)
        ``Y A``, A the covariance of the coefficients.
    noise : float
        Variance of one photograph's noise.
    covariance_gg : ndarray, shape (n_place, n_place)
        C, of the means of each place's photographs.
    inverse_gg : ndarray, shape (n_place, n_place)
    """

    places: Places
    theta: Theta
    step: AxialStep | None
    variance_l: NDArray[np.float64]
    variance_k: NDArray[np.float64]
    scaled_gk: NDArray[np.float64]
    noise: float
    covariance_gg: NDArray[np.float64]
    inverse_gg: NDArray[np.float64]

    @classmethod
    def make(cls, places: Places, theta: Theta, step: AxialStep | None = None) -> KrigingModel:
        """Return the model of these lights."""
        variance_l, _ = degree_variances(theta.to_logs(), theta.limit)
        variance_k = coefficient_variances(theta)
        noise = theta.noise * float(SHARE @ variance_l)
        basis_gk = evaluate_basis(places.directions_g3, LARGEST_DEGREE)
        scaled_gk = basis_gk * variance_k
        if step is not None:
            scaled_gk = step.add_to(scaled_gk, basis_gk)
        covariance_gg = scaled_gk @ basis_gk.T + np.diag(noise / places.count_g)
        inverse_gg = np.asarray(np.linalg.inv(covariance_gg))
        return cls(places, theta, step, variance_l, variance_k, scaled_gk, noise, covariance_gg, inverse_gg)

    @cached_property
    def plain(self) -> KrigingModel:
        """The model without the step.

        What it makes of lights that are left out is honest: a handful of parameters know nothing of one light. A step
        knows the moments of all, and gains a third of what it seems to at lights left out from a step without them.
        """
        return self if self.step is None else KrigingModel.make(self.places, self.theta)

    @cached_property
    def whole_ki(self) -> NDArray[np.float64]:
        """The map at `LARGEST_DEGREE`, ``A Y' C^-1`` of the means, shape (n_coeff, n_light)."""
        return np.asarray(self.scaled_gk.T @ self.inverse_gg @ self.places.mean_gi)

    @cached_property
    def _series(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Least squares over points spread evenly: the moments of the basis, and with the whole map."""
        normal_kk = _spread_moments(is_sphere(self.places.directions_g3))
        return normal_kk, normal_kk @ self.whole_ki

    def _kernel_to(self, basis_tk: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(basis_tk @ self.scaled_gk.T)

    def weights_at(self, targets_t3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the weight of each photograph in the value at each direction, shape (n_target, n_light)."""
        return self._kernel_to(evaluate_basis(targets_t3, LARGEST_DEGREE)) @ self.inverse_gg @ self.places.mean_gi

    def variance_at(self, targets_t3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the posterior variance of a photograph under each direction, noise included, without the step."""
        if self.step is not None:
            return self.plain.variance_at(targets_t3)
        basis_tk = evaluate_basis(targets_t3, LARGEST_DEGREE)
        kernel_tg = self._kernel_to(basis_tk)
        explained_t = np.einsum("ij,ij->i", kernel_tg @ self.inverse_gg, kernel_tg)
        return np.maximum(basis_tk**2 @ self.variance_k - explained_t, 0.0) + self.noise

    def variance_of(self, sums_gz: NDArray[np.float64], slope: float) -> NDArray[np.float64]:
        """Return the variance of sums over the lights of a function without noise whose variances are ``L^-slope``."""
        variance_l = power_variances(slope)
        covariance_gg = zonal_kernel(variance_l, self.places.directions_g3, self.places.directions_g3)
        return _floored(np.einsum("iz,ij,jz->z", sums_gz, covariance_gg, sums_gz, optimize=True), variance_l)

    def error_variance_at(self, targets_t3: NDArray[np.float64], slope: float) -> NDArray[np.float64]:
        """Return the variance of this model's error at each direction for such a function."""
        variance_l, directions_g3 = power_variances(slope), self.places.directions_g3
        weight_tg = self._kernel_to(evaluate_basis(targets_t3, LARGEST_DEGREE)) @ self.inverse_gg
        cross_t = np.einsum("ij,ij->i", weight_tg, zonal_kernel(variance_l, targets_t3, directions_g3))
        own_t = np.einsum("ij,ij->i", weight_tg @ zonal_kernel(variance_l, directions_g3, directions_g3), weight_tg)
        return _floored(SHARE @ variance_l - 2.0 * cross_t + own_t, variance_l)

    def map_samples(self, degree: int) -> NDArray[np.float64]:
        """Return the matrix from samples to coefficients, shape (n_coeff, n_light).

        From the model's limit on it is ``A Y' C^-1``, further coefficients being 0. Below it is the series that
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


@cache
def _spread_moments(sphere: bool) -> NDArray[np.float64]:
    """Return the moments of the basis over points spread evenly, shape (n_coeff, n_coeff)."""
    basis_tk = evaluate_basis(spread_points(_SPREAD, sphere), LARGEST_DEGREE)
    return np.asarray(basis_tk.T @ basis_tk / len(basis_tk))


def _floored(variance: NDArray, variance_l: NDArray) -> NDArray[np.float64]:
    return np.maximum(variance, _LEAST_SHARE * float(SHARE @ variance_l))
