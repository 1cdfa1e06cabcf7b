"""Constrained least squares: noise-resistant-fitting, section V-B and V-C."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.errors import InputError, counted
from clrelight.fit.cls_columns import OnePassFit, fits_one_pass
from clrelight.fit.cls_float64 import LAMBDA_TOLERANCE, component_rounding, refine_columns
from clrelight.fit.columns import launch_columns, private_room
from clrelight.fit.plan import IMAGE_ROUNDING, FitPlan, Lighting, plan_least_squares
from clrelight.fit.precision import DOUBLE, MIXED, SINGLE
from clrelight.fit.registry import Columns, FitMethod, OnePass, Shrunk, register
from clrelight.harmonics.index import coefficient_count
from clrelight.matmul import SampleCurve

MAX_ITERATIONS = 1000

CONVERGED_AFTER = {"bisection": 24, "newton": 16, "paper": math.inf}
"""Iterations from which the solver's own error is below the tolerance. Bisection with fewer ends above lambda, where
the bound holds; Newton below, and its coefficients are scaled onto the bound. The paper's search is off by a part of 1,
not of lambda, however small that is: what it finds stands as it is."""

ENERGY_RANGE = 1e-12, 1e12
"""Factors on E_c. Outside, E_c or E_c / lambda^2 leaves float32's range, wherever samples are scaled to."""
_BOUND_ROUNDING = 2e-7
"""Error of the image as a part of the brightest sample, for coefficients at the paper's bound: eps32 sqrt(4 pi) / 2."""
_NOTED_ROUNDING = 3e-5

_HOST_STEPS = 100
"""At most so many Newton steps of `ConstrainedLeastSquares.find_gains`; some 10 are usual."""
_HOST_TOLERANCE = 1e-6
_SMALLEST_PRODUCT = 1e-30
"""Products of two sigma^2 above this are far from float32's smallest, 1e-38, with room for rounding."""


@register
@dataclass(frozen=True)
class ConstrainedLeastSquares(FitMethod):
    """``c = U (S + lambda)^-1 b'`` with the least lambda >= 0 that keeps ``|c|^2 <= E_c``.

    By noise-resistant-fitting, eq. 19-25.

    Attributes
    ----------
    energy : float
        Factor on E_c; 1 is the paper's bound, twice the function's energy over the hemisphere.
    solver : str
        ``"newton"``, or ``"bisection"`` of the logarithm of lambda: both give the same coefficients (float32 rounding
        apart). ``"paper"``, the paper's search: from lambda = 1, lower bound 0, doubled until bracketed, then halving
        the interval; where lambda is far below 1, `iterations` decide how far above it the search ends.
    iterations : int
        Steps of a bisection; 32 is the paper's. Newton ends by itself, and takes 16 or more as a cap. With fewer,
        coefficients beyond the bound are scaled onto it: they keep it, but are not the best that do. Lambda is then
        that of the last step.
    """

    id = "cls"
    title = "CLS"
    summary = "constrained least squares: least error among coefficients of bounded energy"
    has_lambda = True
    energy: float = 1.0
    iterations: int = 32
    solver: str = "newton"

    def __post_init__(self) -> None:
        check_energy_factor(self.energy)
        if self.solver not in CONVERGED_AFTER:
            raise InputError(f"solver must be {', '.join(CONVERGED_AFTER)}, got {self.solver!r}")
        if not 1 <= self.iterations <= MAX_ITERATIONS:
            raise InputError(f"iterations must be 1 to {MAX_ITERATIONS}, got {self.iterations}")

    @property
    def ends(self) -> bool:
        """Whether the search has the steps that it needs to end at lambda."""
        return self.iterations >= CONVERGED_AFTER[self.solver]

    @property
    def is_refined(self) -> bool:
        """Whether mixed precision solves some columns again in float64: those in doubt, of a search that ends."""
        return self.ends

    def note_precision(self, plan: FitPlan, precision: str) -> str | None:
        """Return what columns in doubt are, where they stay as float32 finds them."""
        if precision != SINGLE or not self.is_refined:
            return None
        return (
            "cls: single precision leaves lambda to rounding errors where the bound hardly binds; coefficients change "
            "there, in what the lights do not see, but neither the image nor the bound does"
        )

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the matrices; fewer lights than coefficients is legal."""
        return plan_constrained(lighting, degree, self.energy)

    def shrink(self, device: Device, plan: FitPlan, columns: Columns) -> Shrunk:
        """Search lambda for each column, and replace z by the coefficients in the eigenbasis."""
        z_rq = columns.z_rq
        maps = self.allocate_maps(device, z_rq.shape[1])
        doubt_q = device.empty((z_rq.shape[1],), np.float32)
        components = z_rq.shape[0]
        # Registers of a GPU need loops of known length.
        room = {"N_COMPONENT": components} if device.style == "gpu" else {"ROOM": private_room(components)}
        launch_columns(
            device,
            "fit/cls.cl",
            f"shrink_by_{'newton' if self.solver == 'newton' else 'bisection'}_rq",
            z_rq,
            maps.lambda_q,
            doubt_q,
            columns.energy_q,
            columns.singular_r,
            self.iterations,
            *z_rq.shape,
            defines={
                **room,
                "PAIRED": int(columns.precision == DOUBLE or plan.singular_r.min() ** 4 > _SMALLEST_PRODUCT),
                "ARITHMETIC": int(self.solver == "paper"),
                "ONTO_BOUND": int(self.solver == "newton" and not self.ends),
            },
        )
        if self._refines(device, columns.precision):
            doubt_p = device.download(doubt_q)[: columns.source_ip.shape[1]] * component_rounding(plan)
            doubtful = np.flatnonzero(doubt_p > LAMBDA_TOLERANCE)
            if len(doubtful) and maps.lambda_q is not None:
                refine_columns(device, plan, columns.source_ip, columns.curve, doubtful, maps.lambda_q, z_rq)
        return maps

    def one_pass(self, device: Device, plan: FitPlan, curve: SampleCurve, precision: str) -> OnePass | None:
        """Return a fit of columns in one kernel, for Newton on a CPU in float32; see `fits_one_pass`."""
        if self.solver != "newton" or precision == DOUBLE or not fits_one_pass(device, plan):
            return None
        refined = self._refines(device, precision)
        return OnePassFit(device, plan, curve, self.iterations, ends=self.ends, refined=refined)

    def _refines(self, device: Device, precision: str) -> bool:
        return precision == MIXED and self.is_refined and device.info.float64

    def find_gains(
        self, plan: FitPlan, z_rp: NDArray[np.float64], energy_p: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return ``sigma / (sigma^2 + lambda)`` with each column's lambda, by Newton as in ``cls.cl``."""
        square_r1 = plan.singular_r[:, None] ** 2
        b_rp = plan.singular_r[:, None] * z_rp
        bound_p = np.maximum(energy_p, np.finfo(np.float64).tiny)
        lambda_p = np.maximum(np.linalg.norm(b_rp, axis=0) / np.sqrt(bound_p) - square_r1.max(), 0.0)
        for _ in range(_HOST_STEPS):
            term_rp = (b_rp / (square_r1 + lambda_p)) ** 2
            norm_p, slope_p = term_rp.sum(axis=0), (term_rp / (square_r1 + lambda_p)).sum(axis=0)
            step_p = norm_p / np.maximum(slope_p, np.finfo(np.float64).tiny) * (np.sqrt(norm_p / bound_p) - 1.0)
            before_p, lambda_p = lambda_p, np.maximum(lambda_p + step_p, 0.0)
            if np.all(np.abs(lambda_p - before_p) <= _HOST_TOLERANCE * lambda_p):
                break
        return plan.singular_r[:, None] / (square_r1 + lambda_p)


def plan_constrained(lighting: Lighting, degree: int, energy: float, *, complete: bool = False) -> FitPlan:
    """Return the least-squares plan with the bound scaled; a note says when there are fewer lights than unknowns."""
    plan = plan_least_squares(lighting, degree, complete=complete)
    n_light, n_coeff = len(lighting.directions_i3), coefficient_count(degree)
    notes = plan.notes
    if n_light < n_coeff:
        notes += (f"{counted(n_light, 'light')} for {n_coeff} coefficients: the bound alone settles the others",)
    # The bound's coefficients are some sqrt(4 pi energy) times the samples, and no larger than least squares'.
    rounding = min(_BOUND_ROUNDING * energy**0.5, IMAGE_ROUNDING * plan.condition)
    if rounding > _NOTED_ROUNDING:
        notes += (
            f"energy {energy:g} and condition number {plan.condition:.2g}: rounding of the float32 coefficients costs "
            f"up to {rounding:.0e} of the brightest sample",
        )
    return replace(plan, energy_i=energy * plan.energy_i, notes=notes)


def check_energy_factor(energy: float) -> None:
    """Raise InputError unless the factor on E_c is a positive number that the search for lambda can take."""
    if not 0.0 < energy < float("inf"):
        raise InputError(f"energy must be a positive factor on E_c, got {energy}")
    least, most = ENERGY_RANGE
    if not least <= energy <= most:
        raise InputError(f"energy must be a factor on E_c from {least:g} to {most:g}, got {energy}")
