"""Fits that are one matrix for all pixels: projection, unconstrained least squares, and Sloan's variant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clrelight.errors import InputError
from clrelight.fit.plan import (
    IMAGE_ROUNDING,
    FitPlan,
    Lighting,
    is_sphere,
    plan_least_squares,
    require_lights,
    scale_components,
)
from clrelight.fit.precision import DOUBLE
from clrelight.fit.registry import FitMethod, register
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_index

LARGEST_CONDITION = float(1.0 / np.finfo(np.float32).eps)
"""Components whose singular value is below the largest by more are beyond float32 coefficients: these are that many
times the samples, cancel in the image, and their rounding errors, which do not, are as large as the samples."""
_NOTED_CONDITION = 1e5

_MIRROR = np.array([1.0, 1.0, -1.0])


@register
@dataclass(frozen=True)
class Projection(FitMethod):
    """Quadrature ``c_k = sum_i w_i beta_i y_k(s_i)`` over the sphere, the lower hemisphere filled in.

    The baselines that the paper argues against (noise-resistant-fitting, section I): `fill` is ``"zero"`` (Sloan et al.
    2002) or ``"mirror"`` (Westin et al. 1992: the value at the direction reflected in the horizon).
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


@dataclass(frozen=True)
class _LeastSquares(FitMethod):
    def note_precision(self, plan: FitPlan, precision: str) -> str | None:
        """Return that float64 on the device does not help what float32 coefficients limit."""
        if precision != DOUBLE or plan.condition <= _NOTED_CONDITION:
            return None
        stays = "the cut stays" if plan.condition > LARGEST_CONDITION else "their rounding stays"
        return f"{self.id}: double precision ends in float32 coefficients all the same, so {stays}"


@register
@dataclass(frozen=True)
class UnconstrainedLeastSquares(_LeastSquares):
    """``c = U diag(1 / sigma) W' beta`` (noise-resistant-fitting, eq. 8 and 13)."""

    id = "uls"
    title = "ULS"
    summary = "unconstrained least squares: least error, very large coefficients"
    takes_bases = True

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the two matrices of the pseudo-inverse; InputError for fewer lights than coefficients."""
        require_lights(self.id, len(lighting.directions_i3), degree)
        plan = keep_in_float32(self.id, plan_least_squares(lighting, degree))
        return scale_components(plan, 1.0 / plan.singular_r)


@register
@dataclass(frozen=True)
class SloanLeastSquares(_LeastSquares):
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
        plan = keep_in_float32(self.id, plan)
        return scale_components(plan, 1.0 / plan.singular_r)


def keep_in_float32(method: str, plan: FitPlan) -> FitPlan:
    """Return the plan without the components that float32 coefficients cannot hold; a note says what was done."""
    kept_r = plan.singular_r * LARGEST_CONDITION >= plan.singular_r[0]
    if not kept_r.all():
        note = (
            f"{method}: condition number {plan.condition:.2g} is beyond float32 coefficients; {np.sum(~kept_r)} of "
            f"{len(kept_r)} components, with singular values below {1.0 / LARGEST_CONDITION:.2g} of the largest, are "
            "left out (truncated singular value decomposition); cls, ceb and spline need no such cut"
        )
    elif plan.condition > _NOTED_CONDITION:
        note = (
            f"{method}: condition number {plan.condition:.2g}; rounding of the float32 coefficients costs up to "
            f"{plan.condition * IMAGE_ROUNDING:.0e} of the brightest sample"
        )
    else:
        return plan
    synthesis_kr = None if plan.synthesis_kr is None else plan.synthesis_kr[:, kept_r]
    return replace(
        plan,
        analysis_ri=plan.analysis_ri[kept_r],
        synthesis_kr=synthesis_kr,
        singular_r=plan.singular_r[kept_r],
        notes=(*plan.notes, note),
    )
