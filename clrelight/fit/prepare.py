"""Prepare a fit: check what is asked for, choose where that is left open, and make the matrices."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH, basis_of
from clrelight.dataset import FitRecord, LightStack
from clrelight.device import Device, open_device
from clrelight.errors import InputError, unknown
from clrelight.fit.plan import FitPlan, make_lighting
from clrelight.fit.precision import MIXED, SINGLE, check_precision, compute_dtype
from clrelight.fit.registry import FitMethod, method_class, method_ids
from clrelight.fit.samples import Samples
from clrelight.fit.scaling import TileScaling
from clrelight.fit.selection import AUTO, DEGREES, METHODS, WITHIN, Choice, choose_model
from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.threads import on_one_thread


@dataclass
class FitReport:
    """What a fit cost and what the user should know.

    Attributes
    ----------
    seconds : dict
        Per stage: ``plan``, ``read``, ``project``, ``shrink``, ``synthesize``; or ``fit`` for the last three, where a
        method has them in one kernel. Of reading it is what was waited for.
    notes : list of str
    condition : float
        Condition of the weighted basis matrix.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    condition: float = 1.0

    def add(self, stage: str, since: float) -> float:
        """Add the time since `since` to a stage, and return now."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now


@dataclass(frozen=True)
class PreparedFit:
    """A fit of one stack, ready to run: what is the same for all tiles."""

    stack: LightStack
    method: FitMethod
    degree: int
    config: Mapping[str, Any]
    plan: FitPlan
    device: Device
    report: FitReport
    choice: Choice | None = None
    precision: str = MIXED

    @property
    def arithmetic(self) -> str:
        """The precision that the device computes all columns in; `precision` is what was asked for."""
        return self.method.arithmetic(self.precision, self.device)

    def scaling(self) -> TileScaling:
        """Return what brings samples into the range of the arithmetic, read as the method reads them."""
        curve = self.method.curve_of(self.stack)
        return TileScaling(self.stack, self.plan, compute_dtype(self.arithmetic), curve)

    @property
    def record(self) -> FitRecord:
        """What the fit holds beside its maps."""
        stack = self.stack
        return FitRecord(
            self.degree,
            self.method.id,
            stack.peak,
            stack.transfer,
            stack.directions_i3,
            self.config,
            stack.name,
            stack.surface,
        )


def prepare_fit(
    stack: LightStack,
    method: str | FitMethod,
    degree: int | str,
    *,
    options: Mapping[str, Any] | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    basis: str = SH,
    precision: str = MIXED,
    within: float = WITHIN,
    device: Device | None = None,
    unseen_t3: NDArray[np.float64] | None = None,
) -> PreparedFit:
    """Check the request and make the matrices; see `fit` for the parameters.

    `unseen_t3` are directions that the choice's prediction is for, such as those of held-out lights; they change
    nothing else.
    """
    device = device or open_device()
    check_precision(precision, device)
    if not 0.0 <= within < math.inf:
        raise InputError(f"within must be 0 or more decibels, got {within!r}")
    methods, degrees = _check_model(method, degree, options or {})
    _check_basis(basis, method, methods[0], degree)
    lighting = make_lighting(stack, weights, sampling, basis)
    samples = Samples(stack)
    report = FitReport(notes=list(stack.notes))
    start = time.perf_counter()
    choice = None
    if AUTO in (method, degree):
        with on_one_thread():
            choice = choose_model(samples, methods, degrees, weights, sampling, within, unseen_t3)
        report.notes.append(choice.note)
        methods, degrees = [choice.settled or choice.chosen.method], [choice.chosen.degree]
        start = report.add("choose", start)
    method, degree = methods[0].settle(lighting, degrees[0], samples), degrees[0]
    plan = method.plan(lighting, degree)
    report.notes += [*plan.notes, *_note_precision(method, plan, precision, device)]
    report.condition = plan.condition
    report.add("plan", start)
    config = {**method.to_config(), "weights": weights, "sampling": sampling, "precision": precision}
    if basis != SH:
        config["basis"] = basis
    return PreparedFit(stack, method, degree, config, plan, device, report, choice, precision)


def check_lights(stack: LightStack, method: str | FitMethod, degree: int | str, basis: str = SH) -> None:
    """Raise the InputError of `prepare_fit` for which there is reason without a look at the samples."""
    methods, degrees = _check_model(method, degree, {})
    _check_basis(basis, method, methods[0], degree)
    learns = type(methods[0]).settle is not FitMethod.settle
    if AUTO not in (method, degree) and not learns:
        methods[0].plan(make_lighting(stack, "uniform", "hemisphere", basis), degrees[0])


def _check_basis(basis: str, asked: str | FitMethod, method: FitMethod, degree: int | str) -> None:
    """Raise InputError where a basis is not known, or does not go with a method or a degree."""
    known = basis_of(basis)
    if basis == SH:
        return
    if asked == AUTO or not method.takes_bases:
        name = asked if asked == AUTO else method.id
        raise InputError(f"method {name} fits spherical harmonics; --basis {basis} goes with uls and spline")
    if not isinstance(degree, int):
        raise InputError(f"--basis {basis} needs a degree by number: {degree} chooses among spherical harmonics")
    known.check(degree)


def _note_precision(method: FitMethod, plan: FitPlan, precision: str, device: Device) -> list[str]:
    notes = []
    if precision == MIXED and method.is_refined and not device.info.float64:
        notes.append(f"{device.info.name} has no float64: mixed precision is single precision here")
        precision = SINGLE
    note = method.note_precision(plan, precision)
    return notes if note is None else [*notes, note]


def _check_model(
    method: str | FitMethod, degree: int | str, options: Mapping[str, Any]
) -> tuple[list[FitMethod], list[int]]:
    """Return the methods and degrees asked for: one of each, or those that auto chooses from."""
    if degree == AUTO:
        degrees = list(DEGREES)
    elif isinstance(degree, str) or not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be auto or 0 to {MAX_DEGREE}, got {degree!r}")
    else:
        degrees = [degree]
    if method == AUTO:
        if options:
            raise InputError(f"auto chooses the options too; {', '.join(options)} needs a method by name")
        return [method_class(name)() for name in METHODS], degrees
    if isinstance(method, str):
        if method not in method_ids():
            raise unknown("method", method, [AUTO, *method_ids()])
        method = method_class(method).from_config(options)
    elif options:
        raise InputError(f"options belong to a method given by its id; this {method.id} has its own: {method}")
    if degree == AUTO and not method.is_regression:
        raise InputError(f"degree auto needs a method that fits samples, such as cls or spline; {method.id} does not")
    return [method], degrees
