"""Solids as the zeros of smooth functions that are negative inside: parts, and blends of them.

Values are near the distance to the surface in scene units, but no exact distances; points are (n, 3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Solid = Callable[[NDArray[np.float64]], NDArray[np.float64]]

_STEP = 1e-4
# Shares of the value that are stepped towards the surface, and the least step: parts that are thinner may be missed.
_CAUTION, _SHORTEST = 0.5, 2e-3


def ellipsoid(centre: Sequence[float], radii: Sequence[float], turn: NDArray[np.float64] | None = None) -> Solid:
    """Return an ellipsoid; `turn` has its axes as rows."""
    middle_3, radii_3 = np.array(centre), np.array(radii)
    axes = np.eye(3) if turn is None else turn

    def value(points_n3: NDArray[np.float64]) -> NDArray[np.float64]:
        scaled_n3 = ((points_n3 - middle_3) @ axes.T) / radii_3
        length_n = np.linalg.norm(scaled_n3, axis=1)
        # f / |grad f| of the quadric: close to the distance near the surface (Quilez).
        slope_n = np.linalg.norm(scaled_n3 / radii_3, axis=1)
        return length_n * (length_n - 1.0) / np.maximum(slope_n, 1e-9)

    return value


def limb(start: Sequence[float], end: Sequence[float], radius_start: float, radius_end: float) -> Solid:
    """Return a rod with round ends between two points, whose radius goes from one to the other."""
    start_3, along_3 = np.array(start), np.array(end) - np.array(start)

    def value(points_n3: NDArray[np.float64]) -> NDArray[np.float64]:
        t_n = np.clip((points_n3 - start_3) @ along_3 / (along_3 @ along_3), 0.0, 1.0)
        away_n = np.linalg.norm(points_n3 - start_3 - t_n[:, None] * along_3, axis=1)
        return away_n - (radius_start + (radius_end - radius_start) * t_n)

    return value


def blend(first: Solid, second: Solid, width: float) -> Solid:
    """Return the union, rounded where the two are nearer than `width` to each other (Quilez's polynomial minimum)."""

    def value(points_n3: NDArray[np.float64]) -> NDArray[np.float64]:
        a_n, b_n = first(points_n3), second(points_n3)
        near_n = np.maximum(width - np.abs(a_n - b_n), 0.0) / width
        return np.minimum(a_n, b_n) - near_n * near_n * (width / 4.0)

    return value


def gradients(solid: Solid, points_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit vectors of the growing value, by central differences: outward normals at the surface."""
    shifts = _STEP * np.eye(3)
    slopes = [solid(points_n3 + shift) - solid(points_n3 - shift) for shift in shifts]
    gradient_n3 = np.stack(slopes, axis=1)
    return gradient_n3 / np.linalg.norm(gradient_n3, axis=1, keepdims=True)


def last_crossing(
    solid: Solid, origins_n3: NDArray[np.float64], directions_n3: NDArray[np.float64], reach: float
) -> NDArray[np.float64]:
    """Return how far along each ray from inside the solid is left for good, within `reach`.

    From outside inwards in steps of a part of the value, and then by 30 bisections.
    """
    outer_n = np.full(len(origins_n3), reach)
    inner_n = np.zeros(len(origins_n3))
    rays = np.arange(len(origins_n3))
    while len(rays):
        value = solid(origins_n3[rays] + outer_n[rays, None] * directions_n3[rays])
        next_ = outer_n[rays] - np.maximum(_CAUTION * value, _SHORTEST)
        inside = solid(origins_n3[rays] + next_[:, None] * directions_n3[rays]) < 0.0
        inner_n[rays[inside]] = next_[inside]
        outer_n[rays[~inside]] = next_[~inside]
        rays = rays[~inside & (next_ > 0.0)]
    for _ in range(30):
        middle_n = 0.5 * (inner_n + outer_n)
        inside_n = solid(origins_n3 + middle_n[:, None] * directions_n3) < 0.0
        inner_n, outer_n = np.where(inside_n, middle_n, inner_n), np.where(inside_n, outer_n, middle_n)
    return 0.5 * (inner_n + outer_n)
