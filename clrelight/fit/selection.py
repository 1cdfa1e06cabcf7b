"""Choose method and degree by the error at unseen lights: model only what a scene requires."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from clrelight.errors import InputError
from clrelight.fit.plan import make_lighting
from clrelight.fit.prediction import measure_prediction, predict_in_folds, predict_left_out
from clrelight.fit.registry import FitMethod
from clrelight.fit.samples import Samples

AUTO = "auto"
METHODS = ("uls", "sloan", "cls", "ceb", "spline")
"""The ids that ``method="auto"`` chooses from."""
DEGREES = range(1, 16)
"""The degrees that ``degree="auto"`` chooses from."""

TOLERANCE = 0.05
"""Decibels at unseen lights that a lower degree may cost."""
_GAIN = 0.01
"""Decibels by which a degree must improve on all before it; a method's search ends where two in a row do not."""
_REACH = 1.0
"""Decibels that a prediction may be below the best one for its model to be checked in folds."""
_FINALISTS = 6
_MAX_VALUES = 1 << 19
"""Samples, over all lights, that predictions are made for."""


@dataclass(frozen=True)
class Candidate:
    """A model, and what it is expected to reach at unseen lights.

    Attributes
    ----------
    method : FitMethod
    degree : int
    predicted : float
        Pooled PSNR in dB by the closed form of leaving one light out.
    in_folds : float or None
        Pooled PSNR in dB at lights really left out, a fifth at a time; None where it was not checked.
    """

    method: FitMethod
    degree: int
    predicted: float
    in_folds: float | None = None

    @property
    def expected(self) -> float:
        """The PSNR in folds where it is known, else the predicted one."""
        return self.predicted if self.in_folds is None else self.in_folds

    def __str__(self) -> str:
        folds = "" if self.in_folds is None else f", {self.in_folds:.2f} dB in folds"
        return f"{self.method.id} at degree {self.degree} ({self.predicted:.2f} dB predicted at unseen lights{folds})"

    def to_config(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return {
            "method": self.method.id,
            "degree": self.degree,
            "psnr_predicted": self.predicted,
            "psnr_folds": self.in_folds,
        }


@dataclass(frozen=True)
class Choice:
    """The model taken, the next best of those checked in folds, and all that were tried."""

    chosen: Candidate
    runner_up: Candidate | None
    tried: tuple[Candidate, ...]

    @property
    def note(self) -> str:
        """What the user should know."""
        after = f"; next {self.runner_up}" if self.runner_up else ""
        return f"auto took {self.chosen} of {len(self.tried)} models{after}"

    def to_config(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return {
            "chosen": self.chosen.to_config(),
            "runner_up": None if self.runner_up is None else self.runner_up.to_config(),
            "tried": [candidate.to_config() for candidate in self.tried],
        }


def choose_model(
    samples: Samples, methods: Sequence[FitMethod], degrees: Sequence[int], weights: str, sampling: str
) -> Choice:
    """Return the model with the least error at unseen lights, or the lowest degree that is within `TOLERANCE` of it.

    For each method, degrees are tried upwards until the predicted error stops falling. Its best degree, and the
    lowest that is as good, go to the final, where lights are really left out, a fifth at a time.

    Parameters
    ----------
    samples : Samples
        Of the lights to fit; held-out lights must not be among them.
    methods, degrees : sequence
        What to choose from, in order.
    weights, sampling : str
        As in `clrelight.fit.fit`.

    Raises
    ------
    InputError
        If there are fewer than 2 lights, or no model fits them.
    """
    n_light = samples.stack.n_light
    if n_light < 2:
        raise InputError("auto judges by lights that are left out, so it needs 2 lights or more, got 1")
    samples = samples.thin(_MAX_VALUES // n_light)
    tried: list[Candidate] = []
    finalists: list[Candidate] = []
    for method in methods:
        try:
            ladder = list(_climb(method, degrees, samples, weights, sampling))
        except InputError:
            if len(methods) == 1:
                raise
            continue
        tried += ladder
        best = max(ladder, key=lambda c: c.predicted)
        lowest = next(c for c in ladder if c.predicted >= best.predicted - TOLERANCE)
        finalists += [lowest] if lowest is best else [lowest, best]
    if not finalists:
        names = ", ".join(method.id for method in methods)
        raise InputError(f"none of {names} fits degree {degrees[0]} to {n_light} lights")
    finalists.sort(key=lambda c: -c.predicted)
    reach = finalists[0].predicted - _REACH
    checked = []
    for candidate in [c for c in finalists if c.predicted >= reach][:_FINALISTS]:
        try:
            predicted_ip = predict_in_folds(candidate.method, candidate.degree, samples, weights, sampling)
        except InputError:  # with a fifth less, there are too few lights for it
            continue
        checked.append(replace(candidate, in_folds=measure_prediction(predicted_ip, samples)))
    ranked = sorted(checked or finalists, key=lambda c: -c.expected)
    close = [c for c in ranked if c.expected >= ranked[0].expected - TOLERANCE]
    chosen = min(close, key=lambda c: c.degree)  # the first, and so the best, of that degree
    ranked.remove(chosen)
    in_folds = {(c.method.id, c.degree): c for c in checked}
    return Choice(
        chosen,
        ranked[0] if ranked else None,
        tuple(in_folds.get((c.method.id, c.degree), c) for c in tried),
    )


def _climb(
    method: FitMethod, degrees: Sequence[int], samples: Samples, weights: str, sampling: str
) -> Iterator[Candidate]:
    """Yield the method at rising degrees until two in a row bring nothing, or the lights allow no more."""
    lighting = make_lighting(samples.stack, weights, sampling)
    best, idle = None, 0
    for degree in degrees:
        try:
            predicted_ip = predict_left_out(method, degree, samples, lighting)
        except InputError:
            if best is None:
                raise
            return
        candidate = Candidate(method, degree, measure_prediction(predicted_ip, samples))
        yield candidate
        idle = 0 if best is None or candidate.predicted > best + _GAIN else idle + 1
        best = candidate.predicted if best is None else max(best, candidate.predicted)
        if idle == 2:
            return
