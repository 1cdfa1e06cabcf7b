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
    """A surface that is ready for rays."""

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
        self._run(
            np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32), query="OCCLUDED"
        )  # the tree is built now
        self.starts_v3 = self._local(surface.vertices_v3 + OFFSET * surface.diagonal * surface.normals_v3)

    def occluded(self, vertices_r: NDArray[np.intp], directions_r3: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether rays from just outside these vertices meet the surface; directions are unit vectors."""
        starts_r3 = self.starts_v3[vertices_r]
        return self._run(starts_r3, directions_r3, query="OCCLUDED") == 0

    def hit(self, vertices_r: NDArray[np.intp], directions_r3: NDArray[np.float32]) -> Hits:
        """Return what rays from just outside these vertices meet first."""
        return self._hits(self.starts_v3[vertices_r], directions_r3)

    def hit_from(self, origins_r3: NDArray[np.float64], directions_r3: NDArray[np.float32]) -> Hits:
        """Return what rays from anywhere meet first; origins in units of the positions."""
        return self._hits(self._local(origins_r3), directions_r3)

    def _hits(self, starts_r3: NDArray[np.float32], directions_r3: NDArray[np.float32]) -> Hits:
        found = self._run(starts_r3, directions_r3, output=1)
        u_r, v_r = found["u"], found["v"]
        weights_r3 = np.stack([1.0 - u_r - v_r, u_r, v_r], axis=1)
        behind_r = np.einsum("ra,ra->r", found["Ng"], directions_r3) > 0.0
        return Hits(found["primID"], weights_r3, found["tfar"] / np.float32(self._scale), behind_r)

    def _run(self, starts_r3: NDArray[np.float32], directions_r3: NDArray[np.float32], **how: Any) -> Any:
        return self._scene.run(np.ascontiguousarray(starts_r3), np.ascontiguousarray(directions_r3, np.float32), **how)

    def _local(self, points_v3: NDArray[np.float64]) -> NDArray[np.float32]:
        return ((points_v3 - self._middle_3) * self._scale).astype(np.float32)
