"""Constrained least squares with several constraints at once: energy, and values at stated directions."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.fit.cls import ConstrainedLeastSquares, check_energy_factor, plan_constrained
from clrelight.fit.columns import LANES, private_room
from clrelight.fit.plan import FitPlan, Lighting, is_sphere
from clrelight.fit.precision import DOUBLE, MIXED, SINGLE
from clrelight.fit.registry import Columns, FitMethod, Shrunk, register
from clrelight.fit.value_bounds import LARGEST_BOUND, Direction, as_places, bound_directions, least_energy, limits_of
from clrelight.harmonics.basis import evaluate_basis
from clrelight.threads import on_one_thread

MOST_DEGREE = 20
"""A column of degree 20 takes some 2 ms, one of 25 more than ten times that, and some are not solved at all."""
_LEAST_LAMBDA = {np.dtype(np.float64): 1e-15, np.dtype(np.float32): 1e-7}
"""Least lambda as a part of the largest sigma^2: the error of the image is below half its root times that of E_c."""
_MORE_ACTIVE = 8
_FAST_STEPS = 200
"""After so many lambda goes on in a bracket, which takes many times as long and ends for certain."""
_SAME = 1e-6
"""Of the largest singular value: what functions differ by less at the directions of bounds is nothing there."""
_MOST_SCRATCH = 1 << 26
_MOST_WORK = 1 << 33
"""Of one launch: rank² times active bounds times columns, some seconds of a core."""
_ITEMS_PER_UNIT = {"cpu": 8, "gpu": 256}


@dataclass(frozen=True)
class BoundedPlan(FitPlan):
    """The matrices of a fit with bounds on values.

    Attributes
    ----------
    values_jr : ndarray, shape (n_direction, rank), float64
        Values of the components' functions at the directions.
    low_j, high_j : ndarray, shape (n_direction,), float64
    least_energy : float
        Of any function that meets the bounds.
    different : int
        How many functions of this degree differ at the directions.
    """

    values_jr: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    low_j: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    high_j: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    least_energy: float = 0.0
    different: int = 1


@register
@dataclass(frozen=True)
class BoundedLeastSquares(FitMethod):
    """Least squares with ``|c|^2 <= E_c`` and ``lower <= y(s_j) c <= upper`` at stated directions s_j.

    An outlook of the paper (noise-resistant-fitting, section VII): several constraints at once. It
    is solved as ``fit/active_set.clh`` says.

    Attributes
    ----------
    energy : float
        Factor on E_c, as of ``cls``.
    lower, upper : float, optional
        In units of the peak. Without both, and without `nonnegative`, lower is 0.
    nonnegative : bool
        The same as lower 0.
    at : str or directions
        Where: ``"grid"``, ``"ring"``, ``"lights"``, or rows of x y z.
    """

    id = "constrained"
    title = "Constrained"
    summary = "least squares with bounded energy, and with bounds on values at stated directions"
    has_lambda = True
    unmet = (
        "its energy bound E_c is too small for the bounds on its values (or these nearly exclude each other): raise "
        "--energy, widen the bounds, or mask such pixels"
    )
    energy: float = 1.0
    lower: float | None = None
    upper: float | None = None
    nonnegative: bool = False
    at: str | tuple[Direction, ...] = "grid"

    def __post_init__(self) -> None:
        check_energy_factor(self.energy)
        for name in ("lower", "upper"):
            value = getattr(self, name)
            if value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST_BOUND:
                raise InputError(f"{name} must be a number within -1e20 and 1e20, in units of the peak, got {value!r}")
            object.__setattr__(self, name, float(value))
        if self.nonnegative and self.lower not in (None, 0.0):
            raise InputError(f"nonnegative means lower 0, and lower is {self.lower:g}: give one of them")
        if self.nonnegative or (self.lower is None and self.upper is None):
            object.__setattr__(self, "lower", 0.0)
        object.__setattr__(self, "nonnegative", self.lower == 0.0)
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            raise InputError(f"lower {self.lower:g} is above upper {self.upper:g}: no value is within")
        object.__setattr__(self, "at", as_places(self.at))

    def to_config(self) -> dict[str, Any]:
        """Return the options as a JSON object."""
        at = self.at if isinstance(self.at, str) else [list(each) for each in self.at]
        return {**{each.name: getattr(self, each.name) for each in fields(self)}, "at": at}

    @property
    def is_refined(self) -> bool:
        """Mixed precision solves every column in float64 (see `arithmetic`)."""
        return True

    def arithmetic(self, precision: str, device: Device) -> str:
        """Return double for mixed precision: what lights hardly see follows the last digits of every column."""
        return DOUBLE if precision == MIXED and device.info.float64 else precision

    def note_precision(self, plan: FitPlan, precision: str) -> str | None:
        """Return how far bounds are kept where there is no float64."""
        if precision != SINGLE:
            return None
        return "constrained: single precision keeps bounds on values to some 1e-5 of a pixel's brightness only"

    def plan(self, lighting: Lighting, degree: int) -> BoundedPlan:
        """Return the matrices; InputError where no function of this degree meets the bounds, or it is too high."""
        if degree > MOST_DEGREE:
            raise InputError(
                f"constrained takes degrees to {MOST_DEGREE}, got {degree}: above, a pixel takes tens of milliseconds, "
                "and rounding decides which bounds hold; take a lower degree, or cls or spline without bounds on values"
            )
        plan = plan_constrained(lighting, degree, self.energy, complete=True)
        if plan.synthesis_kr is None:
            raise ValueError("expected a least-squares plan, got one without a synthesis")
        sphere = is_sphere(lighting.directions_i3)
        at_j3 = bound_directions(self.at, degree, lighting.directions_i3, sphere=sphere)
        values_jr = evaluate_basis(at_j3, degree) @ plan.synthesis_kr
        low_j = limits_of(self.lower, len(at_j3), upper=False)
        high_j = limits_of(self.upper, len(at_j3), upper=True)
        least = least_energy(values_jr, low_j, high_j)
        if least is None:
            raise InputError(
                f"no function of degree {degree} is within {_within(self.lower, self.upper)} at all {len(at_j3)} "
                "directions: widen the bounds, state fewer directions, or raise the degree"
            )
        return BoundedPlan(
            **{each.name: getattr(plan, each.name) for each in fields(FitPlan)},
            values_jr=values_jr,
            low_j=low_j,
            high_j=high_j,
            least_energy=least,
            different=_count_different(values_jr),
        )

    def shrink(self, device: Device, plan: FitPlan, columns: Columns) -> Shrunk:
        """Replace each column's components by those of least error that meet all constraints."""
        if not isinstance(plan, BoundedPlan):
            raise ValueError("expected the plan of this method")
        return shrink_within(device, plan, columns)

    def find_gains(
        self, plan: FitPlan, z_rp: NDArray[np.float64], energy_p: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the gains of the bound on the energy alone, which bounds on values change in few columns."""
        seen = plan.singular_r > 0.0
        gain_rp = np.zeros_like(z_rp)
        thin = FitPlan(plan.analysis_ri[seen], None, plan.singular_r[seen], plan.energy_i, plan.condition)
        gain_rp[seen] = ConstrainedLeastSquares(energy=self.energy).find_gains(thin, z_rp[seen], energy_p)
        return gain_rp


def shrink_within(device: Device, plan: BoundedPlan, columns: Columns) -> Shrunk:
    """Launch ``fit/constrained.cl`` over all columns of a tile."""
    z_rq, count = columns.z_rq, columns.source_ip.shape[1]
    rank, padded = z_rq.shape
    real = np.dtype(z_rq.dtype)
    wide_r, wide_j = -(-rank // 8) * 8, -(-len(plan.low_j) // 16) * 16
    active = -(-min(len(plan.low_j), plan.different + _MORE_ACTIVE) // 8) * 8
    scratch = active * (2 * active + wide_r + 16 + 8) + 6 * wide_r + 3 * wide_j
    groups = padded // LANES
    items = min(groups, _ITEMS_PER_UNIT[device.style] * device.info.compute_units)
    items = max(1, min(items, _MOST_SCRATCH // (scratch * real.itemsize)))
    singular = np.pad(plan.singular_r.astype(real), (0, wide_r - rank))
    values = np.zeros((len(plan.low_j), wide_r), real)
    values[:, :rank] = plan.values_jr
    across = np.zeros((wide_r, wide_j), np.float32)
    across[:rank, : len(plan.low_j)] = plan.values_jr.T
    spare = (0, wide_j - len(plan.low_j))
    low_t, high_t = np.pad(plan.low_j, spare, constant_values=-1e30), np.pad(plan.high_j, spare, constant_values=1e30)
    unit_q = np.ones(padded, real)
    if columns.exponent_p is not None:
        unit_q[:count] = np.ldexp(1.0, -columns.exponent_p)
    lambda_q, unmet_q = device.empty((padded,), np.float32), device.empty((padded,), np.int32)
    arrays = [device.upload(array) for array in (unit_q, singular, values, across)]
    arrays += [device.upload(array.astype(real)) for array in (low_t, high_t)]
    room = device.empty((items, scratch), real)
    numbers = (
        float(_LEAST_LAMBDA[real] * plan.singular_r.max() ** 2),
        plan.least_energy,
        _value_rounding(plan),
        _longest(plan),
    )
    defines = {"REAL_BITS": 8 * real.itemsize, "Z_BITS": 8 * z_rq.dtype.itemsize, "ROOM": private_room(rank)}
    counts = _FAST_STEPS, active, _joining(plan.different), scratch
    step = max(items, _MOST_WORK // (rank * rank * active * LANES))
    for first in range(0, groups, step):
        if first:
            device.finish()  # nothing interrupts a kernel, and of high degrees a tile takes minutes
        end = min(first + step, groups)
        device.launch(
            *("fit/constrained.cl", "fit_bounded_rq", (min(items, end - first),)),
            *(z_rq, lambda_q, unmet_q, columns.energy_q, *arrays, room),
            *(*numbers, *counts, first, end, len(plan.low_j), *z_rq.shape),
            defines=defines,
        )
    return Shrunk(lambda_q, unmet_q=unmet_q)


def _joining(different: int) -> int:
    """Return how many rows join at a time: few that hardly differ, or most of them leave again (measured)."""
    return max(1, min(math.isqrt(different), max(2, different // 6)))


def _count_different(values_jr: NDArray[np.float64]) -> int:
    """Return the rank of the values."""
    thin = values_jr if len(values_jr) < values_jr.shape[1] else values_jr.T
    with on_one_thread():
        squares = np.linalg.eigvalsh(thin @ thin.T)
    return int(np.count_nonzero(squares > _SAME**2 * squares[-1]))


def _value_rounding(plan: BoundedPlan) -> float:
    """Return the error of a value that is summed in float32, for coefficients of norm 1: eps32 / 2 for each product."""
    return 0.5 * float(np.finfo(np.float32).eps) * (len(plan.singular_r) + 4) * _longest(plan)


def _longest(plan: BoundedPlan) -> float:
    """Return by how much a value changes at most with coefficients by a norm of 1."""
    return float(np.linalg.norm(plan.values_jr, axis=1).max())


def _within(lower: float | None, upper: float | None) -> str:
    low, high = ("no bound" if value is None else f"{value:g}" for value in (lower, upper))
    return f"{low} and {high}"
