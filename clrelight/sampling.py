"""Light directions on the hemisphere: patterns of them, their solid angles and well-spread subsets."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import check_directions
from clrelight.errors import InputError, counted

PATTERNS = ("uniform", "grid", "scattered")
"""Sampling patterns of noise-resistant-fitting, fig. 2: (a) uniform, (b) regular grid, (c) scattered."""

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

# A grid's azimuth step may be up to twice, or down to half, its elevation step; 4 columns per row makes them equal.
_GRID_COLUMNS_PER_ROW = (2, 8)

_PATCHES = 3
_PATCH_RADIUS = math.radians(35.0)
_PATCH_LOWEST_Z = 0.2

_HORIZON_TOLERANCE = 1e-6
_DUPLICATE_DECIMALS = 9
_CLIP_TOLERANCE = 1e-13


def make_pattern(pattern: str, count: int, seed: int = 0, *, sphere: bool = False) -> NDArray[np.float64]:
    """Return `count` light directions of one of `PATTERNS`, all strictly above the horizon unless `sphere` is True.

    Parameters
    ----------
    pattern : str
        ``"uniform"``: a Fibonacci spiral, each light with the same area (z is uniform on a hemisphere of
        equal areas). ``"grid"``: rows of elevation times columns of azimuth with equal angular steps, half a
        step away from horizon and zenith; dense towards the zenith. ``"scattered"``: random points inside
        three random patches of 35 degrees radius, so that most of the hemisphere is not sampled.
    count : int
        Number of lights, at least 1. A grid needs a product rows x columns with 2 to 8 columns per row.
    seed : int
        Seed of ``"scattered"``; the other patterns are fixed.
    sphere : bool
        Cover the whole sphere, which only ``"uniform"`` can.

    Returns
    -------
    ndarray, shape (count, 3), float64
        Unit vectors; those of the hemisphere have z > 0.

    Raises
    ------
    InputError
        Unknown pattern, a count below 1, a negative seed, a count that makes no grid (the message names the
        nearest ones that do), or another pattern than ``"uniform"`` on the sphere.
    """
    if pattern not in PATTERNS:
        raise InputError(f"pattern must be one of {', '.join(PATTERNS)}, got {pattern!r}")
    if count < 1:
        raise InputError(f"a pattern needs at least 1 light, got {count}")
    if seed < 0:
        raise InputError(f"seed must be at least 0, got {seed}")
    if pattern == "uniform":
        return _make_spiral(count, 2.0 if sphere else 1.0)
    if sphere:
        raise InputError(f"{pattern} is a pattern of the hemisphere, uniform one of the sphere too")
    if pattern == "grid":
        return _make_grid(count)
    return _make_patches(count, seed)


def from_height(z_i: NDArray, azimuth_i: NDArray) -> NDArray[np.float64]:
    """Return unit vectors (n, 3) of their heights and azimuths in radians."""
    radius_i = np.sqrt(np.maximum(1.0 - z_i * z_i, 0.0))
    return np.stack([radius_i * np.cos(azimuth_i), radius_i * np.sin(azimuth_i), z_i], axis=1)


def _make_spiral(count: int, depth: float) -> NDArray[np.float64]:
    step_i = np.arange(count)
    return from_height(1.0 - depth * (step_i + 0.5) / count, step_i * GOLDEN_ANGLE)


def _grid_rows(count: int) -> int | None:
    """Return the number of rows whose steps are closest to equal, None where `count` makes no grid."""
    low, high = _GRID_COLUMNS_PER_ROW
    fits = [r for r in range(1, math.isqrt(count) + 1) if count % r == 0 and low * r * r <= count <= high * r * r]
    return min(fits, key=lambda rows: abs(math.log(count / (4 * rows * rows)))) if fits else None


def _make_grid(count: int) -> NDArray[np.float64]:
    rows = _grid_rows(count)
    if rows is None:
        below = next((n for n in range(count - 1, 0, -1) if _grid_rows(n)), None)
        above = next(n for n in range(count + 1, 4 * (math.isqrt(count) + 1) ** 2 + 1) if _grid_rows(n))
        near = f"{below} and {above}" if below else f"{above}"
        raise InputError(
            f"{counted(count, 'light makes', 'lights make')} no regular grid of rows x columns; "
            f"the nearest that do: {near}"
        )
    columns = count // rows
    elevation_i = np.repeat((np.arange(rows) + 0.5) * (0.5 * math.pi / rows), columns)
    azimuth_i = np.tile((np.arange(columns) + 0.5) * (2.0 * math.pi / columns), rows)
    return from_height(np.sin(elevation_i), azimuth_i)


def _make_patches(count: int, seed: int) -> NDArray[np.float64]:
    # Only Generator.random is drawn: the one stream that NumPy versions have in common.
    rng = np.random.default_rng(seed)
    u = rng.random((_PATCHES, 2))
    centres_j3 = from_height(1.0 - (1.0 - _PATCH_LOWEST_Z) * u[:, 0], 2.0 * math.pi * u[:, 1])
    chosen_i3 = np.empty((0, 3))
    while len(chosen_i3) < count:
        u = rng.random((2 * count + 64, 2))
        tried_i3 = from_height(1.0 - u[:, 0], 2.0 * math.pi * u[:, 1])
        inside_i = np.any(tried_i3 @ centres_j3.T >= math.cos(_PATCH_RADIUS), axis=1)
        chosen_i3 = np.concatenate([chosen_i3, tried_i3[inside_i]])
    return chosen_i3[:count]


def solid_angle_weights(directions_i3: NDArray[np.float64], *, sphere: bool = False) -> NDArray[np.float64]:
    """Return the area of each light's Voronoi cell on the upper hemisphere, cut at the horizon.

    The cell of a light is the part of the hemisphere that is nearer to it than to any other light. It is cut
    out of the hemisphere's four quadrants: while a corner of the piece is nearer to another light, the piece
    is clipped by the great circle half-way to that light. A convex piece whose corners all belong to the
    light belongs to it whole, so the result is exact for any set: one light, lights on one arc, on the horizon.

    Parameters
    ----------
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors. Equal ones (to 1e-9) share their cell equally.
    sphere : bool
        Weigh over the whole sphere instead, for sets with lights below the horizon.

    Returns
    -------
    ndarray, shape (n_light,), float64
        Solid angles in steradian, finite and >= 0; their sum is 2 pi, or 4 pi for the sphere.

    Raises
    ------
    InputError
        Directions are no unit vectors, there are none, or one is below the horizon while `sphere` is False.
    """
    check_directions(directions_i3, None)
    if not len(directions_i3):
        raise InputError("solid angles need at least 1 light, got none")
    lowest = int(np.argmin(directions_i3[:, 2]))
    if not sphere and directions_i3[lowest, 2] < -_HORIZON_TOLERANCE:
        raise InputError(
            f"light {lowest} is below the horizon (z = {directions_i3[lowest, 2]:.4g}): "
            "leave it out, or weigh over the whole sphere"
        )
    # Adding zero turns -0.0 into 0.0, which is the same direction.
    rounded_i3 = np.round(directions_i3, _DUPLICATE_DECIMALS) + 0.0
    sites_j3, owner_i, share_j = np.unique(rounded_i3, axis=0, return_inverse=True, return_counts=True)
    sites_j3 /= np.linalg.norm(sites_j3, axis=1, keepdims=True)
    return (_cell_areas(sites_j3, sphere) / share_j)[owner_i.reshape(-1)]


def _cell_areas(sites_j3: NDArray[np.float64], sphere: bool) -> NDArray[np.float64]:
    from scipy.spatial import cKDTree  # slow to load, and of no use without solid angles

    signs = [(x, y, z) for x in (1.0, -1.0) for y in (1.0, -1.0) for z in ((1.0, -1.0) if sphere else (1.0,))]
    octants_q33 = np.array([np.diag(sign) for sign in signs])
    tree = cKDTree(sites_j3)
    site_b = np.repeat(np.arange(len(sites_j3)), len(signs))
    corners_bv3 = np.tile(octants_q33, (len(sites_j3), 1, 1))
    # A corner's nearest site never changes, so each is looked up once and carried along.
    nearest_bv = np.tile(tree.query(octants_q33)[1], (len(sites_j3), 1))
    area_j = np.zeros(len(sites_j3))
    while len(site_b):
        toward_bv3 = sites_j3[nearest_bv] - sites_j3[site_b][:, None]
        gap_bv = np.einsum("bvx,bvx->bv", toward_bv3, corners_bv3)
        worst_b = np.argmax(gap_bv, axis=1)
        rows = np.arange(len(site_b))
        foreign_b = gap_bv[rows, worst_b] > _CLIP_TOLERANCE
        np.add.at(area_j, site_b[~foreign_b], _polygon_areas(corners_bv3[~foreign_b]))
        planes_b3 = -toward_bv3[rows, worst_b][foreign_b]
        corners_bv3, nearest_bv, alive_b = _clip_polygons(corners_bv3[foreign_b], nearest_bv[foreign_b], planes_b3)
        site_b = site_b[foreign_b][alive_b]
        new_bv = nearest_bv < 0
        nearest_bv[new_bv] = tree.query(corners_bv3[new_bv])[1]
    return area_j


def _clip_polygons(
    corners_bv3: NDArray[np.float64], nearest_bv: NDArray[np.intp], planes_b3: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.bool_]]:
    """Keep the side of each convex spherical polygon where plane . x >= 0.

    Returns the corners of the polygons of which something is left (short ones repeat their last corner), the
    corners' nearest sites (-1 for new corners), and which polygons those are.
    """
    here_bv = np.einsum("bx,bvx->bv", planes_b3, corners_bv3)
    there_bv = np.roll(here_bv, -1, axis=1)
    crosses_bv = (here_bv >= 0) != (there_bv >= 0)
    cut_bv3 = np.abs(there_bv)[..., None] * corners_bv3 + np.abs(here_bv)[..., None] * np.roll(corners_bv3, -1, axis=1)
    length_bv = np.linalg.norm(cut_bv3, axis=2)
    cut_bv3 /= np.where(length_bv > 0, length_bv, 1.0)[..., None]

    n_polygon, n_corner = here_bv.shape
    all_bu3 = np.stack([corners_bv3, cut_bv3], axis=2).reshape(n_polygon, 2 * n_corner, 3)
    all_nearest_bu = np.stack([nearest_bv, np.full_like(nearest_bv, -1)], axis=2).reshape(n_polygon, 2 * n_corner)
    kept_bu = np.stack([here_bv >= 0, crosses_bv], axis=2).reshape(n_polygon, 2 * n_corner)
    size_b = kept_bu.sum(axis=1)
    alive_b = size_b >= 3
    width = int(size_b.max(initial=3))
    order_bu = np.argsort(~kept_bu, axis=1, kind="stable")
    slot_bu = np.minimum(np.arange(width), np.maximum(size_b - 1, 0)[:, None])
    picked_bu = np.take_along_axis(order_bu, slot_bu, axis=1)[alive_b]
    rows_b1 = np.flatnonzero(alive_b)[:, None]
    return all_bu3[rows_b1, picked_bu], all_nearest_bu[rows_b1, picked_bu], alive_b


def _polygon_areas(polygons_bv3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Areas of convex spherical polygons as fans of triangles (Van Oosterom and Strackee 1983, eq. 8)."""
    a_b13, b_bt3, c_bt3 = polygons_bv3[:, :1], polygons_bv3[:, 1:-1], polygons_bv3[:, 2:]
    volume_bt = np.sum(a_b13 * np.cross(b_bt3, c_bt3), axis=2)
    scale_bt = 1.0 + np.sum(a_b13 * b_bt3 + b_bt3 * c_bt3 + a_b13 * c_bt3, axis=2)
    return np.sum(2.0 * np.arctan2(np.abs(volume_bt), scale_bt), axis=1)


def farthest_point_subset(directions_i3: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Choose `count` well-spread lights: first the one nearest to the mean, then always the farthest from all chosen.

    Parameters
    ----------
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors.
    count : int
        Number of lights to choose, 1 to n_light.

    Returns
    -------
    ndarray, shape (count,), intp
        Distinct indices in the order chosen, so that every prefix is a well-spread subset too; ties take the
        lowest index.

    Raises
    ------
    InputError
        Directions are no unit vectors, or `count` is not between 1 and n_light.
    """
    check_directions(directions_i3, None)
    if not 1 <= count <= len(directions_i3):
        raise InputError(f"can choose 1 to {len(directions_i3)} lights, got {count}")
    chosen = np.empty(count, dtype=np.intp)
    gap_i = np.full(len(directions_i3), np.inf)
    chosen[0] = np.argmax(directions_i3 @ directions_i3.mean(axis=0))
    for step in range(1, count):
        last_3 = directions_i3[chosen[step - 1]]
        gap_i = np.minimum(gap_i, np.sum((directions_i3 - last_3) ** 2, axis=1))
        gap_i[chosen[step - 1]] = -1.0
        chosen[step] = np.argmax(gap_i)
    return chosen
