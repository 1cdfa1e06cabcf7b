"""What a fit by `spectrum` is expected to reach under lights that nobody photographed, or why that is unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.places import find_zones, list_unseen, mutual_angles, nearest_angles
from clrelight.fit.prediction import LEAST_ERROR, Trials, krige_left_out
from clrelight.fit.zonal import LARGEST_DEGREE, ZonalModel
from clrelight.harmonics.basis import evaluate_basis

FEWEST_JUDGES = 6
_NEAR = 0.5
"""Lights nearer than this part of a gap's radius are left out together."""
_WIDEST, _WIDEST_OF_FEW, _FEW = 1.5, 3.0, 10
"""Decibels to either side within which an expectation is worth saying; the second below so many lights."""
_FARTHEST = 0.25
_UNSEEN = (1.0 / 255.0) ** 2
"""A squared error of one 8-bit code value."""
_KINDER = 0.3
"""Errors in the gaps of a few lights, in units of those at lights left out, at best."""
_DB = 10.0 / np.log(10.0)
_LAW, _LAW_WEIGHT, _LAWS = 0.75, 0.3, (0.5, 1.25)
"""Power of the model's variance that errors grow with: what is expected, how much that weighs, and the bounds."""
_IN_GAPS = 0.6
"""Unseen lights are at least this part of a gap's radius from all others."""
_REACH = 1.5
"""Width in gaps' radii of the density of lights: unseen lights are thought to lie where others do."""
_ASKED = 12
"""Unseen lights that a figure is thought to be compared with: their mean is off as that of so many directions is."""
_OUTER = 0.1
"""Part of the unseen directions that is better, and worse, than what is said of their range."""
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


def expect_unseen(model: ZonalModel, trials: Trials, unseen_t3: NDArray[np.float64] | None = None) -> Expectation:
    """Return what a model will reach in the gaps between lights, or under unseen lights whose directions are given.

    Around a direction, ``log error = log e_i + gamma (log v - log v_i)``, averaged over the lights i nearby: errors
    measured where lights are left out, carried from there along the model's own variance v. gamma = 1 would be the
    model's law; it is between that and what errors do where wider zones are left out. The spread has three parts: a
    quarter of what is carried, how much errors differ between the directions, and how they grow towards the middle
    of the gaps.
    """
    directions_g3 = trials.places.directions_g3
    error_g, judged_g = _judge_zones(model, trials, _NEAR)
    count = len(directions_g3)
    if count < FEWEST_JUDGES:
        typical = float(np.exp(np.mean(np.log(error_g))))
        lights = f"{count} light is" if count == 1 else f"{count} lights are"
        return Expectation(None, 0.0, f"{lights} too few to leave any out", _KINDER * typical)
    given = unseen_t3 is not None
    targets_t3 = unseen_t3 if unseen_t3 is not None else list_unseen(directions_g3, _IN_GAPS * trials.gap)
    weight_tg = _weigh_neighbours(targets_t3, directions_g3)
    step_t = np.log(model.variance_at(targets_t3)) - weight_tg @ np.log(judged_g)
    psnr_t = -_DB * (weight_tg @ np.log(error_g) + _find_law(model, trials, error_g, judged_g) * step_t)
    near_t = nearest_angles(targets_t3, directions_g3)
    density_t = np.ones(len(targets_t3)) if given else _find_density(targets_t3, directions_g3, trials.gap)
    weight_t = density_t / density_t.sum()
    psnr = float(weight_t @ psnr_t)
    carried = 0.25 * _DB * float(weight_t @ np.abs(step_t))
    varied = float(np.sqrt(weight_t @ (psnr_t - psnr) ** 2 / _ASKED))
    middle_t = weight_t * (near_t >= trials.gap)
    grown = 0.0 if given or not middle_t.any() else 0.5 * (psnr - float(middle_t @ psnr_t / middle_t.sum()))
    spread = float(np.sqrt(carried**2 + varied**2 + grown**2))
    widest = _WIDEST if count >= _FEW else _WIDEST_OF_FEW
    why = None
    if carried > widest or (spread > widest and varied < max(carried, abs(grown))):
        why = "the gaps between the lights are far wider than what leaving lights out can judge"
    elif float(weight_t @ step_t) > _FARTHEST:
        why = "unseen directions are farther from the lights than any light that can be left out"
    elif 10.0 ** (-psnr / 10.0) < _UNSEEN:
        why = "the error is below one 8-bit code value, where rounding decides"
    elif spread > widest:
        low, high = _find_range(psnr_t, weight_t)
        why = f"it depends on where the light is: mostly from {low:.0f} to {high:.0f} dB"
    return Expectation(psnr, spread, why, 10.0 ** (-(psnr + max(carried, _WIDEST)) / 10.0))


def _judge_zones(model: ZonalModel, trials: Trials, part: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return squared error and variance at lights left out with all nearer than a part of a gap's radius."""
    zones = find_zones(trials.places.directions_g3, part * trials.gap)
    predicted_gp, judged_g = krige_left_out(model, trials.mean_gp, zones)
    return np.maximum(trials.measure(predicted_gp, trials.mean_gp), LEAST_ERROR), judged_g


def _find_law(model: ZonalModel, trials: Trials, error_g: NDArray[np.float64], judged_g: NDArray[np.float64]) -> float:
    """Return gamma: how errors grow with the variance where zones are twice as wide, as far as they are any wider."""
    wide_error_g, wide_judged_g = _judge_zones(model, trials, 2.0 * _NEAR)
    grown, variance = np.mean(np.log(wide_error_g / error_g)), np.mean(np.log(wide_judged_g / judged_g))
    return float(np.clip((grown + _LAW_WEIGHT * _LAW) / (variance + _LAW_WEIGHT), *_LAWS))


def _find_density(
    targets_t3: NDArray[np.float64], directions_g3: NDArray[np.float64], gap: float
) -> NDArray[np.float64]:
    width = 1.0 - np.cos(max(_REACH * gap, 1e-3))
    near_tg = (targets_t3 @ directions_g3.T - 1.0) / width
    return np.asarray(np.exp(near_tg - near_tg.max()).sum(axis=1))


def _find_range(psnr_t: NDArray[np.float64], weight_t: NDArray[np.float64]) -> tuple[float, float]:
    order = np.argsort(psnr_t)
    below_t = np.cumsum(weight_t[order])
    low, high = (int(np.searchsorted(below_t, part)) for part in (_OUTER, 1.0 - _OUTER))
    return float(psnr_t[order[low]]), float(psnr_t[order[min(high, len(order) - 1)]])


def _weigh_neighbours(targets_t3: NDArray[np.float64], directions_g3: NDArray[np.float64]) -> NDArray[np.float64]:
    angle = mutual_angles(directions_g3) + 4.0 * np.eye(len(directions_g3))
    width = 1.0 - np.cos(np.median(angle.min(axis=1)) + 1e-6)
    near_tg = (targets_t3 @ directions_g3.T - 1.0) / width
    weight_tg = np.exp(near_tg - near_tg.max(axis=1, keepdims=True))
    return np.asarray(weight_tg / weight_tg.sum(axis=1, keepdims=True))


def least_degree(model: ZonalModel, trials: Trials, error: float, within: float) -> tuple[int, float]:
    """Return the least degree whose series costs no more than `within` dB, and what it costs.

    The cost is that of the mean PSNR between the lights where the whole series' squared error is `error`.
    """
    targets_t3 = list_unseen(trials.places.directions_g3, 0.5 * trials.gap)
    targets_t3 = targets_t3[:: max(1, len(targets_t3) // _TARGETS)]
    radiance_ip = trials.samples.radiance_ip
    whole_tp = trials.show(model.weights_at(targets_t3) @ radiance_ip)

    def cost(degree: int) -> float:
        cut_ti = evaluate_basis(targets_t3, degree) @ model.map_samples(degree)
        lost_t = np.mean((trials.show(cut_ti @ radiance_ip) - whole_tp) ** 2, axis=1)
        return float(_DB * np.mean(np.log1p(lost_t / max(error, LEAST_ERROR))))

    low, high, spent = 0, LARGEST_DEGREE, 0.0  # the cost falls with the degree
    while low < high:
        middle = (low + high) // 2
        tried = cost(middle)
        if tried <= within:
            high, spent = middle, tried
        else:
            low = middle + 1
    return high, spent
