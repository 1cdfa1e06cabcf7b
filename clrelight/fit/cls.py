"""Constrained least squares: the paper's section V-B and V-C."""

from __future__ import annotations

from dataclasses import dataclass, replace

from clrelight.device import Device, DeviceArray
from clrelight.errors import InputError
from clrelight.fit.plan import FitPlan, Lighting, plan_least_squares
from clrelight.fit.registry import FitMethod, Shrunk, register

LANES = 8
MAX_ITERATIONS = 1000


@register
@dataclass(frozen=True)
class ConstrainedLeastSquares(FitMethod):
    """``c = U (S + lambda)^-1 b'`` with the least lambda >= 0 that keeps ``|c|^2 <= E_c`` (eq. 19-25).

    Attributes
    ----------
    energy : float
        Factor on E_c; 1 is the paper's bound, twice the function's energy over the hemisphere.
    solver : str
        ``"bisection"`` (the paper's search) or ``"newton"``.
    iterations : int
        Steps of the solver; 32 is the paper's.
    """

    id = "cls"
    title = "CLS"
    summary = "constrained least squares: least error among coefficients of bounded energy"
    has_lambda = True
    energy: float = 1.0
    iterations: int = 32
    solver: str = "bisection"

    def __post_init__(self) -> None:
        check_energy_factor(self.energy)
        if self.solver not in ("bisection", "newton"):
            raise InputError(f"solver must be bisection or newton, got {self.solver!r}")
        if not 1 <= self.iterations <= MAX_ITERATIONS:
            raise InputError(f"iterations must be 1 to {MAX_ITERATIONS}, got {self.iterations}")

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the matrices; fewer lights than coefficients is legal."""
        return plan_constrained(lighting, degree, self.energy)

    def shrink(
        self, device: Device, plan: FitPlan, z_rq: DeviceArray, energy_q: DeviceArray, singular_r: DeviceArray
    ) -> Shrunk:
        """Search lambda for each column, and replace z by the coefficients in the eigenbasis."""
        maps = self.allocate_maps(device, z_rq.shape[1])
        device.launch(
            "fit/cls.cl",
            f"shrink_by_{self.solver}_rq",
            (z_rq.shape[1] // LANES,),
            z_rq,
            maps.lambda_q,
            energy_q,
            singular_r,
            self.iterations,
            *z_rq.shape,
            defines={"N_COMPONENT": z_rq.shape[0]},
        )
        return maps


def plan_constrained(lighting: Lighting, degree: int, energy: float) -> FitPlan:
    """Return the least-squares plan with the bound scaled; a note says when there are fewer lights than unknowns."""
    plan = plan_least_squares(lighting, degree)
    n_light, n_coeff = len(lighting.directions_i3), (degree + 1) ** 2
    notes = plan.notes
    if n_light < n_coeff:
        notes += (f"{n_light} lights for {n_coeff} coefficients: the bound alone settles the others",)
    return replace(plan, energy_i=energy * plan.energy_i, notes=notes)


def check_energy_factor(energy: float) -> None:
    """Raise InputError unless the factor on E_c is a positive number."""
    if not 0.0 < energy < float("inf"):
        raise InputError(f"energy must be a positive factor on E_c, got {energy}")
