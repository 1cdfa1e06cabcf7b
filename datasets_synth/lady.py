"""The sculpture of the "dama" scene: a lady with a bun and a pleated shawl, as a parameter grid."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.surface import Surface
from datasets_synth.grids import grid_triangles
from datasets_synth.implicit import Solid, blend, ellipsoid, gradients, last_crossing, limb

FOOT, CROWN = 0.10, 1.62
"""Heights along the sculpture's bent axis between which rays leave it level; beyond, they fan out to the poles."""

BASE = -0.08
"""Height of the plane that she stands on."""

_REACH = 1.3
# Shares of the rows: the fan about the foot, the trunk, and the fan about the crown.
_FAN_BELOW, _FAN_ABOVE = 0.14, 0.16
_PLEATS, _PLEAT_DEPTH = 13, 0.022


def lady_surface(rows: int, columns: int) -> Surface:
    """Return the sculpture: z up, about 2 high, her face towards -y.

    Rays leave a bent axis inside her, level along the trunk and fanned out at both ends; a vertex is where its ray
    leaves the solid for good. Rows go from the foot to the crown, columns around the axis and wrap. Normals are those
    of the implicit surface; tangents lie along growing columns.

    Parameters
    ----------
    rows, columns : int
        At least 8 of each.
    """
    if min(rows, columns) < 8:
        raise InputError(f"the sculpture needs at least 8 rows and 8 columns, got {rows} and {columns}")
    height_r, tilt_r = _axis_rows((np.arange(rows) + 0.5) / rows)
    azimuth_c = np.arange(columns) * (2.0 * math.pi / columns)
    level = np.stack([np.cos(azimuth_c), np.sin(azimuth_c), np.zeros(columns)], axis=1)
    rays = np.cos(tilt_r)[:, None, None] * level + np.sin(tilt_r)[:, None, None] * np.array([0.0, 0.0, 1.0])
    origins = np.broadcast_to(_axis(height_r)[:, None, :], rays.shape)
    solid, rays_n3, origins_n3 = lady_solid(), rays.reshape(-1, 3), origins.reshape(-1, 3)
    length_n = last_crossing(solid, origins_n3, rays_n3, _REACH)
    vertices_n3 = origins_n3 + length_n[:, None] * rays_n3
    normals_n3 = gradients(solid, vertices_n3)
    around = vertices_n3.reshape(rows, columns, 3)
    along_n3 = (np.roll(around, -1, axis=1) - np.roll(around, 1, axis=1)).reshape(-1, 3)
    tangents_n3 = along_n3 - np.sum(along_n3 * normals_n3, axis=1, keepdims=True) * normals_n3
    tangents_n3 /= np.linalg.norm(tangents_n3, axis=1, keepdims=True)
    faces_f3 = grid_triangles(rows, columns, rows_wrap=False)
    return Surface(vertices_n3, faces_f3, normals_n3, tangents_n3, grid=(rows, columns), name="dama")


@functools.cache
def lady_solid() -> Solid:
    """Return the sculpture's implicit function."""
    head = ellipsoid((0.0, -0.06, 1.56), (0.205, 0.245, 0.285), _lean(0.16))
    face = ellipsoid((0.0, -0.20, 1.46), (0.125, 0.115, 0.185), _lean(0.10))
    nose = limb((0.0, -0.285, 1.555), (0.0, -0.345, 1.465), 0.018, 0.036)
    brow = limb((-0.09, -0.262, 1.60), (0.09, -0.262, 1.60), 0.030, 0.030)
    chin = ellipsoid((0.0, -0.265, 1.325), (0.052, 0.050, 0.045))
    lips = limb((-0.038, -0.303, 1.395), (0.038, -0.303, 1.395), 0.017, 0.017)
    hair = ellipsoid((0.0, 0.015, 1.63), (0.238, 0.265, 0.265), _lean(0.25))
    bun = ellipsoid((0.0, 0.285, 1.735), (0.135, 0.125, 0.130))
    neck = limb((0.0, 0.03, 0.95), (0.0, -0.02, 1.40), 0.118, 0.102)
    chest = ellipsoid((0.0, 0.0, 0.62), (0.43, 0.255, 0.46))
    shoulders = limb((-0.39, 0.02, 0.86), (0.39, 0.02, 0.86), 0.125, 0.125)
    arms = [limb((side * 0.46, 0.02, 0.82), (side * 0.43, -0.16, 0.36), 0.105, 0.090) for side in (-1.0, 1.0)]
    fore = [limb((side * 0.43, -0.16, 0.36), (side * 0.06, -0.37, 0.40), 0.085, 0.062) for side in (-1.0, 1.0)]
    skirt = limb((0.0, 0.02, 0.02), (0.0, 0.0, 0.46), 0.47, 0.37)
    skull = functools.reduce(lambda a, b: blend(a, b, 0.05), (face, brow, nose, lips, chin), head)
    top = blend(blend(skull, _waved(hair), 0.02), bun, 0.03)
    trunk = blend(blend(chest, shoulders, 0.14), skirt, 0.10)
    limbs = functools.reduce(lambda a, b: blend(a, b, 0.05), (*arms, *fore))
    dressed = blend(_pleated(trunk), limbs, 0.05)
    whole = blend(blend(dressed, neck, 0.09), top, 0.03)
    return lambda points_n3: np.maximum(whole(points_n3), BASE - points_n3[:, 2])


def _pleated(solid: Solid) -> Solid:
    """Return a solid with folds that run down it, askew, deepest at the foot."""

    def value(points_n3: NDArray[np.float64]) -> NDArray[np.float64]:
        x_n, y_n, z_n = points_n3.T
        phase_n = _PLEATS * np.arctan2(y_n, x_n) + 5.0 * z_n + 1.2 * np.sin(3.0 * z_n + 2.0 * x_n)
        depth_n = _PLEAT_DEPTH * np.clip((1.0 - z_n) / 0.7, 0.0, 1.6)
        return solid(points_n3) - depth_n * np.sin(phase_n)

    return value


def _waved(solid: Solid) -> Solid:
    """Return a solid with the strands of combed hair."""

    def value(points_n3: NDArray[np.float64]) -> NDArray[np.float64]:
        x_n, y_n, z_n = points_n3.T
        strand_n = np.sin(46.0 * x_n + 5.0 * np.sin(7.0 * (y_n + z_n)))
        return solid(points_n3) - 0.006 * strand_n

    return value


def _lean(angle: float) -> NDArray[np.float64]:
    """Return axes that nod forward, as rows."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _axis_rows(t_r: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return each row's height on the axis and the elevation of its rays, from the foot to the crown."""
    height_r = FOOT + (CROWN - FOOT) * np.clip((t_r - _FAN_BELOW) / (1.0 - _FAN_BELOW - _FAN_ABOVE), 0.0, 1.0)
    below_r = np.clip(1.0 - t_r / _FAN_BELOW, 0.0, 1.0)
    above_r = np.clip((t_r - 1.0 + _FAN_ABOVE) / _FAN_ABOVE, 0.0, 1.0)
    return height_r, (above_r - below_r) * (math.pi / 2.0)


def _axis(height_r: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points of the axis at these heights: upright in the trunk, and forward in the head."""
    forward_r = -0.07 * np.clip((height_r - 0.95) / 0.55, 0.0, 1.0) ** 2
    return np.stack([np.zeros_like(height_r), forward_r, height_r], axis=1)
