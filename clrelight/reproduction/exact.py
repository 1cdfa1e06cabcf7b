"""The fits in float64 NumPy: what fast results are compared with. Equations as in the paper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.plan import FitPlan

Array = NDArray[np.float64]

_HALVINGS = 200


def fit_uls(plan: FitPlan, samples_is: Array) -> Array:
    """Return ``U diag(1/sigma) W' beta``; the plan of ULS has the division in its synthesis.

    By noise-resistant-fitting, eq. 8.
    """
    return _synthesis(plan) @ (plan.analysis_ri @ samples_is)


def fit_cls(plan: FitPlan, samples_is: Array) -> Array:
    """Return the coefficients for the least lambda that meets the bound, lambda by bisection.

    By noise-resistant-fitting, eq. 19-25.
    """
    square_r1 = plan.singular_r[:, None] ** 2
    b_rs = plan.singular_r[:, None] * (plan.analysis_ri @ samples_is)
    energy_s = plan.energy_i @ samples_is**2

    def norm(lambda_s: Array) -> Array:
        return np.sum((b_rs / (square_r1 + lambda_s)) ** 2, axis=0)

    high_s = np.sqrt(np.sum(b_rs**2, axis=0) / np.where(energy_s > 0, energy_s, 1.0)) + 1e-30
    low_s = np.zeros_like(high_s)
    for _ in range(_HALVINGS):
        middle_s = np.where(low_s > 0, np.sqrt(low_s * high_s), high_s / 16.0)
        feasible_s = norm(middle_s) <= energy_s
        high_s, low_s = np.where(feasible_s, middle_s, high_s), np.where(feasible_s, low_s, middle_s)
    lambda_s = np.where(norm(np.zeros_like(high_s)) <= energy_s, 0.0, high_s)
    return _synthesis(plan) @ (b_rs / (square_r1 + lambda_s))


def fit_ceb(plan: FitPlan, samples_is: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return coefficients and rank with the leading eigenvectors whose sum stays within the bound.

    By noise-resistant-fitting, eq. 31-35.
    """
    z_rs = plan.analysis_ri @ samples_is / plan.singular_r[:, None]
    kept_rs = np.cumsum(z_rs**2, axis=0) <= plan.energy_i @ samples_is**2
    return _synthesis(plan) @ np.where(kept_rs, z_rs, 0.0), kept_rs.sum(axis=0)


def _synthesis(plan: FitPlan) -> Array:
    if plan.synthesis_kr is None:
        raise ValueError("expected a least-squares plan, got one without a synthesis")
    return plan.synthesis_kr
