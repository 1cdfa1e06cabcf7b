"""What a fit by `spectrum` is expected to reach under lights that nobody photographed, or why that is unknown."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.fit.kriging import KrigingModel
from clrelight.fit.leave_out_error import LEAST_ERROR, Trials, krige_left_out
from clrelight.fit.left_out import solve_zones
from clrelight.fit.places import find_zones, list_unseen, mutual_angles, nearest_angles, spread_points
from clrelight.fit.plan import is_sphere
from clrelight.fit.zonal import LARGEST_DEGREE

FEWEST_JUDGES = 6
_NEAR = 0.5
"""Lights nearer than this part of a gap's radius are left out together."""
_WIDEST, _WIDEST_OF_FEW, _FEW = 1.5, 3.0, 10
"""Decibels to either side within which an expectation is worth saying; the second below so many lights."""
_FARTHEST = 0.2
_UNSEEN = (1.0 / 255.0) ** 2
"""A squared error of one 8-bit code value."""
_KINDER = 0.1
"""Errors in the gaps of a few lights, in units of those at lights left out, at best."""
_DB = 10.0 / np.log(10.0)
_WIDE = 2.0
"""Lights nearer than this part of a gap's radius are left out together, to see how errors grow."""
_LAW, _LAW_WEIGHT, _LAWS = 0.75, 0.3, (0.5, 2.0)
"""Power of a variance that errors grow with: what is expected, how much that weighs, and the bounds."""
_SMOOTH_SLOPE = 3.0
"""Of a spectrum without edges and noise, which tells how much depends on the model's own."""
_IN_GAPS = 0.6
"""Unseen lights are at least this part of a gap's radius from all others."""
_REACH = 1.5
"""Width in gaps' radii of the density of lights: unseen lights are thought to lie where others do."""
_ASKED = 12
"""Unseen lights that a figure is thought to be compared with: their mean is off as that of so many directions is."""
_OUTER = 0.1
"""Part of the unseen directions that is better, and worse, than what is said of their range."""
_TARGETS = 150
_BLOCK = 1000
_COLUMNS_A_LIGHT = 4
"""Fewer tell nothing of the noise."""
_COVER_POINTS = 2000
_COVERING, _COVERED = 1.5, 0.5
"""Lights tell of directions nearer than so many gaps' radii, and must tell of this part of the hemisphere."""


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


def expect_unseen(left_out: LeftOut, trials: Trials, unseen_t3: NDArray[np.float64] | None = None) -> Expectation:
    """Return what a model will reach in the gaps between lights, or under unseen lights whose directions are given.

    Around a direction, ``log error = log e_i + gamma (log v - log v_i)``, averaged over the lights i nearby: errors
    measured where lights are left out, carried from there along the model's own variance v. gamma = 1 would be the
    model's law; it is between that and what errors do where wider zones are left out. The spread has four parts: a
    third of what is carried, how much errors differ between the directions, how they grow towards the middle of
    the gaps, and half of what carrying them along the variance of a smooth function would change.
    """
    directions_g3 = trials.places.directions_g3
    count = len(directions_g3)
    if count < FEWEST_JUDGES:
        typical = float(np.exp(np.mean(np.log(left_out.error_g))))
        lights = f"{count} light is" if count == 1 else f"{count} lights are"
        return Expectation(None, 0.0, f"{lights} too few to leave any out", _KINDER * typical)
    given = unseen_t3 is not None
    targets_t3 = unseen_t3 if unseen_t3 is not None else list_unseen(directions_g3, _IN_GAPS * trials.gap)
    psnr_t, carried_t = left_out.carry(targets_t3)
    near_t = nearest_angles(targets_t3, directions_g3)
    density_t = np.ones(len(targets_t3)) if given else _find_density(targets_t3, directions_g3, trials.gap)
    weight_t = density_t / density_t.sum()
    psnr = float(weight_t @ psnr_t)
    carried = _DB / 3.0 * float(weight_t @ np.abs(carried_t))
    varied = float(np.sqrt(weight_t @ (psnr_t - psnr) ** 2 / _ASKED))
    middle_t = weight_t * (near_t >= trials.gap)
    grown = 0.0 if given or not middle_t.any() else 0.5 * (psnr - float(middle_t @ psnr_t / middle_t.sum()))
    doubted = 0.5 * (psnr - float(weight_t @ left_out.carry(targets_t3, smooth=True)[0]))
    spread = float(np.sqrt(carried**2 + varied**2 + grown**2 + doubted**2))
    widest = _WIDEST if count >= _FEW else _WIDEST_OF_FEW
    covered = 1.0 if given else _find_covered(directions_g3, trials.gap)
    why = None
    if covered < _COVERED:
        among = f"; among them it may be {psnr:.1f} dB (+- {spread:.1f})" if spread <= widest else ""
        why = f"the lights tell of {100.0 * covered:.0f}% of the hemisphere only{among}"
    elif carried > widest or (spread > widest and varied < max(carried, abs(grown), abs(doubted))):
        why = "the gaps between the lights are far wider than what leaving lights out can judge"
    elif float(weight_t @ carried_t) > _FARTHEST:
        why = "unseen directions are farther from the lights than any light that can be left out"
    elif 10.0 ** (-psnr / 10.0) < _UNSEEN:
        why = "the error is below one 8-bit code value, where rounding decides"
    elif spread > widest:
        low, high = _find_range(psnr_t, weight_t)
        why = f"it depends on where the light is: mostly from {low:.0f} to {high:.0f} dB"
    return Expectation(psnr, spread, why, 10.0 ** (-(psnr + max(spread, widest)) / 10.0))


def expect_at(model: KrigingModel, trials: Trials, targets_t3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the PSNR in dB that is expected under each of these directions, whatever it may be off by."""
    left_out = LeftOut.make(model, trials)
    blocks = np.array_split(targets_t3, -(-len(targets_t3) // _BLOCK))
    return np.concatenate([left_out.carry(block_t3)[0] for block_t3 in blocks])


@dataclass(frozen=True)
class LeftOut:
    """Squared errors at lights that are left out, with those near them and in zones that are wider.

    Attributes
    ----------
    model : KrigingModel
        Without a step.
    near, wide : list of ndarray
        The lights that are left out for each, itself first.
    error_g, wide_error_g : ndarray, shape (n_place,), float64
    noise : float
        Squared error that no model is below.
    """

    model: KrigingModel
    near: list[NDArray[np.intp]]
    wide: list[NDArray[np.intp]]
    error_g: NDArray[np.float64]
    wide_error_g: NDArray[np.float64]
    noise: float

    @classmethod
    def make(cls, model: KrigingModel, trials: Trials) -> LeftOut:
        """Return those of a model of the trials' lights."""
        plain = model.plain
        near, wide = (find_zones(trials.places.directions_g3, part * trials.gap) for part in (_NEAR, _WIDE))
        errors = (
            trials.measure(krige_left_out(plain, trials.mean_gp, zones)[0], trials.mean_gp) for zones in (near, wide)
        )
        error_g, wide_error_g = (np.maximum(each, LEAST_ERROR) for each in errors)
        return cls(plain, near, wide, error_g, wide_error_g, _find_noise(trials))

    def carry(
        self, targets_t3: NDArray[np.float64], smooth: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the PSNR in dB under each direction, and by how much ``log error`` is carried for it.

        v is the model's variance, or that of its errors where the function is smooth and without noise.
        """
        near_g, wide_g = self._smooth_logs if smooth else self._own_logs
        v_t = self.model.error_variance_at(targets_t3, _SMOOTH_SLOPE) if smooth else self.model.variance_at(targets_t3)
        weight_tg = _weigh_neighbours(targets_t3, self.model.places.directions_g3)
        step_t = np.log(v_t) - weight_tg @ near_g
        grown, variance = np.mean(np.log(self.wide_error_g / self.error_g)), np.mean(wide_g - near_g)
        gamma = float(np.clip((grown + _LAW_WEIGHT * _LAW) / (variance + _LAW_WEIGHT), *_LAWS))
        log_t = np.maximum(weight_tg @ np.log(self.error_g) + gamma * step_t, np.log(self.noise))
        return -_DB * log_t, gamma * step_t

    @cached_property
    def _own_logs(self) -> list[NDArray[np.float64]]:
        return [np.log(solve_zones(self.model.inverse_gg, zones)[1]) for zones in (self.near, self.wide)]

    @cached_property
    def _smooth_logs(self) -> list[NDArray[np.float64]]:
        inverse_gg = self.model.inverse_gg
        sums = (inverse_gg @ solve_zones(inverse_gg, zones)[0] for zones in (self.near, self.wide))
        return [np.log(self.model.variance_of(each, _SMOOTH_SLOPE)) for each in sums]


def _find_noise(trials: Trials) -> float:
    """Return the variance of noise, or less than that: the least eigenvalue of the lights' second moments.

    Of noise alone it would be ``(1 - sqrt(lights / columns))^2`` of the variance (Marchenko and Pastur 1967).
    """
    shown_gp = trials.show(trials.mean_gp)
    lights, columns = shown_gp.shape
    if lights < _FEW or lights * _COLUMNS_A_LIGHT > columns:  # few lights cannot tell noise from a rough scene
        return LEAST_ERROR
    least = float(np.linalg.eigvalsh(shown_gp @ shown_gp.T / columns)[0])
    return max(least / (1.0 - np.sqrt(lights / columns)) ** 2, LEAST_ERROR)


def _find_covered(directions_g3: NDArray[np.float64], gap: float) -> float:
    """Return the part of the hemisphere (the sphere, where lights are below the horizon) that lights tell of."""
    points = spread_points(_COVER_POINTS, is_sphere(directions_g3))
    return float(np.mean(nearest_angles(points, directions_g3) < _COVERING * gap))


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


def cost_of_series(
    model: KrigingModel,
    trials: Trials,
    error: float,
    relit: Callable[[int, NDArray[np.float64]], NDArray[np.float64]],
) -> Callable[[int], float]:
    """Return what the series of a degree costs in dB of the mean PSNR between the lights.

    The whole function's squared error is `error`. `relit` takes a degree and directions, and returns what the series is
    there, in units of what `trials` shows.
    """
    targets_t3 = list_unseen(trials.places.directions_g3, 0.5 * trials.gap)
    targets_t3 = targets_t3[:: max(1, len(targets_t3) // _TARGETS)]
    whole_tp = trials.show(model.weights_at(targets_t3) @ trials.samples.radiance_ip)

    @cache
    def cost(degree: int) -> float:
        lost_t = np.mean((trials.show(relit(degree, targets_t3)) - whole_tp) ** 2, axis=1)
        return float(_DB * np.mean(np.log1p(lost_t / max(error, LEAST_ERROR))))

    return cost


def rounding_of(stack: LightStack) -> float:
    """Return the mean squared error, in units of the peak, of code values that were rounded; 0 of floats."""
    return 1.0 / (12.0 * stack.peak**2) if stack.images_ihwc.dtype.kind in "ui" else 0.0


def least_degree(cost: Callable[[int], float], within: float) -> int:
    """Return the least degree whose series costs no more than `within` dB, or the largest; costs fall with it."""
    return bisect_left(range(LARGEST_DEGREE), True, key=lambda degree: cost(degree) <= within)
