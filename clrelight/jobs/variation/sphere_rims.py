"""Outlines of spheres by all photographs at once, and how sure they and the highlights leave a lamp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.variation.circles import Circle
from clrelight.variation.highlights import Highlight
from clrelight.variation.rims import Rim, fit_rim
from clrelight.variation.spheres import SphereView, flat_view, view_sphere

_OF_SPREAD, _OF_EXCESS = 0.1, 0.5
"""Shares of its pixels' spread, and of what that is beyond the usual, by which a highlight is off where no lobe tells
its middle."""


def inner_circle(circle: Circle, factor: float, corner: tuple[int, int]) -> Circle:
    """Return a circle of the photographs in the pixels of a part: the way back of `Circle.scaled`."""
    x, y = ((each - first + 0.5) / factor - 0.5 for each, first in zip((circle.x, circle.y), corner, strict=True))
    return replace(circle, x=x, y=y, radius=circle.radius / factor, off=circle.off / factor)


def rim_of(
    part_ihw: NDArray[np.float32], refined: Circle, sphere: SphereView, factor: float, corner: tuple[int, int]
) -> Rim | None:
    """Return the outline by all photographs at once; of a camera that is near in a view in which it is a circle."""
    if sphere.focal is None:
        return fit_rim(part_ihw, refined)
    flat = flat_view(sphere)

    def place(x_p: NDArray[np.floating], y_p: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        flat_x_p, flat_y_p = flat.there((x_p + 0.5) * factor - 0.5 + corner[0], (y_p + 0.5) * factor - 0.5 + corner[1])
        return flat_x_p / factor, flat_y_p / factor

    return fit_rim(part_ihw, replace(refined, x=0.0, y=0.0, radius=flat.radius / factor), place)


def seen_by_rim(
    rim: Rim, sphere: SphereView, shape_hw: tuple[int, int], factor: float, corner: tuple[int, int]
) -> SphereView:
    """Return how the sphere is seen whose outline was fitted."""
    if sphere.focal is None:
        return view_sphere(rim.circle.scaled(factor, *corner), shape_hw)
    angle_n = np.linspace(0.0, 2.0 * np.pi, 128, endpoint=False)
    x_n, y_n = flat_view(sphere).back(
        factor * (rim.circle.x + rim.circle.radius * np.cos(angle_n)),
        factor * (rim.circle.y + rim.circle.radius * np.sin(angle_n)),
    )
    x, y = float(x_n.mean()), float(y_n.mean())
    radius = float(np.hypot(x_n - x, y_n - y).mean())
    circle = replace(sphere.circle, x=x, y=y, radius=radius, off=rim.centre_off * factor)
    return view_sphere(circle, shape_hw, sphere.focal, np.stack([x_n, y_n], axis=1))


def uncertainty(
    sphere: SphereView,
    highlights: Sequence[Highlight | None],
    worth_i: NDArray[np.float64],
    rim: Rim | None,
    factor: float,
) -> NDArray[np.float64]:
    """Return degrees that a lamp is uncertain by: centre, radius and highlight, each independent of the others.

    The mean of a highlight's pixels is off by a share of its width, and by half of what it is wider than usual, as two
    that have run together are.
    """
    uncertain_i = np.full(len(worth_i), np.nan)
    if rim is None or not any(highlights):
        return uncertain_i
    usual = float(np.median([each.spread for each in highlights if each is not None]))
    for i, each in enumerate(highlights):
        if each is not None:
            away = np.hypot(each.x - sphere.circle.x, each.y - sphere.circle.y) / sphere.circle.radius
            centre, radius = rim.centre_off * factor, rim.radius_off * factor * away
            wider = np.sqrt(max(each.spread**2 - usual**2, 0.0))
            of_mean = np.hypot(_OF_SPREAD * each.spread, _OF_EXCESS * wider)
            middle = worth_i[i] * each.off if np.isfinite(each.off) else of_mean
            uncertain_i[i] = np.hypot(worth_i[i] * np.hypot(centre, radius), middle)
    return uncertain_i
