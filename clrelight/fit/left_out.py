"""The parameters of `clrelight.fit.zonal` for which lights that are left out are foretold best."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.places import Places, find_gap_radii, find_zones, stack_zones
from clrelight.fit.zonal import LARGEST_DEGREE, SHARE, Theta, degree_variances, order_factors
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count, degrees_of_coefficients

PRIOR_MEAN = np.array([-1.0, 2.0, -3.0, -4.0, -8.0, 0.0, 0.0])
"""Of log level, slope, log edge, log heat, log noise, azimuth and log tilt: photographs of many kinds lie around it."""
PRIOR_SD = np.array([1.5, 1.5, 2.0, 2.0, 1.5, 1.0, 1.5])
_LOW = np.array([-6.0, -3.0, -14.0, -9.0, np.log(1e-9), -3.0, -4.0])
_HIGH = np.array([8.0, 6.0, 6.0, 2.0, np.log(0.5), 3.0, 6.0])
_STARTS = np.array([[1.0, 2.5, -2.0, -4.0, -5.0, 0.0, 0.0], [1.0, 0.0, -5.0, -2.0, -5.0, 0.0, 0.0]])
"""A spectrum that falls, and a band: the energy of some scenes is at one degree."""
_L_K = degrees_of_coefficients(LARGEST_DEGREE)
_QUANTILES = 0.0, 0.5, 1.0
"""Of the gaps' radii: lights are left out with all their neighbours nearer than these."""
MOST_PLACES = 192
"""Lights that the parameters are learnt from; the map is made of all."""
_LIMITS = range(1, 13)
"""Degrees at which variances may end."""
LIMIT_LIGHTS = 0.75
"""Lights for each coefficient that there then are at least: the prior settles the rest."""
_SEEN = 1e-5
"""Least singular value of a basis at the lights, in units of the largest: below it something is not seen."""
_LIMIT_GAIN = 3.0
"""By which what is minimised must then be less. Of log likelihoods that is strong evidence (a factor of 20: Kass and
Raftery 1995, Bayes factors); scenes that are band-limited gain far more."""
FEWEST = 3
"""With fewer lights, parameters are the prior's mean."""
_BLACK, _LIT = 1.0 / 512.0, 1.0 / 32.0
"""Samples below the first are black, columns that reach the second are lit; of the brightest sample."""
LEAST_SQUARE = 1e-8
"""Of the samples' mean square: a smaller squared error at a light that is left out counts as this."""


@dataclass(frozen=True)
class Moments:
    """What a sample of pixels tells of the lights.

    Attributes
    ----------
    product_gg : ndarray, shape (n_place, n_place)
        Mean over the columns of the products of two lights' samples.
    quantum : float
        Step between two code values, 0 for floats.
    black : float
        Share of black samples among the columns that some light reaches.
    """

    product_gg: NDArray[np.float64]
    quantum: float
    black: float

    @classmethod
    def make(cls, mean_gp: NDArray[np.float64], quantum: float) -> Moments:
        """Return those of samples in units of the brightest, shape (n_place, P)."""
        lit_gp = mean_gp[:, mean_gp.max(axis=0) > _LIT]
        black = float(np.mean(lit_gp < _BLACK)) if lit_gp.size else 0.0
        return cls(mean_gp @ mean_gp.T / mean_gp.shape[1], quantum, black)

    def of(self, places: NDArray[np.intp]) -> Moments:
        """Return those of some of the places."""
        return replace(self, product_gg=self.product_gg[np.ix_(places, places)])


@dataclass(frozen=True)
class Judged:
    """Which lights are left out together, the one that is judged first in each; the same for any parameters."""

    zones: list[NDArray[np.intp]]
    weight_z: NDArray[np.float64]

    @cached_property
    def stacked(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Zones of equal size together."""
        return stack_zones(self.zones)


def judge_zones(directions_g3: NDArray[np.float64]) -> Judged:
    """Return zones of three radii around each light: of the smallest gap, of a typical one, and of the largest."""
    radii = np.quantile(find_gap_radii(directions_g3), _QUANTILES)
    zones = [zone for radius in radii for zone in find_zones(directions_g3, float(radius))]
    return Judged(zones, np.full(len(zones), 1.0 / len(zones)))


def solve_zones(
    inverse_gg: NDArray[np.float64], zones: list[NDArray[np.intp]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return B (n_place, n_zone) and v: ``B' C^-1 beta`` are the errors at the lights judged, v their variance.

    The kriging of a light from those outside its zone leaves ``(Q_zz)^-1 (Q beta)_z``, Q the inverse covariance.
    """
    errors_gz, variance_z = np.zeros((len(inverse_gg), len(zones))), np.empty(len(zones))
    for which, members in stack_zones(zones):
        first_zm = _invert_zones(inverse_gg, members)[:, 0]
        errors_gz[members, which[:, None]] = first_zm
        variance_z[which] = first_zm[:, 0]
    return errors_gz, variance_z


def _invert_zones(matrix_gg: NDArray[np.float64], members_zm: NDArray[np.intp]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.inv(matrix_gg[members_zm[:, :, None], members_zm[:, None, :]]))


def measure_left_out(
    covariance_gg: NDArray[np.float64], moment_gg: NDArray[np.float64], judged: Judged, least: float
) -> tuple[float, NDArray[np.float64]]:
    """Return ``n / 2 sum_z w_z log(e_z + least)``, e_z the mean squared error, and its gradient in the covariance."""
    half = 0.5 * len(covariance_gg)
    q = np.asarray(np.linalg.inv(covariance_gg))
    a = q @ moment_gg @ q
    b = np.zeros((len(q), len(judged.zones)))
    inverses = [_invert_zones(q, members) for _, members in judged.stacked]
    for (which, members), inverse_zmm in zip(judged.stacked, inverses, strict=True):
        b[members, which[:, None]] = inverse_zmm[:, 0]
    ab = a @ b
    error_z = np.maximum(np.einsum("ij,ij->j", b, ab), 0.0)
    u = judged.weight_z / (error_z + least)
    turned = np.zeros_like(b)
    for (which, members), inverse_zmm in zip(judged.stacked, inverses, strict=True):
        turned[members, which[:, None]] = np.einsum("zij,zj->zi", inverse_zmm, ab[members, which[:, None]])
    scaled = b * u
    cross, own = scaled @ turned.T, q @ (scaled @ b.T) @ a
    gradient_gg = q @ (cross + cross.T) @ q - own - own.T
    return half * float(judged.weight_z @ np.log(error_z + least)), half * gradient_gg


@dataclass(frozen=True)
class Objective:
    """What is minimised: the mean log of the squared error at lights left out, and the prior of the parameters."""

    basis_gk: NDArray[np.float64]
    moment_gg: NDArray[np.float64]
    count_g: NDArray[np.float64]
    judged: Judged
    least: float
    limit: int = LARGEST_DEGREE

    @classmethod
    def make(cls, places: Places, moment_gg: NDArray[np.float64], least: float) -> Objective:
        """Return the objective for samples of mean square 1."""
        basis_gk = evaluate_basis(places.directions_g3, LARGEST_DEGREE)
        return cls(basis_gk, moment_gg, places.count_g, judge_zones(places.directions_g3), least)

    def sees(self, limit: int) -> bool:
        """Return whether the lights see every function up to a degree, as far as there are lights enough.

        Two rings do not see ``(z - z_1) (z - z_2)``, so that no light left out judges what is made of it.
        """
        singular = np.linalg.svd(self.basis_gk[:, : coefficient_count(limit)], compute_uv=False)
        return bool(singular[-1] > _SEEN * singular[0])

    def measure(self, covariance_gg: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return what is minimised but for the prior, and its gradient in the covariance of the lights."""
        return measure_left_out(covariance_gg, self.moment_gg, self.judged, self.least)

    def evaluate(self, logs: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return the value, and its gradient in the seven parameters."""
        variance_l, slopes_tl = degree_variances(logs, self.limit)
        factor_k, turning_k = order_factors(logs[5])
        variance_k = variance_l[_L_K] * factor_k
        noise, total = np.exp(logs[4]), SHARE @ variance_l
        covariance_gg = (self.basis_gk * variance_k) @ self.basis_gk.T
        covariance_gg[np.diag_indices(len(covariance_gg))] += noise * total / self.count_g
        value, gradient_gg = self.measure(covariance_gg)
        trace = float(np.sum(np.diag(gradient_gg) / self.count_g))
        by_k = np.einsum("gk,gk->k", gradient_gg @ self.basis_gk, self.basis_gk)
        by_degree_l = np.bincount(_L_K, by_k * factor_k) + noise * trace * SHARE
        of_azimuth = (by_k * variance_k) @ turning_k
        of_tilt = by_degree_l[1] * variance_l[1]
        away = (logs - PRIOR_MEAN) / PRIOR_SD
        gradient = np.append(slopes_tl @ by_degree_l, [trace * noise * total, of_azimuth, of_tilt]) + away / PRIOR_SD
        return value + 0.5 * float(away @ away), gradient


@dataclass(frozen=True)
class Learner:
    """A search for the parameters: what is minimised, and their bounds."""

    objective: Objective
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @classmethod
    def make(cls, places: Places, moments: Moments, fixed: dict[int, float]) -> Learner:
        """Return the search for these lights; see `clrelight.fit.learning.learn_theta`."""
        square = float(np.trace(moments.product_gg)) / len(places)
        least = max(moments.quantum**2 / 12.0 / square, LEAST_SQUARE)
        low, high = _LOW.copy(), _HIGH.copy()
        low[4] = min(max(low[4], np.log(least)), high[4] - 1.0)
        for k, value in fixed.items():
            low[k] = high[k] = value
        return cls(Objective.make(places, moments.product_gg / square, least), low, high)

    def limited(self, limit: int) -> Learner:
        """Return the same where nothing is above a degree."""
        return replace(self, objective=replace(self.objective, limit=limit))

    def search(self, start: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return the least value that is found from here, and where."""
        from scipy.optimize import minimize  # slow to load, and of no use to other methods

        one = minimize(
            self.objective.evaluate,
            np.clip(start, self.low, self.high),
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(self.low, self.high, strict=True)),
            options={"maxiter": 60, "ftol": 1e-6},
        )
        return float(one.fun), one.x


def begin(given: dict[int, float]) -> NDArray[np.float64]:
    """Return the prior's mean, and what is given."""
    start_t = PRIOR_MEAN.copy()
    start_t[list(given)] = list(given.values())
    return start_t


def search_free(learner: Learner) -> tuple[float, NDArray[np.float64]]:
    """Return the least value that is found without a limit of the learner's own, and where."""
    return min((learner.search(start) for start in _STARTS), key=lambda one: one[0])


def find_clear_limit(learner: Learner, free: tuple[float, NDArray[np.float64]]) -> Theta | None:
    """Return the parameters with a limit where lights left out alone ask for one; None otherwise."""
    value, logs = free
    limited = learner.limited(_best_limit(learner, logs))
    starts = (hold_still(logs, learner.low, learner.high), logs)
    below, at = min((limited.search(start) for start in starts), key=lambda one: one[0])
    return Theta.from_logs(at, limited.objective.limit) if below < value - _LIMIT_GAIN else None


def hold_still(logs: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return these parameters with as little noise and edges as a band-limited function leaves."""
    still = logs.copy()
    still[2], still[4] = -8.0, low[4] + 1.0
    return np.clip(still, low, high)


def _best_limit(learner: Learner, logs: NDArray[np.float64]) -> int:
    """Return the degree beyond which variances may end best, without a search at each."""
    objective = learner.objective
    still, most = hold_still(logs, learner.low, learner.high), len(objective.moment_gg) / LIMIT_LIGHTS
    limits = [limit for limit in _LIMITS if limit == 1 or ((limit + 1) ** 2 <= most and objective.sees(limit))]
    return min(limits, key=lambda limit: replace(objective, limit=limit).evaluate(still)[0])
