"""Fits that are one matrix for all pixels: projection, unconstrained least squares, and Sloan's variant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clrelight.basis import evaluate_basis
from clrelight.conventions import coefficient_index
from clrelight.errors import InputError
from clrelight.fit.plan import FitPlan, Lighting, is_sphere, plan_least_squares, require_lights
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
        return invert_singular_values(plan_least_squares(lighting, degree))


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
        return invert_singular_values(plan)


def invert_singular_values(plan: FitPlan) -> FitPlan:
    """Fold ``diag(1 / sigma)`` into the synthesis.

    The product is not multiplied out with the analysis: components first, then coefficients, keeps the rounding errors
    of the large coefficients in the directions where they cancel in the image.
    """
    if plan.synthesis_kr is None:
        raise ValueError("expected a least-squares plan, got one without a synthesis")
    return replace(plan, synthesis_kr=plan.synthesis_kr / plan.singular_r)
