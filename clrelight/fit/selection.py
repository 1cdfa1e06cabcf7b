"""Choose method and degree by the error at unseen lights: model only what a scene requires."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.fit.choice import AT_GIVEN, CLEAR, IN_GAPS, Candidate, Choice
from clrelight.fit.curved import CurvedSpectrumFit
from clrelight.fit.expectation import Expectation, LeftOut, cost_of_series, expect_unseen, least_degree, rounding_of
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
_MANY, _LITTLE = 9, 0.1
"""Coefficients for each light beyond which fewer are taken, if that likely costs no more than so many decibels."""
_DOUBT = 3.0
"""Standard errors by which another method must be better than spectrum: neighbouring lights err alike, and many
models are tried."""
_FEWEST = 6


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

    `spectrum` is what others must clearly be better than, and what is taken, `spectrum-curve`. What follows its samples
    so closely that leaving them out tells nothing is not taken. Of degrees that cost no more than `within`, the least.

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
    kriged = _Kriged.make((starts or [SpectrumFit()])[0], samples, trials, max(degrees))
    base, expected = kriged.judged, kriged.expect()
    told = expected if unseen_t3 is None else kriged.expect(unseen_t3)
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
        degree, cost, most = kriged.choose_degree(degrees, within, expected)
        chosen = replace(base, degree=degree, predicted=_foretell(told, -cost))
        choice = replace(_conclude(chosen, [chosen, *others], told), settled=kriged.settled, most=most)
    else:
        gain = _mean_gain(base, winner)
        chosen = Candidate(winner.method, winner.degree, _foretell(told, gain), winner.in_folds, winner.error_g)
        others[others.index(winner)] = chosen
        choice = _conclude(chosen, [*([base] if starts else []), *others], told)
    curve, chooses = CurvedSpectrumFit(), len(methods) > 1
    asked = base.method.id != curve.id and (chooses or samples.source.transfer == "srgb")
    if asked and curve.refusal(samples) is None:
        shown = _Kriged.make(curve, samples, trials, max(degrees))
        # Both are measured in code values: a light's photographs are averaged in either way, so each has its own truth.
        choice = replace(choice, code_gain=_mean_gain(choice.chosen, shown.judged))
        if chooses and _find_winner(choice.chosen, [shown.judged], within) is not None:
            choice = _take_curve(choice, shown, degrees, within, unseen_t3)
    return replace(choice, at=IN_GAPS if unseen_t3 is None else AT_GIVEN)


def _take_curve(
    choice: Choice, shown: _Kriged, degrees: Sequence[int], within: float, unseen_t3: NDArray[np.float64] | None
) -> Choice:
    """Return the choice of values as displayed, or the one before where a series of their radiance costs too much."""
    expected = shown.expect()
    degree, cost, most = shown.choose_degree(degrees, within, expected)
    if (choice.code_gain or 0.0) - cost < CLEAR:
        return choice
    told = expected if unseen_t3 is None else shown.expect(unseen_t3)
    chosen = replace(shown.judged, degree=degree, predicted=_foretell(told, -cost))
    taken = _conclude(chosen, [chosen, *choice.tried], told)
    return replace(taken, settled=shown.settled, code_gain=choice.code_gain, most=most)


@dataclass(frozen=True)
class _Kriged:
    """`spectrum`, or `spectrum-curve`, of the lights of a choice.

    `judged` is it at its highest degree; of `trials` the samples are what it krigs.
    """

    settled: SpectrumFit
    model: KrigingModel
    trials: Trials
    judged: Candidate

    @classmethod
    def make(cls, method: SpectrumFit, samples: Samples, trials: Trials, degree: int) -> _Kriged:
        settled = method.settle(trials.lighting, degree, samples)
        assert isinstance(settled, SpectrumFit)  # of its own class
        model, trials = settled.model(trials.lighting), method.view(trials)
        return cls(settled, model, trials, _judge(method, degree, _leave_out(model, trials)))

    def expect(self, unseen_t3: NDArray[np.float64] | None = None) -> Expectation:
        return expect_unseen(self._left_out, self.trials, unseen_t3)

    @functools.cached_property
    def _left_out(self) -> LeftOut:
        return LeftOut.make(self.model, self.trials)

    def choose_degree(self, degrees: Sequence[int], within: float, expected: Expectation) -> tuple[int, float, int]:
        """Return the degree asked for, or the least that costs no more than `within`, and what it costs.

        Beyond `_MANY` coefficients for each light a lower one that likely costs little; last, the one without that.
        """
        series = functools.partial(self.settled.relit, self.model, self.trials.samples)
        likely = expected.error if expected.psnr is None else 10.0 ** (-expected.psnr / 10.0)
        if len(degrees) == 1:  # nothing is decided by it: what is likely counts, not the least that errors may be
            return degrees[0], cost_of_series(self.model, self.trials, likely, series)(degrees[0]), degrees[0]
        rounding = rounding_of(self.trials.samples.source)  # nothing that is measured tells what is below it
        cost = cost_of_series(self.model, self.trials, max(expected.error, rounding), series)
        most = least_degree(cost, within)
        enough = math.isqrt(_MANY * len(self.trials.places.directions_g3)) - 1
        if most <= enough:
            return most, cost(most), most
        likely_cost = cost_of_series(self.model, self.trials, max(likely, rounding), series)
        degree = min(most, max(enough, least_degree(likely_cost, _LITTLE)))
        return degree, cost(degree), most


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
        if gain_g.mean() - _DOUBT * error >= CLEAR:
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
