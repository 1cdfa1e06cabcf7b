"""Light that was sampled at a few places, blended for each vertex (spherical-harmonic-lighting, local lights)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.errors import InputError
from clrelight.lighting.lamps import BLEND_POWER, distance_weights
from clrelight.lighting.light import Light
from clrelight.transfer.lit_functions import Functions
from clrelight.transfer.sources import DistantLight, add_light

BLENDS = ("power", "polyhedron")
"""Shares by a power of the distance, or barycentric in the nearest face of the polyhedron of the samples."""

_ON_FACE = 1e-9
_AT_ONCE = 1 << 14


@dataclass(frozen=True)
class LocalLights:
    """Samples of the light at places; each vertex gets their blend, and at a sample's own place that sample.

    Attributes
    ----------
    lights : sequence of Light
    positions_i3 : array_like, shape (n_sample, 3)
        Where they were sampled, all different, in units of the surface's positions.
    blend : str
        One of `BLENDS`.
    power : float
        Of the distance; large ones approach the nearest sample.
    """

    lights: Sequence[Light]
    positions_i3: ArrayLike
    blend: str = "power"
    power: float = BLEND_POWER
    faces_f3: NDArray[np.int32] | None = field(default=None, repr=False)
    is_distant = False

    def __post_init__(self) -> None:
        positions_i3 = np.asarray(self.positions_i3, np.float64)
        if not self.lights or positions_i3.shape != (len(self.lights), 3) or not np.isfinite(positions_i3).all():
            raise InputError("local light needs one or more lights, with one position of three finite numbers each")
        if len(np.unique(positions_i3, axis=0)) < len(self.lights):
            raise InputError("two samples of the local light have the same position")
        if self.blend not in BLENDS:
            raise InputError(f"a blend must be one of {', '.join(BLENDS)}, got {self.blend!r}")
        if not 0.0 < self.power < np.inf:
            raise InputError(f"the power of a blend must be a finite number above 0, got {self.power:g}")
        object.__setattr__(self, "positions_i3", positions_i3)
        if self.blend == "polyhedron":
            object.__setattr__(self, "faces_f3", light_polyhedron(positions_i3))

    def weights(self, points_n3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the share of each sample at points, (n_point, n_sample) float64."""
        positions_i3 = np.asarray(self.positions_i3)
        if self.faces_f3 is None:
            return distance_weights(positions_i3, points_n3, self.power)
        starts = range(0, len(points_n3), _AT_ONCE)
        parts = [polyhedron_weights(positions_i3, self.faces_f3, points_n3[at : at + _AT_ONCE]) for at in starts]
        return np.concatenate(parts)

    def shade(self, functions: Functions) -> NDArray[np.float64]:
        """See `Source`."""
        weights_ni = self.weights(functions.points_n3)
        total_nc = np.zeros((len(weights_ni), 1))
        for light, weight_n in zip(self.lights, weights_ni.T, strict=True):
            total_nc = add_light(total_nc, weight_n[:, None] * DistantLight(light).shade(functions))
        return total_nc


def light_polyhedron(positions_i3: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the triangles of the polyhedron whose corners are samples, (n_face, 3): their convex hull.

    Samples in a plane are triangulated there (Delaunay).

    Raises
    ------
    InputError
        If there are fewer than 3, they lie on a line, or one lies within the others' polyhedron.
    """
    from scipy.spatial import ConvexHull, Delaunay

    offset_i3 = positions_i3 - positions_i3.mean(axis=0)
    size = float(np.abs(offset_i3).max())
    values, axes = np.linalg.svd(offset_i3, full_matrices=False)[1:]
    rank = int(np.sum(values > 1e-9 * size))
    if len(positions_i3) < 3 or rank < 2:
        raise InputError("a light polyhedron needs 3 samples or more, not all on a line")
    faces_f3 = Delaunay(offset_i3 @ axes[:2].T).simplices if rank == 2 else ConvexHull(offset_i3).simplices
    inside = sorted(set(range(len(positions_i3))) - set(faces_f3.ravel().tolist()))
    if inside:
        place = ", ".join(f"{v:g}" for v in positions_i3[inside[0]])
        raise InputError(
            f"the sample at {place} lies within the polyhedron of the others: blend by power, or leave it out"
        )
    return faces_f3.astype(np.int32)


def polyhedron_weights(
    positions_i3: NDArray[np.float64], faces_f3: NDArray[np.int32], points_n3: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return barycentric shares of the nearest place on the nearest face, (n_point, n_sample), rows sum to 1."""
    best_n = np.full(len(points_n3), np.inf)
    weights_ni = np.zeros((len(points_n3), len(positions_i3)))
    size = float(np.ptp(positions_i3, axis=0).max())
    for face_3 in faces_f3:
        shares_n3 = nearest_on_triangle(positions_i3[face_3], points_n3)
        distance_n = np.linalg.norm(shares_n3 @ positions_i3[face_3] - points_n3, axis=1)
        nearer_n = distance_n < best_n - _ON_FACE * size
        best_n = np.where(nearer_n, distance_n, best_n)
        weights_ni[nearer_n] = 0.0
        weights_ni[np.ix_(nearer_n, face_3)] = shares_n3[nearer_n]
    return weights_ni


def nearest_on_triangle(corners_33: NDArray[np.float64], points_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return barycentric shares of the point of a triangle that is nearest to each point, (n, 3) float64."""
    first_3, edges_23 = corners_33[0], corners_33[1:] - corners_33[0]
    inner_n2 = np.linalg.solve(edges_23 @ edges_23.T, edges_23 @ (points_n3 - first_3).T).T
    shares_n3 = np.column_stack([1.0 - inner_n2.sum(axis=1), inner_n2])
    outside_n = (shares_n3 < 0.0).any(axis=1)
    best_n = np.where(outside_n, np.inf, -1.0)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        edge_3 = corners_33[b] - corners_33[a]
        along_n = np.clip((points_n3 - corners_33[a]) @ edge_3 / (edge_3 @ edge_3), 0.0, 1.0)
        distance_n = np.linalg.norm(corners_33[a] + along_n[:, None] * edge_3 - points_n3, axis=1)
        nearer_n = distance_n < best_n
        best_n = np.where(nearer_n, distance_n, best_n)
        shares_n3[nearer_n] = 0.0
        shares_n3[nearer_n, a], shares_n3[nearer_n, b] = 1.0 - along_n[nearer_n], along_n[nearer_n]
    return shares_n3
