"""Rays against a mesh, by Embree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.surface import Surface

OFFSET = 1e-5
"""Rays start this much of the diagonal outside the surface: clear of the faces that meet there."""

_NONE = 0.1 * OFFSET
"""A ray that goes less far, in units of the diagonal, has started in the face that it meets."""
_FEELERS = np.concatenate([np.eye(3), -np.eye(3), 3**-0.5 * (2.0 * np.indices((2, 2, 2)).reshape(3, 8).T - 1.0)])
"""Directions, spread over the sphere, in which a start is tried."""
_TILT = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
"""A turn of them, which takes none into the axes' planes."""
_ROUNDS = 3
_AT_ONCE = 1 << 14


@dataclass(frozen=True)
class Hits:
    """The nearest faces that rays meet.

    Attributes
    ----------
    face_r : ndarray, shape (n_ray,), int32
        -1 where there is none.
    weights_r3 : ndarray, shape (n_ray, 3), float32
        Barycentric weights of the face's three vertices.
    distance_r : ndarray, shape (n_ray,), float32
        In units of the positions.
    from_behind_r : ndarray, shape (n_ray,), bool
        Whether the ray meets the inner side.
    """

    face_r: NDArray[np.int32]
    weights_r3: NDArray[np.float32]
    distance_r: NDArray[np.float32]
    from_behind_r: NDArray[np.bool_]


class RayScene:
    """A surface that is ready for rays.

    Attributes
    ----------
    surface : Surface
    starts_v3 : ndarray, shape (n_vertex, 3), float32
        Where the rays of its vertices start, as `trace` and `blocked` take it.
    """

    def __init__(self, surface: Surface) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError:
            raise InputError("shadows need ray tracing: pip install 'clrelight[surfaces]'") from None
        self.surface = surface
        # Moved to the middle and scaled: Embree's numbers are float32, and far from 0 a hair is many of its steps.
        low_3, high_3 = surface.vertices_v3.min(axis=0), surface.vertices_v3.max(axis=0)
        self._middle_3 = 0.5 * (low_3 + high_3)
        self._scale = 1.0 / (surface.diagonal or 1.0)
        self._scene: Any = EmbreeScene()
        TriangleMesh(self._scene, self._local(surface.vertices_v3), surface.faces_f3)
        # The tree is built now.
        self._run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32), query="OCCLUDED")
        self.starts_v3 = self.starts_of(surface.vertices_v3, surface.normals_v3)

    def starts_of(self, points_n3: NDArray[np.float64], normals_n3: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return where rays start that leave the surface at some points of it, as `trace` and `blocked` take it.

        Just outside along the normal. A point at the foot of a wall that shares no vertex with it lies in the wall
        wherever along its own normal it starts: there some rays end at once, and the start is moved off that wall too.
        """
        starts_n3 = self._local(points_n3) + (OFFSET * normals_n3).astype(np.float32)
        for first in range(0, len(starts_n3), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            self._leave_walls(starts_n3[part], normals_n3[part])
        return starts_n3

    def _leave_walls(self, starts_n3: NDArray[np.float32], normals_n3: NDArray[np.float64]) -> None:
        feelers_j3 = (_FEELERS @ _TILT.T).astype(np.float32)
        tried_n = np.arange(len(starts_n3))
        for _ in range(_ROUNDS):
            at_r, feeler_r = np.nonzero(normals_n3[tried_n] @ feelers_j3.T > 0.0)
            found = self._run(starts_n3[tried_n[at_r]], feelers_j3[feeler_r], output=1)
            caught_m = np.flatnonzero((found["primID"] >= 0) & (found["tfar"] < _NONE))
            if not caught_m.size:
                return
            vertex_m, first_m = np.unique(tried_n[at_r[caught_m]], return_index=True)
            wall_m3 = found["Ng"][caught_m[first_m]]
            wall_m3 = wall_m3 / np.linalg.norm(wall_m3, axis=1, keepdims=True)
            starts_n3[vertex_m] += np.float32(OFFSET) * wall_m3
            tried_n = vertex_m

    def blocked(self, starts_r3: NDArray[np.float32], directions_r3: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether rays from such starts meet the surface; directions are unit vectors."""
        return self._run(starts_r3, directions_r3, query="OCCLUDED") == 0

    def trace(self, starts_r3: NDArray[np.float32], directions_r3: NDArray[np.float32]) -> Hits:
        """Return what rays from such starts meet first."""
        found = self._run(starts_r3, directions_r3, output=1)
        u_r, v_r = found["u"], found["v"]
        weights_r3 = np.stack([1.0 - u_r - v_r, u_r, v_r], axis=1)
        behind_r = np.einsum("ra,ra->r", found["Ng"], directions_r3) > 0.0
        with np.errstate(over="ignore"):  # what meets nothing is infinitely far
            distance_r = found["tfar"] / np.float32(self._scale)
        return Hits(found["primID"], weights_r3, distance_r, behind_r)

    def occluded(self, vertices_r: NDArray[np.intp], directions_r3: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether rays from just outside these vertices meet the surface; directions are unit vectors."""
        return self.blocked(self.starts_v3[vertices_r], directions_r3)

    def hit(self, vertices_r: NDArray[np.intp], directions_r3: NDArray[np.float32]) -> Hits:
        """Return what rays from just outside these vertices meet first."""
        return self.trace(self.starts_v3[vertices_r], directions_r3)

    def hit_from(self, origins_r3: NDArray[np.float64], directions_r3: NDArray[np.float32]) -> Hits:
        """Return what rays from anywhere meet first; origins in units of the positions."""
        return self.trace(self._local(origins_r3), directions_r3)

    def _run(self, starts_r3: NDArray[np.float32], directions_r3: NDArray[np.float32], **how: Any) -> Any:
        return self._scene.run(np.ascontiguousarray(starts_r3), np.ascontiguousarray(directions_r3, np.float32), **how)

    def _local(self, points_v3: NDArray[np.float64]) -> NDArray[np.float32]:
        return ((points_v3 - self._middle_3) * self._scale).astype(np.float32)
