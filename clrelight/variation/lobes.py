"""A highlight's middle by what it must look like: a lobe around one normal, blurred by the lens, on a smooth ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from clrelight.variation.circles import Circle, scaled_places
from clrelight.variation.descent import Descended, descend
from clrelight.variation.error_law import ErrorLaw
from clrelight.variation.spheres import SphereView

_TAILS = (2.0, 8.0)
"""Exponents p of a lobe's ``(1 + t^2 / (p w^2))^-p``: 2 is Trowbridge and Reitz's, 8 nearly Beckmann's and Phong's."""
_LOOKED_AT, _ROUNDS, _STEP, _NEAR_ENOUGH = 6, 12, 0.05, np.array([2e-3, 2e-3, np.inf])
_MOST_PIXELS = 2500
_LEAST_EXPLAINED = 0.97
"""Share of a highlight's energy that a lobe has to explain; a lamp of another form keeps the mean of its pixels."""
_CLIPPED = 0.995
_LEAST_PIXELS = 12
_LEAST_LOBES, _MOST_MOVED = 5, 0.5
"""Lobes that tell how far samples are off; pixels that weights may move a lobe by."""
Shown = tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.bool_]]
"""What moved, the samples, and the pixels of a highlight, each (height, width)."""
BOX = 1.0 / 12.0
"""Variance of a pixel's square, in pixels."""


@dataclass(frozen=True)
class Lobe:
    """The form of a highlight: which exponent, and around the normal or around the light that is mirrored."""

    tail: float
    by_light: bool


@dataclass(frozen=True)
class FoundLobe:
    """Where a lobe's middle is, in the part's pixels, and how sure that is.

    Attributes
    ----------
    x, y : float
    off : float
        Standard deviation of the place, in pixels.
    left : float
        Energy that is not explained, as a share of what varies.
    """

    x: float
    y: float
    off: float
    left: float


@dataclass(frozen=True)
class _Window:
    """The surroundings of a highlight: samples, and where its finer grid lies."""

    samples_p: NDArray[np.float64]
    ground_p3: NDArray[np.float64]
    rows: slice
    columns: slice
    fine: int
    margin: int
    kept_p: NDArray[np.intp]
    bright_p: NDArray[np.float64]
    weight_p: NDArray[np.float64]


_Fit = tuple[FoundLobe, _Window, Descended[NDArray[np.float64]]]


def _off(found: Descended[NDArray[np.float64]]) -> float:
    """Return the standard deviation of a lobe's place, by what is left."""
    variance = found.energy / max(len(found.left_n) - 7, 1)
    spread_33 = np.linalg.pinv(found.slopes_nk.T @ found.slopes_nk) * variance
    return float(np.sqrt(max(spread_33[0, 0] + spread_33[1, 1], 0.0) / 2.0))


class LobeFit:
    """Fits of lobes to highlights on one sphere.

    A glossy pixel shows ``A f(angle between its normal and the half-way one)`` in all models of half-way vectors, and a
    mirror ``A f(angle between its mirrored ray and the lamp)``: a lobe without direction in either space, which in the
    picture is squeezed near the outline. It is sampled finer than pixels, blurred, and averaged over each pixel.

    Parameters
    ----------
    circle : Circle
        In the part's pixels.
    sphere : SphereView
        In pixels of the photographs.
    factor, corner_xy
        See `Circle.scaled`.
    sigma : float
        Of the blur, pixels and all, in the part's pixels.
    noise : float
        Standard deviation of a sample.
    """

    def __init__(
        self, circle: Circle, sphere: SphereView, factor: float, corner_xy: tuple[int, int], sigma: float, noise: float
    ) -> None:
        self.noise = noise
        self.circle, self.sphere, self.factor, self.corner_xy = circle, sphere, factor, corner_xy
        self.lens = float(np.sqrt(max(sigma * sigma - BOX, 0.01)))

    def choose(self, windows: list[Shown], most: float) -> Lobe:
        """Return the form that leaves least of some highlights, each (moved, samples, blob)."""
        step = max(1, -(-len(windows) // _LOOKED_AT))
        left = {}
        for lobe in (Lobe(tail, by_light) for tail in _TAILS for by_light in (False, True)):
            found = [self._begin(*each, most, lobe) for each in windows[::step]]
            told = [1.0 if each is None else each[0].left for each in found]
            left[lobe] = float(np.mean(np.log(np.maximum(told, 1e-6))))
        return min(left, key=lambda each: left[each])

    def fit(self, windows: Sequence[Shown | None], most: float, lobe: Lobe) -> list[FoundLobe | None]:
        """Return the lobe of each highlight, (moved, samples, blob); None where it is none.

        Their heights and grounds, planes, follow middles and widths by least squares; clipped pixels do not count. How
        far samples are off at their brightness, as steps of codes, JPEG's errors and the law's own make them be, is
        told by all highlights together, and weights the samples of each.
        """
        begun = [None if each is None else self._begin(*each, most, lobe) for each in windows]
        kept = [each for each in begun if each is not None]
        if len(kept) < _LEAST_LOBES:
            return [None if each is None else each[0] for each in begun]
        bright_n = np.concatenate([window.bright_p for _, window, _ in kept])
        errors = ErrorLaw.of(bright_n, np.concatenate([found.left_n for _, _, found in kept]))
        return [None if each is None else self._go_on(each, errors, lobe) for each in begun]

    def _begin(
        self,
        moved_hw: NDArray[np.floating],
        samples_hw: NDArray[np.floating],
        blob_hw: NDArray[np.bool_],
        most: float,
        lobe: Lobe,
    ) -> _Fit | None:
        """Return the lobe of one highlight whose pixels are known, all samples alike; None where it is none."""
        rows_p, columns_p = np.nonzero(blob_hw)
        weight_p = np.maximum(moved_hw[rows_p, columns_p], 1e-12)
        x, y = float(np.average(columns_p, weights=weight_p)), float(np.average(rows_p, weights=weight_p))
        size = float(np.sqrt(len(rows_p) / np.pi))
        window = self._window(moved_hw, samples_hw, x, y, size, most)
        if window is None:
            return None
        width = np.hypot(size / self.circle.radius, 1e-3) * 0.5 * (2.0 if lobe.by_light else 1.0)
        found = self._descend(np.array([x, y, np.log(width)]), window, lobe)
        told = self._told(found, window, (x, y, size))
        return None if told is None else (told, window, found)

    def _go_on(self, begun: _Fit, errors: ErrorLaw, lobe: Lobe) -> FoundLobe:
        """Return the lobe by weighted samples; as it was where that leads elsewhere."""
        told, window, before = begun
        weighted = replace(window, weight_p=1.0 / np.sqrt(errors.variance(window.bright_p)))
        found = self._descend(before.values_k, weighted, lobe)
        x, y = (float(each) for each in found.values_k[:2])
        if found.state[0] <= 0.0 or np.hypot(x - told.x, y - told.y) > _MOST_MOVED:
            return told
        return replace(told, x=x, y=y, off=_off(found))

    def _descend(self, values_3: NDArray[np.float64], window: _Window, lobe: Lobe) -> Descended[NDArray[np.float64]]:
        return descend(
            values_3,
            lambda tried_3: self._left(tried_3, window, lobe),
            lambda at_3, solved_4: self._slopes(at_3, window, lobe, solved_4),
            steps=_ROUNDS,
            settled_k=_NEAR_ENOUGH,
        )

    def _told(
        self,
        found: Descended[NDArray[np.float64]],
        window: _Window,
        start: tuple[float, float, float],
    ) -> FoundLobe | None:
        x, y = (float(each) for each in found.values_k[:2])
        varied = window.samples_p - window.samples_p.mean()
        # Noise of samples is not the lobe's fault; the median of them had none to speak of.
        excess = found.energy - 1.5 * self.noise**2 * len(varied)
        energy = max(float(varied @ varied), 1e-30)
        moved = float(np.hypot(x - start[0], y - start[1]))
        is_alike = excess <= (1.0 - _LEAST_EXPLAINED) * energy
        if not is_alike or found.state[0] <= 0.0 or moved > 0.5 * start[2] + 0.7:
            return None
        return FoundLobe(x, y, _off(found), found.energy / energy)

    def _window(
        self,
        moved_hw: NDArray[np.floating],
        samples_hw: NDArray[np.floating],
        x: float,
        y: float,
        size: float,
        most: float,
    ) -> _Window | None:
        height, width = moved_hw.shape
        reach = 1.7 * size + 2.5 * self.lens + 1.5
        top, left = max(0, int(y - reach)), max(0, int(x - reach))
        rows, columns = slice(top, min(height, int(y + reach) + 2)), slice(left, min(width, int(x + reach) + 2))
        y_hw, x_hw = np.mgrid[rows, columns]
        seen_hw = np.hypot(x_hw - self.circle.x, y_hw - self.circle.y) < self.circle.radius - 1.5 * self.lens - 0.3
        seen_hw &= (samples_hw[rows, columns] < _CLIPPED * most) & (np.hypot(x_hw - x, y_hw - y) < reach)
        if np.count_nonzero(seen_hw) < _LEAST_PIXELS:
            return None
        # Where the highlight is many pixels wide, neither blur nor each of its pixels matters.
        fine = 1 if size > 8.0 * self.lens + 6.0 else int(np.clip(np.ceil(1.6 / self.lens), 2, 5))
        kept_p = np.flatnonzero(seen_hw)
        kept_p = kept_p[:: max(1, len(kept_p) // _MOST_PIXELS)]
        ground_p3 = np.stack([np.ones_like(x_hw), (x_hw - x) / reach, (y_hw - y) / reach], axis=-1).reshape(-1, 3)
        return _Window(
            moved_hw[rows, columns].ravel()[kept_p].astype(np.float64),
            ground_p3[kept_p],
            rows,
            columns,
            fine,
            int(np.ceil(3.0 * self.lens)) if fine > 1 else 0,
            kept_p,
            np.maximum(samples_hw[rows, columns].ravel()[kept_p].astype(np.float64), 0.0),
            np.ones(len(kept_p)),
        )

    def _left(
        self, values_3: NDArray[np.float64], window: _Window, lobe: Lobe
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what is left, and the height with the ground's three."""
        columns_p4, samples_p = self._columns(values_3, window, lobe), window.samples_p * window.weight_p
        solved_4 = np.asarray(np.linalg.lstsq(columns_p4, samples_p, rcond=None)[0], np.float64)
        return samples_p - columns_p4 @ solved_4, solved_4

    def _columns(self, values_3: NDArray[np.float64], window: _Window, lobe: Lobe) -> NDArray[np.float64]:
        columns_p4 = np.concatenate([self._shape(values_3, window, lobe)[:, None], window.ground_p3], axis=1)
        return columns_p4 * window.weight_p[:, None]

    def _slopes(
        self, values_3: NDArray[np.float64], window: _Window, lobe: Lobe, solved_4: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how what is left changes with each value, height and ground following (Kaufman)."""
        changes = []
        for step_3 in _STEP * np.eye(3):
            more_p, less_p = (self._shape(values_3 + sign * step_3, window, lobe) for sign in (1.0, -1.0))
            changes.append(-solved_4[0] * (more_p - less_p) / (2.0 * _STEP) * window.weight_p)
        columns_p4, slopes_p3 = self._columns(values_3, window, lobe), np.stack(changes, axis=1)
        return slopes_p3 - columns_p4 @ np.linalg.lstsq(columns_p4, slopes_p3, rcond=None)[0]

    def _shape(self, values_3: NDArray[np.float64], window: _Window, lobe: Lobe) -> NDArray[np.float64]:
        """Return a lobe of height 1 before the blur, as the window's pixels show it."""
        fine, margin = window.fine, window.margin
        sides = [
            np.arange((each.stop - each.start + 2 * margin) * fine) / fine + each.start - margin + 0.5 / fine - 0.5
            for each in (window.rows, window.columns)
        ]
        y_hw, x_hw = np.meshgrid(*sides, indexing="ij")
        x_q, y_q = self._places(x_hw.ravel(), y_hw.ravel())
        tell = self.sphere.mirrored if lobe.by_light else self.sphere.normals
        middle_3 = tell(*self._places(values_3[:1], values_3[1:2]))[0]
        vectors_q3 = tell(x_q, y_q)
        # 2 sin of half the angle: exact where it is small.
        squared_q = np.sum((vectors_q3 - middle_3) ** 2, axis=1)
        shape_hw = (1.0 + squared_q / (lobe.tail * np.exp(2.0 * values_3[2]))) ** -lobe.tail
        shape_hw = np.where(np.any(vectors_q3 != 0.0, axis=1), shape_hw, 0.0).reshape(x_hw.shape)
        if fine > 1:
            shape_hw = ndimage.gaussian_filter(shape_hw, self.lens * fine, mode="nearest", truncate=3.5)
            height, width = len(sides[0]) // fine, len(sides[1]) // fine
            shape_hw = shape_hw.reshape(height, fine, width, fine).mean(axis=(1, 3))
            shape_hw = shape_hw[margin : height - margin, margin : width - margin]
        picked_p: NDArray[np.float64] = shape_hw.ravel()[window.kept_p]
        return picked_p

    def _places(
        self, x_p: NDArray[np.float64], y_p: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return scaled_places(x_p, y_p, self.factor, self.corner_xy)

    def light(self, found: FoundLobe) -> tuple[float, float, NDArray[np.float64]]:
        """Return a lobe's middle in pixels of the photographs, and the unit vector to its lamp."""
        x_1, y_1 = self._places(np.array([found.x]), np.array([found.y]))
        return float(x_1[0]), float(y_1[0]), self.sphere.mirrored(x_1, y_1)[0]
