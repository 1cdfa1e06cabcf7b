"""What a fit by `spectrum` is expected to reach under lights that nobody photographed, or why that is unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.places import find_zones, list_unseen
from clrelight.fit.prediction import Trials, krige_left_out
from clrelight.fit.zonal import LARGEST_DEGREE, ZonalModel
from clrelight.harmonics.basis import evaluate_basis

FEWEST_JUDGES = 6
_NEAR = 0.5
"""Lights nearer than this part of a gap's radius are left out together."""
_WIDEST = 1.5
"""Decibels to either side within which an expectation is worth saying."""
_FARTHEST = 0.25
_UNSEEN = (1.0 / 255.0) ** 2
"""A squared error of one 8-bit code value."""
_LEAST_ERROR = 1e-13
_KINDER = 0.3
"""Errors in the gaps of a few lights, in units of those at lights left out, at best."""
_DB = 10.0 / np.log(10.0)
_TARGETS = 150


@dataclass(frozen=True)
class Expectation:
    """The mean PSNR in dB under unseen lights.

    Attributes
    ----------
    psnr : float or None
        None where there is nothing to tell it from.
    spread : float
        What it may be off to either side.
    why_unknown : str or None
        Why the figure cannot be relied on, where it cannot.
    error : float
        Least mean squared error that it may be, against which fewer coefficients are weighed.
    """

    psnr: float | None
    spread: float
    why_unknown: str | None
    error: float


def expect_unseen(model: ZonalModel, trials: Trials) -> Expectation:
    """Return what a model will reach in the gaps between lights.

    Around a direction, ``log error = log e_i + gamma (log v - log v_i)``, averaged over the lights i nearby: errors
    measured where lights are left out, carried from there along the model's own variance v. gamma = 1 is the model's
    law, 1/2 half of it; 3/4 is expected, and what lies between is the spread.
    """
    directions_g3 = trials.places.directions_g3
    predicted_gp, judged_g = krige_left_out(model, trials.mean_gp, find_zones(directions_g3, _NEAR * trials.gap))
    error_g = np.maximum(trials.measure(predicted_gp, trials.mean_gp), _LEAST_ERROR)
    count = len(directions_g3)
    typical = float(np.exp(np.mean(np.log(error_g))))
    if count < FEWEST_JUDGES:
        lights = f"{count} light is" if count == 1 else f"{count} lights are"
        return Expectation(None, 0.0, f"{lights} too few to leave any out", _KINDER * typical)
    targets_t3 = list_unseen(directions_g3, trials.gap)
    weight_tg = _weigh_neighbours(targets_t3, directions_g3)
    step_t = np.log(model.variance_at(targets_t3)) - weight_tg @ np.log(judged_g)
    psnr = float(-_DB * np.mean(weight_tg @ np.log(error_g) + 0.75 * step_t))
    spread = float(_DB * 0.25 * np.mean(np.abs(step_t)))
    why = None
    if spread > _WIDEST:
        why = "the gaps between the lights are far wider than what leaving lights out can judge"
    elif float(np.mean(step_t)) > _FARTHEST:
        why = "unseen directions are farther from the lights than any light that can be left out"
    elif 10.0 ** (-psnr / 10.0) < _UNSEEN:
        why = "the error is below one 8-bit code value, where rounding decides"
    return Expectation(psnr, spread, why, 10.0 ** (-(psnr + max(spread, _WIDEST)) / 10.0))


def _weigh_neighbours(targets_t3: NDArray[np.float64], directions_g3: NDArray[np.float64]) -> NDArray[np.float64]:
    angle = np.arccos(np.clip(directions_g3 @ directions_g3.T, -1.0, 1.0)) + 4.0 * np.eye(len(directions_g3))
    width = 1.0 - np.cos(np.median(angle.min(axis=1)) + 1e-6)
    near_tg = (targets_t3 @ directions_g3.T - 1.0) / width
    weight_tg = np.exp(near_tg - near_tg.max(axis=1, keepdims=True))
    return np.asarray(weight_tg / weight_tg.sum(axis=1, keepdims=True))


def least_degree(model: ZonalModel, trials: Trials, error: float, within: float) -> tuple[int, float]:
    """Return the least degree whose series costs no more than `within` dB, and what it costs.

    The cost is that of the mean PSNR between the lights where the whole series' squared error is `error`.
    """
    targets_t3 = list_unseen(trials.places.directions_g3, trials.gap)
    targets_t3 = targets_t3[:: max(1, len(targets_t3) // _TARGETS)]
    radiance_ip = trials.samples.radiance_ip
    whole_tp = trials.show(model.weights_at(targets_t3) @ radiance_ip)

    def cost(degree: int) -> float:
        cut_ti = evaluate_basis(targets_t3, degree) @ model.map_samples(degree)
        lost_t = np.mean((trials.show(cut_ti @ radiance_ip) - whole_tp) ** 2, axis=1)
        return float(_DB * np.mean(np.log1p(lost_t / max(error, _LEAST_ERROR))))

    low, high, spent = 0, LARGEST_DEGREE, 0.0  # the cost falls with the degree
    while low < high:
        middle = (low + high) // 2
        tried = cost(middle)
        if tried <= within:
            high, spent = middle, tried
        else:
            low = middle + 1
    return high, spent
