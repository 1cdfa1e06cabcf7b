"""Fits that are one matrix for all pixels: projection, unconstrained least squares, and Sloan's variant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clrelight.basis import evaluate_basis
from clrelight.conventions import coefficient_index
from clrelight.errors import InputError
from clrelight.fit.plan import (
    FitPlan,
    Lighting,
    is_sphere,
    plan_least_squares,
    require_lights,
    scale_components,
)
from clrelight.fit.registry import FitMethod, register

_MIRROR = np.array([1.0, 1.0, -1.0])


@register
@dataclass(frozen=True)
class Projection(FitMethod):
    """Quadrature ``c_k = sum_i w_i beta_i y_k(s_i)`` over the sphere, the lower hemisphere filled in.

    The baselines that the paper argues against (section I): `fill` is ``"zero"`` (Sloan et al. 2002) or ``"mirror"``
    (Westin et al. 1992: the value at the direction reflected in the horizon).
    """

    id = "project"
    title = "Projection"
    summary = "quadrature over the sphere, lower hemisphere filled with zeros or mirrored"
    is_regression = False
    fill: str = "zero"

    def __post_init__(self) -> None:
        if self.fill not in ("zero", "mirror"):
            raise InputError(f"fill must be zero or mirror, got {self.fill!r}")

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the quadrature matrix; every degree works, with the error that the paper points out."""
        basis_ik = evaluate_basis(lighting.directions_i3, degree)
        if self.fill == "mirror":
            if is_sphere(lighting.directions_i3):
                raise InputError("there are lights below the horizon, so fill must be zero (nothing is), not mirror")
            basis_ik = basis_ik + evaluate_basis(lighting.directions_i3 * _MIRROR, degree)
        analysis_ki = (lighting.solid_angles_i[:, None] * basis_ik).T
        return FitPlan(analysis_ki, None, np.ones(len(analysis_ki)), 2.0 * lighting.solid_angles_i, 1.0)


@register
@dataclass(frozen=True)
class UnconstrainedLeastSquares(FitMethod):
    """``c = U diag(1 / sigma) W' beta`` (eq. 8 and 13)."""

    id = "uls"
    title = "ULS"
    summary = "unconstrained least squares: least error, very large coefficients"

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the two matrices of the pseudo-inverse; InputError for fewer lights than coefficients."""
        require_lights(self.id, len(lighting.directions_i3), degree)
        plan = plan_least_squares(lighting, degree)
        return scale_components(plan, 1.0 / plan.singular_r)


@register
@dataclass(frozen=True)
class SloanLeastSquares(FitMethod):
    """ULS without the basis function y_10, the paper's "third" (section IV-D); meant for degree 4."""

    id = "sloan"
    title = "Sloan ULS"
    summary = "unconstrained least squares without the basis function y10"

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the plan of ULS without y_10, whose coefficient is 0."""
        if degree < 1:
            raise InputError("sloan leaves y10 out, so it needs degree 1 or more, got 0")
        require_lights(self.id, len(lighting.directions_i3), degree)
        plan = plan_least_squares(lighting, degree, without=(coefficient_index(1, 0),))
        return scale_components(plan, 1.0 / plan.singular_r)
