"""Balls in front of something: their outline, and the blur, by all photographs at once.

Along the outline the sphere's own brightness and that of what lies behind are smooth functions of the angle, blurred
by the lens. Texture behind goes with the lamp in one way; other ways in which pixels go with it are free of texture,
and tell an outline that no single picture shows. So all photographs are fitted at once, each way of going with the
lamps weighted by what it is off, inside and outside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.interpolate import CubicSpline

from clrelight.variation.circles import Circle
from clrelight.variation.descent import descend
from clrelight.variation.rim_design import Design, radial_functions

_WAYS, _MOST_PIXELS = 6, 6000
_INSIDE_ORDERS, _SMALL_ORDERS, _LEAST_ORDER, _MOST_ORDER = (5, 2, 1), (5, 3, 3), 4, 12
"""Orders of Fourier series in the angle: of 1, of the normal's z and of its square inside; outside of the level. That
of shading is 1, of z 0; more of z and z^2 looks like an outline elsewhere where the blur is wide."""
_BLURS, _LEAST_BLUR, _MOST_BLUR = (0.6, 0.9, 1.3, 1.9, 2.7), 0.3, 0.25
"""Standard deviations in pixels that are tried first; the least of all, and the greatest as a share of the radius."""
_ROUNDS, _TURNS, _STEPS, _NEAR_ENOUGH = 2, 3, 4, np.array([3e-3, 3e-3, 3e-3, np.inf])
_STRIDES = {2: 0.02, 3: 0.03}
_IN, _OUT = 0.8, 0.2
"""Share of the sphere in a pixel from which on it tells of the inside, and below which of the outside."""
_OUTSTANDING, _LEAST_CALM = 6.0, 5
"""How far above the others, in spreads of these, a highlight at the outline is; photographs without one, at least."""
_WIDE, _SMALL = 1.5, 15.0
"""Pixels of blur for which the band is wide enough at least: texture misleads a narrow one. Pixels of radius below
which so wide a band reaches half way to the middle, and more happens in it."""
_WRONG, _START_OFF = 60.0, 0.3
"""How much less than as noise texture tells; pixels that a start is off by."""
_MOST_OFF, _BARELY = 0.25, 0.3
"""Pixels of standard deviation beyond which the outline is not told; least weight of pixels that tell what is off."""

Place = Callable[[NDArray[np.floating], NDArray[np.floating]], tuple[NDArray[np.float64], NDArray[np.float64]]]


@dataclass(frozen=True)
class Rim:
    """An outline.

    Attributes
    ----------
    circle : Circle
        In the pixels that `place` returns.
    blur : float
        Standard deviation of lens and pixel together, in pixels.
    centre_off, radius_off : float
        Standard deviations, in pixels.
    """

    circle: Circle
    blur: float
    centre_off: float
    radius_off: float


def fit_rim(samples_ihw: NDArray[np.floating], start: Circle, place: Place | None = None) -> Rim | None:
    """Return the outline of a ball and the blur, from where it nearly is; None where the photographs do not tell.

    Parameters
    ----------
    samples_ihw : ndarray, shape (n_light, height, width)
        Linear grey of the part of each photograph around the ball.
    start : Circle
        Right to a pixel or so, in the pixels that `place` returns.
    place : callable, optional
        Where pixels of the part are in a picture in which the outline is a circle; default: where they are.
    """
    rows_hw, columns_hw = np.mgrid[: samples_ihw.shape[1], : samples_ihw.shape[2]]
    x_hw, y_hw = columns_hw.astype(np.float64), rows_hw.astype(np.float64)
    if place is not None:
        x_hw, y_hw = (each.reshape(x_hw.shape) for each in place(x_hw.ravel(), y_hw.ravel()))
    values_4 = np.array([start.x, start.y, start.radius, 0.0])
    for turn in range(_ROUNDS):
        blur = max(float(np.exp(values_4[3])), _WIDE * (turn == 0 or values_4[2] >= _SMALL))
        band = _Band.cut(samples_ihw, x_hw, y_hw, values_4, blur)
        if band is None:
            return None
        if turn == 0:
            values_4[3] = band.first_blur(values_4)
        try:
            values_4, spread_4 = band.run(values_4, start)
        except np.linalg.LinAlgError:
            return None
    x, y, radius = (float(each) for each in values_4[:3])
    off = float(np.hypot(spread_4[0], spread_4[1]) / np.sqrt(2.0))
    moved = np.hypot(x - start.x, y - start.y) + abs(radius - start.radius)
    if not np.isfinite(off + moved) or max(off, spread_4[2]) > _MOST_OFF or moved > 1.0 + 0.03 * start.radius:
        return None
    return Rim(Circle(x, y, radius, start.outline, off), float(np.exp(values_4[3])), off, float(spread_4[2]))


def _without_highlights(series_ip: NDArray[np.float64], inside_p: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the photographs in which no highlight lies just inside the outline; all, if these are few."""
    if not inside_p.any():  # a small circle, a wide blur
        return series_ip
    low_i, high_i, top_i = np.quantile(series_ip[:, inside_p], (0.25, 0.75, 1.0), axis=1)
    is_calm_i = top_i - high_i <= _OUTSTANDING * (high_i - low_i + 0.02 * high_i.max())
    return series_ip[is_calm_i] if np.count_nonzero(is_calm_i) >= _LEAST_CALM else series_ip


@dataclass
class _Band:
    """Pixels near an outline, and how they go with the lamps: their strongest components, (P, m)."""

    x_p: NDArray[np.float64]
    y_p: NDArray[np.float64]
    samples_pm: NDArray[np.float64]
    inner: float
    outer: float
    orders: tuple[int, ...]
    robust_p: NDArray[np.float64]

    @classmethod
    def cut(
        cls, samples_ihw: NDArray[np.floating], x_hw: NDArray, y_hw: NDArray, values_4: NDArray, blur: float
    ) -> _Band | None:
        """Return the band as wide as the blur asks for; None where there are too few pixels in it."""
        x, y, radius = values_4[:3]
        away_hw = np.hypot(x_hw - x, y_hw - y)
        within = min(max(0.1 * radius, 3.0 * blur + 1.5), 10.0 + 3.0 * blur, 0.5 * radius)
        beyond = min(max(0.12 * radius, 3.0 * blur + 1.5), 6.0 + 3.0 * blur)
        pixels = np.flatnonzero((away_hw > radius - within) & (away_hw < radius + beyond))
        pixels = pixels[:: max(1, len(pixels) // _MOST_PIXELS)]
        most = int(np.clip(0.5 * radius, _LEAST_ORDER, _MOST_ORDER))
        orders = (*(_INSIDE_ORDERS if radius >= _SMALL else _SMALL_ORDERS), most, most // 2)
        if len(pixels) < 2 * sum(2 * order + 1 for order in orders):
            return None
        series_ip = samples_ihw.reshape(len(samples_ihw), -1)[:, pixels].astype(np.float64)
        series_ip = _without_highlights(series_ip, away_hw.ravel()[pixels] < radius - blur)
        length_k, ways_kp = np.linalg.svd(series_ip, full_matrices=False)[1:]
        held = min(_WAYS, max(1, int(np.count_nonzero(length_k > 1e-6 * length_k[0]))))
        samples_pm = (length_k[:held, None] * ways_kp[:held]).T
        ends = radius - within - 1.5, radius + beyond + 1.5
        return cls(x_hw.ravel()[pixels], y_hw.ravel()[pixels], samples_pm, *ends, orders, np.ones(len(pixels)))

    def design(self, values_4: NDArray[np.float64]) -> Design:
        """Return what may be seen."""
        return Design.at(self.x_p - values_4[0], self.y_p - values_4[1], self._radial(values_4), self.orders)

    def _radial(self, values_4: NDArray[np.float64]) -> CubicSpline:
        return radial_functions(float(values_4[2]), float(np.exp(values_4[3])), self.inner, self.outer)

    def off_law(self, values_4: NDArray, turned_mm: NDArray, weight_pm: NDArray) -> tuple[list[NDArray], NDArray]:
        """Return covariances of what is left inside, outside and everywhere, and the share of the ball."""
        design = self.design(values_4)
        design_pf, share_p = design.functions_pf, design.share_p
        turned_pm = self.samples_pm @ turned_mm
        left_pm = (turned_pm - design_pf @ _Solved(design_pf, turned_pm, weight_pm).found_fm) @ np.linalg.inv(turned_mm)
        free = max(1.0 - design_pf.shape[1] / len(left_pm), 0.05)
        found = []
        for where_p in (share_p > _IN, share_p < _OUT, np.ones(len(share_p), bool)):
            kept_pm = left_pm[where_p & (self.robust_p > _BARELY)]
            found.append(kept_pm.T @ kept_pm / max(len(kept_pm) * free, 3.0))
        return found, share_p

    def first_blur(self, values_4: NDArray[np.float64]) -> float:
        """Return the logarithm of the blur that leaves least."""
        held = self.samples_pm.shape[1]
        left = {}
        for blur in _BLURS:
            if blur < _MOST_BLUR * values_4[2]:
                tried_4 = np.append(values_4[:3], np.log(blur))
                left_mm = self.off_law(tried_4, np.eye(held), np.ones_like(self.samples_pm))[0][2]
                left[blur] = np.linalg.slogdet(left_mm + 1e-4 * np.trace(left_mm) / held * np.eye(held))[1]
        return float(np.log(min(left, key=lambda blur: left[blur]))) if left else float(values_4[3])

    def run(self, values_4: NDArray[np.float64], start: Circle) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return x, y, radius and log of the blur that explain the band best, and their standard deviations."""
        held = self.samples_pm.shape[1]
        turned_mm, weight_pm = np.eye(held), np.ones_like(self.samples_pm)
        trust_4 = np.append(np.full(3, (0.3 + 0.01 * start.radius) ** -2), 0.0)
        start_4 = np.array([start.x, start.y, start.radius, 0.0])
        for _ in range(_TURNS):
            (inside_mm, outside_mm, _), share_p = self.off_law(values_4, turned_mm, weight_pm)
            inside_mm = inside_mm + (1e-3 * np.trace(inside_mm) / held + 1e-15) * np.eye(held)
            # Both diagonal at once: ways of going with the lamps that are off independently of each other.
            texture_m, turned_mm = linalg.eigh(outside_mm, inside_mm)
            # Texture is blurred as the outline is: about so many of its pixels say the same.
            alike = max(1.0, np.pi * float(np.exp(2.0 * values_4[3])))
            texture_m = np.maximum(np.where(texture_m > 1.0, 1.0 + alike * (texture_m - 1.0), texture_m), 0.3)
            share_p1 = np.clip(share_p, 0.0, 1.0)[:, None]
            weight_pm = 1.0 / np.sqrt(share_p1**2 + (1.0 - share_p1) ** 2 * texture_m)
            weight_pm *= self.robust_p[:, None]
            values_4, left_pm, slopes_pm4 = self._descend(values_4, start_4, trust_4, turned_mm, weight_pm)
            size_p = np.mean((left_pm / self.robust_p[:, None]) ** 2, axis=1)
            self.robust_p = 1.0 / np.sqrt(1.0 + size_p / (4.0 * np.median(size_p) + 1e-30))
        free = max(left_pm.size - held * sum(2 * each + 1 for each in self.orders), 1)
        # Texture is no noise: the same all along, it tells of another outline. What is sure hangs on the ways that are
        # free of it; the rest is shared with where the outline was.
        sure_m = 1.0 / (1.0 + _WRONG * np.maximum(texture_m - 1.0, 0.0) / texture_m)
        sure_44 = np.einsum("pma,m,pmb->ab", slopes_pm4, sure_m, slopes_pm4) / max(np.sum(left_pm**2) / free, 1.0)
        trust_44 = np.diag([*[_START_OFF**-2] * 3, 1e-6])
        total_44 = np.linalg.inv(sure_44 + trust_44)
        return values_4 + total_44 @ trust_44 @ ((start_4 - values_4) * [1, 1, 1, 0]), np.sqrt(np.diag(total_44))

    def _descend(
        self, values_4: NDArray, start_4: NDArray, trust_4: NDArray, turned_mm: NDArray, weight_pm: NDArray
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the values that leave least beside the trust in the start, what is left, and its slopes."""
        turned_pm, root_4 = self.samples_pm @ turned_mm, np.sqrt(trust_4)

        def evaluate(tried_4: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[_Solved, Design]]:
            design = self.design(tried_4)
            solved = _Solved(design.functions_pf, turned_pm, weight_pm)
            return np.append(solved.left_pm.ravel(), root_4 * (tried_4 - start_4)), (solved, design)

        def slopes(at_4: NDArray[np.float64], state: tuple[_Solved, Design]) -> NDArray[np.float64]:
            solved, design = state
            changes = list(design.moved(solved.found_fm))
            for k in (2, 3):
                step_4 = np.where(np.arange(4) == k, _STRIDES[k], 0.0)
                more, less = self._radial(at_4 + step_4), self._radial(at_4 - step_4)
                changes.append(design.exchanged(solved.found_fm, more, less) / (2.0 * _STRIDES[k]))
            change_pm4 = solved.beside(-np.stack(changes, axis=2))
            return np.concatenate([change_pm4.reshape(-1, 4), np.diag(root_4)])

        def confine(tried_4: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.append(tried_4[:3], np.clip(tried_4[3], np.log(_LEAST_BLUR), np.log(_MOST_BLUR * tried_4[2])))

        found = descend(values_4, evaluate, slopes, steps=_STEPS, settled_k=_NEAR_ENOUGH, confine=confine)
        return found.values_k, found.state[0].left_pm, found.slopes_nk[:-4].reshape(*turned_pm.shape, 4)


class _Solved:
    """Weighted least squares of each way of going with the lamps."""

    def __init__(self, design_pf: NDArray, samples_pm: NDArray, weight_pm: NDArray) -> None:
        self.design_pf, self.weight_pm = design_pf, weight_pm
        self.factors, found = [], []
        weighted_pf = np.empty_like(design_pf)
        for samples_p, weight_p in zip(samples_pm.T, weight_pm.T, strict=True):
            np.multiply(design_pf, weight_p[:, None], out=weighted_pf)
            normal_ff = weighted_pf.T @ weighted_pf
            normal_ff[np.diag_indices_from(normal_ff)] += 1e-6 * np.trace(normal_ff) / len(normal_ff)
            self.factors.append(linalg.cho_factor(normal_ff))
            found.append(linalg.cho_solve(self.factors[-1], weighted_pf.T @ (samples_p * weight_p)))
        self.found_fm = np.stack(found, axis=1)
        self.left_pm = (samples_pm - design_pf @ self.found_fm) * weight_pm

    def beside(self, change_pmk: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what of each of k changes no linear function follows, weighted."""
        left_pmk: NDArray[np.float64] = np.empty_like(change_pmk)
        for m, factor in enumerate(self.factors):
            weight_p1 = self.weight_pm[:, [m]]
            right_fk = self.design_pf.T @ (weight_p1**2 * change_pmk[:, m])
            left_pmk[:, m] = weight_p1 * (change_pmk[:, m] - self.design_pf @ linalg.cho_solve(factor, right_fk))
        return left_pmk
