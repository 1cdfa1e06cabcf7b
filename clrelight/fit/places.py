"""Where the lights of a fit stand: photographs of one light, the gaps between lights, and zones around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.fit.plan import Lighting, is_sphere
from clrelight.holdout import group_directions
from clrelight.sampling import GOLDEN_ANGLE, from_height

_GRID = 3000
MOST_LIGHTS = 8192
"""A matrix of all their pairs takes half a gigabyte, and several are made."""
_PEAK_WIDTH = np.cos(np.radians(6.0))
"""A gap's centre is the farthest point from all lights among those this near."""


@dataclass(frozen=True)
class Places:
    """Distinct lights, and the photographs of each.

    Attributes
    ----------
    directions_g3 : ndarray, shape (n_place, 3), float64
    mean_gi : ndarray, shape (n_place, n_light), float64
        Weighted mean over the photographs of each place.
    count_g : ndarray, shape (n_place,), float64
        Photographs of each place, each counted by its weight: their mean has that many times less noise.
    """

    directions_g3: NDArray[np.float64]
    mean_gi: NDArray[np.float64]
    count_g: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.directions_g3)


def find_places(lighting: Lighting) -> Places:
    """Return the distinct lights; a photograph of weight 0 is none. InputError of more than `MOST_LIGHTS`."""
    counted = np.flatnonzero(lighting.solid_angles_i > 0.0)
    if len(counted) > MOST_LIGHTS:
        raise InputError(
            f"auto and spectrum weigh each light against each other, at most {MOST_LIGHTS}, got {len(counted)}: "
            "take another method with a degree of its own (--method cls --degree 6), or fewer lights"
        )
    place_i = group_directions(lighting.directions_i3[counted])
    mean_gi = np.zeros((int(place_i.max(initial=-1)) + 1, len(lighting.directions_i3)))
    mean_gi[place_i, counted] = lighting.row_weights_i[counted] * lighting.copies_i[counted]
    count_g = mean_gi.sum(axis=1)
    mean_gi /= count_g[:, None]
    directions_g3 = mean_gi @ lighting.directions_i3
    directions_g3 /= np.linalg.norm(directions_g3, axis=1, keepdims=True)
    return Places(directions_g3, mean_gi, count_g)


def merge_photographs(lighting: Lighting, radiance_ip: NDArray[np.float64]) -> tuple[Lighting, NDArray[np.float64]]:
    """Return each direction once, with its weight, and the mean of its photographs."""
    if lighting.copies_i.max() == 1:
        return lighting, radiance_ip
    places = find_places(lighting)
    angles_g = (places.mean_gi > 0.0) @ lighting.solid_angles_i
    once_g = np.ones(len(places), np.intp)
    merged = replace(lighting, directions_i3=places.directions_g3, solid_angles_i=angles_g, copies_i=once_g)
    return merged, places.mean_gi @ radiance_ip


def spread_points(count: int, sphere: bool) -> NDArray[np.float64]:
    """Return directions that cover the hemisphere, or the sphere, evenly: a Fibonacci lattice.

    It is mirrored or turned against the lights of pattern ``"uniform"``, so that it does not fall on them.
    """
    index = np.arange(count) + 0.5
    return from_height(1.0 - 2.0 * index / count if sphere else index / count, index * GOLDEN_ANGLE)


def nearest_angles(points_t3: NDArray[np.float64], directions_g3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angle (radians) from each point to the nearest light."""
    return np.asarray(np.arccos(np.clip((points_t3 @ directions_g3.T).max(axis=1), -1.0, 1.0)))


def mutual_angles(directions_g3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angle (radians) between every two lights, shape (n_place, n_place)."""
    return np.asarray(np.arccos(np.clip(directions_g3 @ directions_g3.T, -1.0, 1.0)))


def find_gap_radii(directions_g3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance (radians) from each gap's centre to its nearest light.

    Gaps are looked for in the region that the lights span. Fewer than four lights have none: zeros. Each gap counts
    once, and small ones between its lights not at all; `clrelight.holdout.typical_gap`, by area over all of them, is
    another figure: 8 to 22 per cent above the median of these for patterns of lights.
    """
    return _gap_radii(np.ascontiguousarray(directions_g3, np.float64).tobytes()).copy()


@lru_cache(maxsize=4)
def _gap_radii(directions: bytes) -> NDArray[np.float64]:
    """`find_gap_radii` of the same lights, which several parts of a choice ask for."""
    directions_g3 = np.frombuffer(directions).reshape(-1, 3)
    if len(directions_g3) < 4:
        return np.zeros(len(directions_g3))
    points = spread_points(_GRID, is_sphere(directions_g3))
    near = nearest_angles(points, directions_g3)
    inside = _between(directions_g3, points, near)
    if inside.sum() < 10:
        inside = near <= np.sort(near)[min(len(near) - 1, 50)]
    points, near = points[inside], near[inside]
    peak = np.where(points @ points.T >= _PEAK_WIDTH, near[None], -1.0).max(axis=1) <= near
    return near[peak]


def _between(directions_g3: NDArray, points: NDArray, near: NDArray) -> NDArray[np.bool_]:
    """Return which points lie in the hull of the lights as seen from above."""
    from scipy.spatial import Delaunay, QhullError  # slow to load

    if is_sphere(directions_g3):
        return np.ones(len(points), bool)
    try:
        return np.asarray(Delaunay(1.02 * directions_g3[:, :2]).find_simplex(points[:, :2]) >= 0)
    except (QhullError, ValueError):  # all on a line
        return near <= 2.0 * np.median(near)


def list_unseen(directions_g3: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Return the directions that "lights nobody photographed" stands for.

    Those all over the hemisphere above the lowest light that are so many radians or more from every light.
    """
    points = spread_points(600, is_sphere(directions_g3))
    points = points[points[:, 2] >= directions_g3[:, 2].min() - 0.02]
    if len(points):
        points = points[nearest_angles(points, directions_g3) >= least]
    return points if len(points) else directions_g3


def find_zones(directions_g3: NDArray[np.float64], radius: float) -> list[NDArray[np.intp]]:
    """Return, for each light, itself and all lights nearer than `radius`, but at most half of all; itself first."""
    angle = mutual_angles(directions_g3)
    np.fill_diagonal(angle, -1.0)
    most = max(1, len(angle) // 2)
    return [np.argsort(row, kind="stable")[: min(max(1, int((row < radius).sum())), most)] for row in angle]


def stack_zones(zones: Sequence[NDArray[np.intp]]) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return zones of equal size together: which they are, and their members, shape (n_zone, size)."""
    size_z = np.array([len(zone) for zone in zones], np.intp)
    alike = [np.flatnonzero(size_z == size) for size in np.unique(size_z)]
    return [(which, np.array([zones[z] for z in which.tolist()], np.intp)) for which in alike]


def pick_spread(directions_g3: NDArray[np.float64], most: int) -> NDArray[np.intp]:
    """Return at most so many lights, far from each other, in their order."""
    if len(directions_g3) <= most:
        return np.arange(len(directions_g3))
    taken = [int(np.argmax(directions_g3[:, 2]))]
    near = directions_g3 @ directions_g3[taken[0]]
    while len(taken) < most:
        taken.append(int(np.argmin(near)))
        near = np.maximum(near, directions_g3 @ directions_g3[taken[-1]])
    return np.sort(np.array(taken))
