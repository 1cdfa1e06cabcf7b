"""Where a function's spectrum ends, where few lights cannot tell by being left out alone.

Sixteen lights or fewer leave so little when some are left out that a function of degree 3 looks as any other. How all
of them vary together says more: the likelihood of their second moments. And samples that are black do: where a function
is clipped at 0 it has a kink, and no degree at which it ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.axial import judge_step
from clrelight.fit.left_out import LIMIT_LIGHTS, Learner, Moments, Objective, hold_still
from clrelight.fit.places import Places
from clrelight.fit.zonal import LARGEST_DEGREE, Theta

FEWEST, MOST = 6, 16
"""Lights between which this is asked; more tell by being left out."""
_COLUMNS = 30.0
"""That the moments count for, however many there are: no model is so right that thousands of pixels may speak for it
(a power of the likelihood: Miller and Dunson 2019, Robust Bayesian inference via coarsening)."""
_COEFFICIENTS = 2.5
"""For each light at most."""
_AGREED = 0.05
"""By which each of the three must be less."""
_BLACK = 0.005
"""Share of a scene's samples: with more that are black no end is looked for."""


@dataclass(frozen=True)
class Likelihood(Objective):
    """Minus the logarithm of the likelihood of so many columns, instead of the errors at lights left out."""

    def measure(self, covariance_gg: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return ``columns / 2 (log |C| + n log (tr(C^-1 S) / n))``, the scale of C being free, and its gradient."""
        count = len(covariance_gg)
        q = np.asarray(np.linalg.inv(covariance_gg))
        scale = float((q * self.moment_gg).sum()) / count
        value = float(np.linalg.slogdet(covariance_gg)[1]) + count * np.log(scale)
        return 0.5 * _COLUMNS * value, 0.5 * _COLUMNS * (q - q @ self.moment_gg @ q / scale)


def find_end(
    learner: Learner, free: tuple[float, NDArray[np.float64]], places: Places, moments: Moments
) -> Theta | None:
    """Return the parameters of a function that ends at some degree, where all say that it does; None otherwise.

    Asked of degrees with more coefficients than `clrelight.fit.left_out.find_clear_limit` asks of. Three must agree:
    lights left out, lights left out from what the samples add to the covariance, and the likelihood.

    Parameters
    ----------
    learner : Learner
    free : tuple of float and ndarray
        What is minimised without an end, and where.
    places : Places
    moments : Moments
        Of these places.
    """
    count = len(places)
    if not FEWEST <= count <= MOST or moments.black > _BLACK:
        return None
    value, logs = free
    likelihood = Likelihood(**{name: getattr(learner.objective, name) for name in Objective.__dataclass_fields__})
    judge = replace(learner, objective=likelihood)
    likely, likely_at = judge.search(logs)
    foretold = 0.5 * count * judge_step(places, Theta.from_logs(logs), moments.product_gg)[1]
    most, found = -_AGREED, None
    for limit in range(1, LARGEST_DEGREE):
        if not count / LIMIT_LIGHTS < (limit + 1) ** 2 <= _COEFFICIENTS * count:
            continue
        starts = hold_still(logs, learner.low, learner.high), logs
        below, at = min((learner.limited(limit).search(start) for start in starts), key=lambda one: one[0])
        if below - value > most:
            continue
        theta = Theta.from_logs(at, limit)
        step = 0.5 * count * judge_step(places, theta, moments.product_gg)[1] - foretold
        if step > most:
            continue
        starts = hold_still(likely_at, learner.low, learner.high), likely_at
        likelier = min(judge.limited(limit).search(start)[0] for start in starts) - likely
        if likelier <= most:
            most, found = max(below - value, step, likelier), theta
    return found
