"""Circles in pictures: votes of edges for centres (Hough), and an outline to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_EDGE_SHARE = 0.12
"""Share of a picture's pixels that vote, the sharpest beside their surroundings."""
_SURROUNDINGS = 15
_ANGLES, _STEP = 360, 0.25
_WINDOWS = (0.16, 0.10, 0.06, 0.04, 0.03, 0.03)
"""Shares of the radius beside the circle in which its outline is looked for, step by step."""
_NEAR = 0.02
"""Share of the radius by which an edge may be off the circle and still be of its outline."""
_LEAST_PIXELS = 1.0
_APART = 3.0
"""Pixels of place and radius that circles differ by at least: of small ones too."""
_FLOOR = 1e-9


Place = TypeVar("Place", float, NDArray[np.float64])


def scaled_places(x: Place, y: Place, factor: float, corner_xy: tuple[float, float]) -> tuple[Place, Place]:
    """Return places in a picture of larger pixels, `factor` of these, whose first is at `corner_xy` there."""
    return (x + 0.5) * factor - 0.5 + corner_xy[0], (y + 0.5) * factor - 0.5 + corner_xy[1]


@dataclass(frozen=True)
class Circle:
    """A circle in a picture, in pixels: x of columns, y of rows, 0 at the centre of the first.

    Attributes
    ----------
    x, y, radius : float
    outline : float
        Share of its outline where there is an edge.
    off : float
        Root mean square of how far these edges are off the circle, in pixels.
    """

    x: float
    y: float
    radius: float
    outline: float = 1.0
    off: float = 0.0

    def scaled(self, factor: float, x: float = 0.0, y: float = 0.0) -> Circle:
        """Return the circle in a picture of larger pixels, `factor` of these, whose first is at (x, y) there."""
        centre_x, centre_y = scaled_places(self.x, self.y, factor, (x, y))
        return replace(self, x=centre_x, y=centre_y, radius=self.radius * factor, off=self.off * factor)


def find_circles(pictures: Sequence[NDArray[np.floating]], radii: tuple[float, float], count: int = 8) -> list[Circle]:
    """Return the circles that most edges of some pictures of one view agree on, the best first.

    Each edge votes for the centres that lie along its gradient at every radius, on either side: the background may be
    brighter or darker than the disc.

    Parameters
    ----------
    pictures : sequence of ndarray, shape (height, width)
    radii : (float, float)
        Least and largest radius, in pixels.
    count : int
        Circles to return at most; no two have almost the same place.
    """
    height, width = pictures[0].shape
    points = np.concatenate([_edges(picture_hw) for picture_hw in pictures])
    y_e, x_e, down_e, right_e, weight_e = points.T
    found: list[tuple[float, float, float, float]] = []
    radius = radii[0]
    while radius <= radii[1]:
        votes_hw = np.zeros(height * width)
        for side in (-1.0, 1.0):
            column_e = np.rint(x_e + side * radius * right_e).astype(np.int64)
            row_e = np.rint(y_e + side * radius * down_e).astype(np.int64)
            inside_e = (column_e >= 0) & (column_e < width) & (row_e >= 0) & (row_e < height)
            place_e = row_e[inside_e] * width + column_e[inside_e]
            votes_hw += np.bincount(place_e, weight_e[inside_e], height * width)
        blur = max(1.0, 0.025 * radius)
        smooth_hw = ndimage.gaussian_filter(votes_hw.reshape(height, width), blur, mode="constant")
        # A share of the outline; that of a large circle comes about by chance less often than that of a small one.
        smooth_hw *= blur**2 / np.sqrt(radius)
        is_top_hw = smooth_hw == ndimage.maximum_filter(smooth_hw, max(3, int(0.3 * radius)))
        rows, columns = np.nonzero(is_top_hw & (smooth_hw > 0.0))
        best = np.argsort(smooth_hw[rows, columns])[::-1][:count]
        found += [(float(smooth_hw[rows[i], columns[i]]), float(columns[i]), float(rows[i]), radius) for i in best]
        radius += max(1.0, 0.03 * radius)
    kept: list[Circle] = []
    for _, x, y, radius in sorted(found, reverse=True):
        if all(
            np.hypot(x - each.x, y - each.y) + abs(radius - each.radius) > max(0.25 * radius, _APART) for each in kept
        ):
            kept.append(Circle(x, y, radius))
        if len(kept) == count:
            break
    return kept


def _edges(picture_hw: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return (rows, 5): y, x, the gradient's direction down and right, and a weight of edges."""
    # The root evens out dark and bright parts, as an eye does.
    root_hw = ndimage.gaussian_filter(np.sqrt(np.maximum(picture_hw, 0.0).astype(np.float64)), 1.0)
    down_hw, right_hw = np.gradient(root_hw)
    size_hw = np.hypot(down_hw, right_hw)
    around_hw = ndimage.uniform_filter(size_hw, _SURROUNDINGS)
    sharp_hw = size_hw / (around_hw + 0.1 * size_hw.mean() + _FLOOR)
    y_e, x_e = np.nonzero(sharp_hw >= max(np.quantile(sharp_hw, 1.0 - _EDGE_SHARE), _FLOOR))
    size_e = np.maximum(size_hw[y_e, x_e], _FLOOR)
    weight_e = np.minimum(sharp_hw[y_e, x_e], 3.0) / 3.0
    return np.stack([y_e, x_e, down_hw[y_e, x_e] / size_e, right_hw[y_e, x_e] / size_e, weight_e], axis=1)


def refine_circle(pictures: Sequence[NDArray[np.floating]], start: Circle) -> tuple[Circle, NDArray[np.float64]]:
    """Return a circle moved onto the outline that pictures show, and the points of the outline, (n, 2) of x and y.

    Along rays from its centre the sharpest step is found to a fraction of a pixel, nearer and nearer to the circle; a
    circle is fitted to them by least squares, steps far off it counting less and less.
    """
    found, points_n2 = start, np.zeros((0, 2))
    # Twice as long as one pixel's edge: noise of single pixels is no outline.
    smoothed = [ndimage.gaussian_filter(np.asarray(each, np.float64), 0.8) for each in pictures]
    for window in _WINDOWS:
        half = max(window * found.radius, 2.0)
        radius_n, x_n, y_n, strength_n = _steps(smoothed, found, half)
        if len(radius_n) < 8:
            return replace(found, outline=0.0), points_n2
        centre = np.array([found.x, found.y, found.radius])
        for _ in range(10):
            away_n = np.hypot(x_n - centre[0], y_n - centre[1]) - centre[2]
            scale = max(1.5 * float(np.median(np.abs(away_n))), 0.05)
            weight_n = strength_n / (1.0 + (away_n / scale) ** 2)
            centre = _fit_circle(x_n, y_n, weight_n)
        if not np.all(np.isfinite(centre)) or np.hypot(centre[0] - found.x, centre[1] - found.y) > half:
            return replace(found, outline=0.0), points_n2
        away_n = np.hypot(x_n - centre[0], y_n - centre[1]) - centre[2]
        near_n = np.abs(away_n) < max(_NEAR * centre[2], _LEAST_PIXELS)
        points_n2 = np.stack([x_n[near_n], y_n[near_n]], axis=1)
        off = float(np.sqrt(np.mean(away_n[near_n] ** 2))) if near_n.any() else 0.0
        angle_n = np.arctan2(y_n[near_n] - centre[1], x_n[near_n] - centre[0])
        seen = np.unique(np.floor((angle_n + np.pi) * (_ANGLES / (2.0 * np.pi)))).size / _ANGLES
        found = Circle(float(centre[0]), float(centre[1]), float(centre[2]), seen, off)
    return found, points_n2


def _steps(pictures: Sequence[NDArray[np.float64]], circle: Circle, half: float) -> tuple[NDArray[np.float64], ...]:
    """Return radius, x, y and strength of the sharpest step along each ray, in each picture."""
    angle_a = np.arange(_ANGLES) * (2.0 * np.pi / _ANGLES)
    radius_r = np.arange(circle.radius - half, circle.radius + half + _STEP, _STEP)
    radius_r = radius_r[radius_r > 0.0]
    x_ar = circle.x + np.cos(angle_a)[:, None] * radius_r
    y_ar = circle.y + np.sin(angle_a)[:, None] * radius_r
    parts = []
    for picture_hw in pictures:
        height, width = picture_hw.shape
        profile_ar = ndimage.map_coordinates(picture_hw, [y_ar, x_ar], order=1, mode="nearest")
        slope_ar = np.abs(profile_ar[:, 2:] - profile_ar[:, :-2])
        at_a = slope_ar.argmax(axis=1)
        inner = (at_a > 0) & (at_a < slope_ar.shape[1] - 1)
        x_a = circle.x + np.cos(angle_a) * radius_r[at_a + 1]
        y_a = circle.y + np.sin(angle_a) * radius_r[at_a + 1]
        inner &= (x_a > 1.0) & (x_a < width - 2.0) & (y_a > 1.0) & (y_a < height - 2.0)
        rows = np.flatnonzero(inner)
        before, middle, after = (slope_ar[rows, at_a[rows] + shift] for shift in (-1, 0, 1))
        bend = before - 2.0 * middle + after
        shift = np.where(bend < -_FLOOR, 0.5 * (before - after) / np.where(bend < -_FLOOR, bend, 1.0), 0.0)
        radius_a = radius_r[at_a[rows] + 1] + _STEP * np.clip(shift, -1.0, 1.0)
        # A step beside what else lies along the ray, so that a faint picture counts as much as a bright one.
        strength_a = middle / (slope_ar[rows].mean(axis=1) + 0.05 * slope_ar.max() + _FLOOR)
        x_a, y_a = circle.x + np.cos(angle_a[rows]) * radius_a, circle.y + np.sin(angle_a[rows]) * radius_a
        parts.append((radius_a, x_a, y_a, strength_a))
    return tuple(np.concatenate([part[i] for part in parts]) for i in range(4))


def _fit_circle(x_n: NDArray[np.float64], y_n: NDArray[np.float64], weight_n: NDArray[np.float64]) -> NDArray:
    """Return x, y and radius of weighted least squares (Kasa): ``x^2 + y^2 = 2 a x + 2 b y + c``."""
    total = float(weight_n.sum())
    x_mean, y_mean = float(weight_n @ x_n) / total, float(weight_n @ y_n) / total
    # About the mean the last unknown stands alone; steps all on a line leave the middle on it.
    from_mean_2n = np.stack([x_n - x_mean, y_n - y_mean])
    squared_n = np.sum(from_mean_2n**2, axis=0)
    weighted_2n = weight_n * from_mean_2n
    a, b = np.linalg.lstsq(2.0 * (weighted_2n @ from_mean_2n.T), weighted_2n @ squared_n, rcond=None)[0]
    c = float(weight_n @ squared_n) / total
    return np.array([a + x_mean, b + y_mean, np.sqrt(max(c + a * a + b * b, 0.0))])
