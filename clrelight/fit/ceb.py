"""The constrained eigenbasis: noise-resistant-fitting, section V-E."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.fit.cls import check_energy_factor, plan_constrained
from clrelight.fit.columns import launch_columns
from clrelight.fit.plan import FitPlan, Lighting
from clrelight.fit.registry import Columns, FitMethod, Shrunk, register

EQUAL = 1e-4
"""Singular values that differ by less, as a part of the first of them, count as equal: of symmetric lights in files of
few digits they do."""

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
            device.upload(step_ends(plan.singular_r)),
            *z_rq.shape,
            defines={"CROSSING": self.crossing},
        )
        return maps

    def find_gains(
        self, plan: FitPlan, z_rp: NDArray[np.float64], energy_p: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return ``1 / sigma`` for the components kept, else 0."""
        term_rp = (z_rp / plan.singular_r[:, None]) ** 2
        sum_rp = np.cumsum(term_rp, axis=0)
        end_r = step_ends(plan.singular_r)
        if self.crossing:
            first_r = np.searchsorted(end_r, np.arange(len(end_r)), side="right")  # members of earlier steps
            kept_rp = np.concatenate([np.zeros_like(sum_rp[:1]), sum_rp])[first_r] < energy_p
        else:
            kept_rp = sum_rp[end_r - 1] <= energy_p
        return kept_rp / plan.singular_r[:, None]


def step_ends(singular_r: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return, of each component, one past the last that is kept or dropped with it: those of equal singular values.

    Equal ones share a space of eigenvectors, in which a decomposition picks some at will.
    """
    end_r = np.empty(len(singular_r), np.int32)
    first = 0
    for r in range(1, len(singular_r) + 1):
        if r == len(singular_r) or singular_r[first] - singular_r[r] > EQUAL * singular_r[first]:
            end_r[first:r] = r
            first = r
    return end_r


@register
@dataclass(frozen=True)
class ConstrainedEigenbasis(_Truncation):
    """Keep leading eigenvectors of A while ``sum_r (z_r / sigma_r)^2 <= E_c`` (noise-resistant-fitting, eq. 31-35).

    Those of equal sigma are kept or dropped together.

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
