"""Choose method and degree by the error at unseen lights: model only what a scene requires."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.fit.expectation import Expectation, expect_unseen, least_degree
from clrelight.fit.kriging import KrigingModel
from clrelight.fit.leave_out_error import LEAST_ERROR, Trials, krige_left_out, try_method
from clrelight.fit.registry import FitMethod
from clrelight.fit.samples import Samples
from clrelight.fit.spectrum import SpectrumFit

AUTO = "auto"
METHODS = ("spectrum", "uls", "sloan", "cls", "ceb", "spline")
"""The ids that ``method="auto"`` chooses from."""
DEGREES = (*range(9), 10, 12, 15, 20, 25)
"""The degrees that ``degree="auto"`` chooses from; that of spectrum may be any up to the last."""
_REFIT_DEGREES = (0, 1, 2, 3, 4, 6, 9)
"""Those that ``method="auto"`` tries of what must be fitted anew for each zone."""

WITHIN = 0.05
"""Decibels at unseen lights that fewer coefficients may cost."""
_DOUBT = 3.0
"""Standard errors by which another method must be better than spectrum: neighbouring lights err alike, and many
models are tried."""
_CLEAR = 0.5
"""Decibels that it must be better by beside that."""
_FEWEST = 6
_IN_GAPS, _AT_GIVEN = "unseen lights", "the lights held out"


@dataclass(frozen=True)
class Candidate:
    """A model, and what it is expected to reach at unseen lights.

    Attributes
    ----------
    method : FitMethod
    degree : int
    predicted : float or None
        Mean PSNR in dB between the lights; None where that is unknown.
    in_folds : float or None
        Mean PSNR in dB at lights left out with their neighbours; None where nothing can be left out.
    error_g : ndarray
        Mean squared error at each of them, NaN where it was not tried.
    """

    method: FitMethod
    degree: int
    predicted: float | None = None
    in_folds: float | None = None
    error_g: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), compare=False, repr=False)

    def __str__(self) -> str:
        folds = "unknown" if self.in_folds is None else f"{self.in_folds:.2f} dB at lights left out with neighbours"
        return f"{self.method.id} at degree {self.degree} ({folds})"

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
    """The model taken, the next best, all that were tried, and why the prediction is unknown where it is.

    `settled` is the method taken with what it has learnt, where it is known already; `at` says which lights the
    prediction is for. `code_gain` are the decibels by which `spectrum` is better at left-out lights where code values
    are fitted as they stand, if they are not.
    """

    chosen: Candidate
    runner_up: Candidate | None
    tried: tuple[Candidate, ...]
    spread: float = 0.0
    why_unknown: str | None = None
    settled: FitMethod | None = None
    at: str = _IN_GAPS
    code_gain: float | None = None

    @property
    def note(self) -> str:
        """What the user should know."""
        after = f"; next {self.runner_up}" if self.runner_up else ""
        if self.chosen.predicted is None:
            expected = f"PSNR at {self.at} unknown: {self.why_unknown}"
        else:
            expected = f"{self.chosen.predicted:.2f} dB (+- {self.spread:.2f}) predicted at {self.at}"
        took = f"{self.chosen.method.id} at degree {self.chosen.degree}"
        return f"auto took {took} of {len(self.tried)} models; {expected}{after}{self._domain}"

    @property
    def _domain(self) -> str:
        if self.code_gain is None or self.code_gain < _CLEAR:
            return ""
        return (
            f"; code values as they stand (ingest --transfer linear) could be fitted {self.code_gain:.1f} dB better, "
            "but for single lights only: the sum of lights adds radiance"
        )

    def to_config(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return {
            "chosen": self.chosen.to_config(),
            "runner_up": None if self.runner_up is None else self.runner_up.to_config(),
            "tried": [candidate.to_config() for candidate in self.tried],
            "spread": self.spread,
            "why_unknown": self.why_unknown,
            "code_gain": self.code_gain,
        }


def choose_model(
    samples: Samples,
    methods: Sequence[FitMethod],
    degrees: Sequence[int],
    weights: str,
    sampling: str,
    within: float = WITHIN,
    unseen_t3: NDArray[np.float64] | None = None,
) -> Choice:
    """Return the model that is best at lights left out with their neighbours, or a simpler one as good.

    `spectrum` is what others must clearly be better than. What follows its samples so closely that leaving them out
    tells nothing is not taken. Of degrees that cost no more than `within`, the least is.

    Parameters
    ----------
    samples : Samples
        Of the lights to fit; held-out lights must not be among them.
    methods, degrees : sequence
        What to choose from, in order.
    weights, sampling : str
        As in `clrelight.fit.fit`.
    within : float
        Decibels.
    unseen_t3 : ndarray, shape (n, 3), float64, optional
        Directions that the prediction is for; they decide nothing. None: the gaps between the lights.

    Raises
    ------
    InputError
        If no model fits these lights.
    """
    trials = Trials.make(samples, weights, sampling)
    starts = [method for method in methods if isinstance(method, SpectrumFit)]
    settled = (starts or [SpectrumFit()])[0].settle(trials.lighting, max(degrees), samples)
    assert isinstance(settled, SpectrumFit)  # of its own class
    model = settled.model(trials.lighting)
    expected = expect_unseen(model, trials)
    told = expected if unseen_t3 is None else expect_unseen(model, trials, unseen_t3)
    base = _judge((starts or [settled])[0], max(degrees), _leave_out(model, trials))
    others = [
        candidate
        for method in methods
        if method not in starts
        for candidate in _try_degrees(method, _list_degrees(method, degrees) if starts else degrees, trials)
    ]
    if not starts and not others:
        for method in methods:  # it says why not; sloan has no degree 0
            method.plan(trials.lighting, min(degrees[1:2] or degrees))
    winner = _find_winner(base, others, within) if starts else _pick_simplest(others, within)
    if winner is None:
        degree, cost = degrees[0], 0.0
        if len(degrees) > 1:
            degree, cost = least_degree(model, trials, expected.error, within)
        chosen = Candidate(starts[0], degree, _foretell(told, -cost), base.in_folds, base.error_g)
        choice = replace(_conclude(chosen, [chosen, *others], told), settled=settled)
    else:
        gain = _mean_gain(base, winner)
        chosen = Candidate(winner.method, winner.degree, _foretell(told, gain), winner.in_folds, winner.error_g)
        others[others.index(winner)] = chosen
        choice = _conclude(chosen, [*([base] if starts else []), *others], told)
    at = _IN_GAPS if unseen_t3 is None else _AT_GIVEN
    return replace(choice, at=at, code_gain=_try_code_values(base, trials))


def _try_code_values(base: Candidate, trials: Trials) -> float | None:
    """Return the decibels that `spectrum` gains at left-out lights from code values taken as linear."""
    stack = trials.samples.stack
    if stack.transfer == "linear":
        return None
    plain = Trials.make(Samples(replace(stack, transfer="linear")), trials.weights, trials.sampling)
    settled = SpectrumFit().settle(plain.lighting, DEGREES[-1], plain.samples)
    assert isinstance(settled, SpectrumFit)  # of its own class
    # Both are measured in code values: a light's photographs are averaged in either way, so each has its own truth.
    return _mean_gain(base, _judge(settled, DEGREES[-1], _leave_out(settled.model(plain.lighting), plain)))


def _leave_out(model: KrigingModel, trials: Trials) -> NDArray[np.float64]:
    """Return the squared error at each light left out with its zone: see `KrigingModel.plain`."""
    predicted_gp, _ = krige_left_out(model.plain, trials.mean_gp, trials.zones)
    return trials.measure(predicted_gp, trials.mean_gp)


def _judge(method: FitMethod, degree: int, error_g: NDArray[np.float64]) -> Candidate:
    known = error_g[np.isfinite(error_g)]
    folds = float(-10.0 * np.mean(np.log10(np.maximum(known, LEAST_ERROR)))) if len(known) else None
    return Candidate(method, degree, None, folds, error_g)


def _list_degrees(method: FitMethod, degrees: Sequence[int]) -> list[int]:
    refitted = method.has_lambda or method.has_rank
    return [degree for degree in degrees if not refitted or len(degrees) == 1 or degree in _REFIT_DEGREES]


def _try_degrees(method: FitMethod, degrees: Sequence[int], trials: Trials) -> list[Candidate]:
    """Return the method at each degree that these lights allow."""
    tried: list[Candidate] = []
    settled: dict[int, FitMethod] = {}
    for degree in degrees:
        learnt = max(degree, method.settled_from)
        try:
            if learnt not in settled:
                settled[learnt] = method.settle(trials.lighting, degree, trials.samples)
            error_g = try_method(settled[learnt], degree, trials)
        except InputError:
            continue
        tried.append(_judge(method, degree, error_g))
    return tried


def _find_winner(base: Candidate, others: Sequence[Candidate], within: float) -> Candidate | None:
    """Return the simplest of those that are clearly better than `base`, where there are any."""
    clear = []
    for other in others:
        gain_g = _gains(base, other)
        if len(gain_g) < _FEWEST or other.in_folds is None:
            continue
        error = float(gain_g.std(ddof=1)) / np.sqrt(len(gain_g))
        if gain_g.mean() - _DOUBT * error >= _CLEAR:
            clear.append((other, float(gain_g.mean())))
    if not clear:
        return None
    most = max(gain for _, gain in clear)
    return min((other for other, gain in clear if gain >= most - within), key=lambda c: c.degree)


def _pick_simplest(others: Sequence[Candidate], within: float) -> Candidate:
    """Return the lowest degree within so many dB of the best; the lowest of all where nothing is known."""
    known = [c for c in others if c.in_folds is not None]
    if not known:
        return min(others, key=lambda c: c.degree)
    most = max(c.in_folds for c in known if c.in_folds is not None)
    return min((c for c in known if c.in_folds is not None and c.in_folds >= most - within), key=lambda c: c.degree)


def _gains(base: Candidate, other: Candidate) -> NDArray[np.float64]:
    """Return the decibels by which one is better than the other, at each light where both were tried."""
    ratio_g = np.maximum(base.error_g, LEAST_ERROR) / np.maximum(other.error_g, LEAST_ERROR)
    return np.asarray(10.0 * np.log10(ratio_g[np.isfinite(ratio_g)]))


def _mean_gain(base: Candidate, other: Candidate) -> float | None:
    gain_g = _gains(base, other)
    return float(gain_g.mean()) if len(gain_g) and other.in_folds is not None else None


def _foretell(expected: Expectation, gain: float | None) -> float | None:
    if expected.why_unknown is not None or expected.psnr is None or gain is None:
        return None
    return expected.psnr + gain


def _conclude(chosen: Candidate, tried: Sequence[Candidate], expected: Expectation) -> Choice:
    why = expected.why_unknown
    if chosen.predicted is None and why is None:
        why = "the fit follows its samples so closely that leaving lights out tells nothing"
    known = [c for c in tried if c is not chosen and c.in_folds is not None]
    after = max(known, key=lambda c: c.in_folds or 0.0, default=None)
    return Choice(chosen, after, tuple(tried), expected.spread, why)
