"""A prior learnt from the samples themselves: any covariance that turning about the zenith and mirrors leave.

With coefficients of variance `v` and samples' second moments S, one step of expectation and maximisation (Dempster,
Laird and Rubin 1977) from the prior ``A = diag(v)`` is ``A + W (Q S Q - Q) W'``, ``Q = C^-1`` and ``W = A Y'``. It is
averaged over all turns about the zenith and over mirrors: coefficients of one order stay correlated, others are not,
and so a light tells of others at its height whatever their azimuth. What no light tells of stays as the prior has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.left_out import LEAST_SQUARE, MOST_PLACES
from clrelight.fit.places import Places, find_gap_radii, find_zones, pick_spread
from clrelight.fit.zonal import LARGEST_DEGREE, ORDERS, SHARE, Theta, coefficient_variances, degree_variances
from clrelight.harmonics.basis import evaluate_basis

SHARES = 0.0, 0.3, 1.0
"""Of the step, which are tried."""
FEWEST = 4
"""With fewer lights no step is taken."""
_FEWEST_WHOLE = 8
"""With fewer lights the whole step is not tried: so few left out cannot tell it from a part."""
_MOST_ZONES = 32
"""That are left out to find the share."""

_COLUMNS = [
    [np.flatnonzero(sign * m == ORDERS) for sign in ((1, -1) if m else (1,))] for m in range(LARGEST_DEGREE + 1)
]
"""The coefficients of order m, and those of -m."""


@dataclass(frozen=True)
class AxialStep:
    """What is added to the variances.

    Attributes
    ----------
    share : float
        Of the step, 0 to 1.
    blocks : tuple of ndarray, shape (LARGEST_DEGREE + 1 - m, LARGEST_DEGREE + 1 - m)
        For each order m, the covariance that is added between its degrees, share and all.
    """

    share: float
    blocks: tuple[NDArray[np.float64], ...]

    def add_to(self, scaled_gk: NDArray[np.float64], basis_gk: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``basis (diag(v) + blocks)`` where ``scaled`` is ``basis diag(v)``."""
        return _add_blocks(scaled_gk, basis_gk, self.blocks, 1.0)


@dataclass(frozen=True)
class _Lights:
    """Basis, second moments and noise at some places, and the variances of the coefficients."""

    variance_k: NDArray[np.float64]
    basis_gk: NDArray[np.float64]
    moment_gg: NDArray[np.float64]
    noise_g: NDArray[np.float64]

    def of(self, places: NDArray[np.intp]) -> _Lights:
        moment_gg = self.moment_gg[np.ix_(places, places)]
        return _Lights(self.variance_k, self.basis_gk[places], moment_gg, self.noise_g[places])

    def whole_step(self) -> tuple[NDArray[np.float64], ...]:
        """Return the whole step in units of the prior, whose scale is the likeliest for these moments."""
        scaled_gk = self.basis_gk * self.variance_k
        inverse_gg = np.linalg.inv(scaled_gk @ self.basis_gk.T + np.diag(self.noise_g))
        # Nothing but black would divide by 0.
        scale = max(float((inverse_gg * self.moment_gg).sum()) / len(inverse_gg), np.finfo(np.float64).tiny)
        middle_gg = inverse_gg @ self.moment_gg @ inverse_gg / scale - inverse_gg
        blocks = []
        for columns in _COLUMNS:
            parts = [scaled_gk[:, k].T @ middle_gg @ scaled_gk[:, k] for k in columns]
            blocks.append(np.mean(parts, axis=0))
        return tuple(blocks)

    def weights(
        self, blocks: tuple[NDArray[np.float64], ...], share: float, target_k: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the weights of these places in the value at a direction where the step is shared."""
        scaled_gk = self.basis_gk * self.variance_k
        if share > 0.0:
            scaled_gk = _add_blocks(scaled_gk, self.basis_gk, blocks, share)
        return np.asarray(np.linalg.solve(scaled_gk @ self.basis_gk.T + np.diag(self.noise_g), scaled_gk @ target_k))


def learn_step(
    places: Places, theta: Theta, moment_gg: NDArray[np.float64], share: float | None = None
) -> AxialStep | None:
    """Return the step from the parameters' prior, or None where none is taken.

    Parameters
    ----------
    places : Places
    theta : Theta
    moment_gg : ndarray, shape (n_place, n_place)
        Mean over the columns of the products of two lights' samples.
    share : float, optional
        None: that of `SHARES` for which lights are foretold best that are left out with all nearer than a typical
        gap's radius, the step being made without them.
    """
    lights = _lights_of(places, theta, moment_gg)
    if share == 0.0 or lights is None:
        return None
    if share is None:
        share, _ = judge_step(places, theta, moment_gg)
    return AxialStep(share, tuple(share * block for block in lights.whole_step())) if share > 0.0 else None


def judge_step(places: Places, theta: Theta, moment_gg: NDArray[np.float64]) -> tuple[float, float]:
    """Return the share of `SHARES` that foretells lights left out best, and the mean logarithm of their error."""
    lights = _lights_of(places, theta, moment_gg)
    if lights is None:
        raise ValueError(f"{len(places)} places tell nothing of a step")
    directions_g3 = places.directions_g3[pick_spread(places.directions_g3, MOST_PLACES)]
    shares = SHARES if len(directions_g3) >= _FEWEST_WHOLE else SHARES[:-1]
    errors = _leave_out(lights, directions_g3, shares)
    return shares[int(np.argmin(errors))], float(errors.min())


def _lights_of(places: Places, theta: Theta, moment_gg: NDArray[np.float64]) -> _Lights | None:
    """Return what steps are made of; None where there are too few lights, or nothing but black."""
    some = pick_spread(places.directions_g3, MOST_PLACES)
    square = float(np.trace(moment_gg[np.ix_(some, some)])) / max(len(some), 1)
    if len(some) < FEWEST or not square > 0.0:
        return None
    basis_gk = evaluate_basis(places.directions_g3[some], LARGEST_DEGREE)
    noise = theta.noise * float(SHARE @ degree_variances(theta.to_logs(), theta.limit)[0])
    moments_gg = moment_gg[np.ix_(some, some)] / square
    return _Lights(coefficient_variances(theta), basis_gk, moments_gg, noise / places.count_g[some])


def _leave_out(lights: _Lights, directions_g3: NDArray[np.float64], shares: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the mean logarithm of the squared error at lights left out with their neighbours, for each share."""
    zones = find_zones(directions_g3, float(np.median(find_gap_radii(directions_g3))))
    judged = pick_spread(directions_g3, _MOST_ZONES)
    log_zs = np.empty((len(judged), len(shares)))
    for z, place in enumerate(judged):
        kept = np.setdiff1d(np.arange(len(directions_g3)), zones[place])
        others = lights.of(kept)
        blocks = others.whole_step()
        for s, share in enumerate(shares):
            weight_g = np.zeros(len(directions_g3))
            weight_g[place] = -1.0
            weight_g[kept] = others.weights(blocks, share, lights.basis_gk[place])
            log_zs[z, s] = np.log(max(float(weight_g @ lights.moment_gg @ weight_g), 0.0) + LEAST_SQUARE)
    return np.asarray(log_zs.mean(axis=0))


def _add_blocks(
    scaled_gk: NDArray[np.float64], basis_gk: NDArray[np.float64], blocks: tuple[NDArray[np.float64], ...], share: float
) -> NDArray[np.float64]:
    added_gk = scaled_gk.copy()
    for columns, block in zip(_COLUMNS, blocks, strict=True):
        for k in columns:
            added_gk[:, k] += share * (basis_gk[:, k] @ block)
    return added_gk
