"""The constrained eigenbasis: the paper's section V-E."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.fit.cls import check_energy_factor, plan_constrained
from clrelight.fit.columns import launch_columns
from clrelight.fit.plan import FitPlan, Lighting
from clrelight.fit.registry import Columns, FitMethod, Shrunk, register

_SCATTERED_NOTE = (
    "ceb on scattered samples: the paper's form costs O(n^3) per column; this one truncates in the eigenbasis of the "
    "scaled matrix A* (eq. 29), where the bound stays a running sum and a column costs O(n^2)"
)


@dataclass(frozen=True)
class _Truncation(FitMethod):
    has_rank = True
    crossing = 0
    energy: float = 1.0

    def __post_init__(self) -> None:
        check_energy_factor(self.energy)

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the matrices; fewer lights than coefficients is legal."""
        plan = plan_constrained(lighting, degree, self.energy)
        return replace(plan, notes=(*plan.notes, _SCATTERED_NOTE)) if lighting.sampling == "scattered" else plan

    def shrink(self, device: Device, plan: FitPlan, columns: Columns) -> Shrunk:
        """Keep leading components of each column, divided by their singular values."""
        z_rq = columns.z_rq
        maps = self.allocate_maps(device, z_rq.shape[1])
        launch_columns(
            device,
            "fit/ceb.cl",
            "truncate_rq",
            z_rq,
            maps.rank_q,
            columns.energy_q,
            columns.singular_r,
            *z_rq.shape,
            defines={"CROSSING": self.crossing},
        )
        return maps

    def find_gains(
        self, plan: FitPlan, z_rp: NDArray[np.float64], energy_p: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return ``1 / sigma`` for the components kept, else 0."""
        term_rp = (z_rp / plan.singular_r[:, None]) ** 2
        sum_rp = np.cumsum(term_rp, axis=0) - (term_rp if self.crossing else 0.0)
        kept_rp = sum_rp < energy_p if self.crossing else sum_rp <= energy_p
        return kept_rp / plan.singular_r[:, None]


@register
@dataclass(frozen=True)
class ConstrainedEigenbasis(_Truncation):
    """Keep leading eigenvectors of A while ``sum_r (z_r / sigma_r)^2 <= E_c`` (eq. 31-35).

    Attributes
    ----------
    energy : float
        Factor on E_c; 1 is the paper's bound.
    """

    id = "ceb"
    title = "CEB"
    summary = "constrained eigenbasis: leading eigenvectors while the energy stays bounded; no search"


@register
@dataclass(frozen=True)
class CrossingEigenbasis(_Truncation):
    """CEB as the paper's pseudocode prints it: the term that crosses E_c is kept, and the bound does not hold."""

    id = "ceb-crossing"
    title = "CEB, crossing"
    summary = "ceb as printed in the paper: keeps the term that crosses the bound, for comparison"
    crossing = 1
