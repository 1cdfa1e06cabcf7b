"""Tori: their triangles for ray tracing and their exact surface for shading."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Torus:
    """A circle of radius `major` around `axis`, thickened to the radius `minor`; lengths in scene units."""

    centre: tuple[float, float, float]
    axis: tuple[float, float, float]
    major: float
    minor: float

    def frame(self) -> NDArray[np.float64]:
        """Return the orthonormal rows (u, v, axis) of the torus's own frame, shape (3, 3)."""
        return axes_about(np.array(self.axis) / math.hypot(*self.axis))


def axes_about(direction_3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return orthonormal rows, shape (3, 3), whose last is the direction, a unit vector."""
    across = np.cross(direction_3, np.eye(3)[np.argmin(np.abs(direction_3))])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(direction_3, across), direction_3])


def torus_on_ground(
    xy: tuple[float, float], axis: tuple[float, float, float], major: float, minor: float, sink: float = 0.0
) -> Torus:
    """Return a torus above or below (x, y) whose lowest point is `sink` under the ground z = 0."""
    tilt = math.hypot(axis[0], axis[1]) / math.hypot(*axis)
    return Torus((*xy, major * tilt + minor - sink), axis, major, minor)


def torus_triangles(torus: Torus, n_major: int, n_minor: int) -> NDArray[np.float32]:
    """Return the triangles of a torus, shape (2 * n_major * n_minor, 3 corners, 3), outward by the right hand."""
    around, across = np.meshgrid(
        np.arange(n_major + 1) * (2.0 * math.pi / n_major),
        np.arange(n_minor + 1) * (2.0 * math.pi / n_minor),
        indexing="ij",
    )
    # Indices, not angles, close the seams.
    around[-1], across[:, -1] = around[0], across[:, 0]
    radius = torus.major + torus.minor * np.cos(across)
    local = np.stack([radius * np.cos(around), radius * np.sin(around), torus.minor * np.sin(across)], axis=-1)
    p = local @ torus.frame() + np.array(torus.centre)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3, 3).astype(np.float32)


def snap_to_torus(torus: Torus, points_s3: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the points of the exact torus nearest to `points_s3`, and the outward unit normals there."""
    local_s3 = (points_s3 - np.array(torus.centre)) @ torus.frame().T
    ring_s2 = local_s3[:, :2] / np.linalg.norm(local_s3[:, :2], axis=1, keepdims=True)
    core_s3 = np.concatenate([torus.major * ring_s2, np.zeros((len(local_s3), 1))], axis=1)
    normal_s3 = local_s3 - core_s3
    normal_s3 /= np.linalg.norm(normal_s3, axis=1, keepdims=True)
    frame = torus.frame()
    return (core_s3 + torus.minor * normal_s3) @ frame + np.array(torus.centre), normal_s3 @ frame
