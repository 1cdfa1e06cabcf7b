"""Where functions of a mesh are made: each place with each of its normals once (spherical-harmonic-lighting)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.errors import InputError
from clrelight.surface import Surface

CREASE = 30.0
"""Faces that meet at a larger angle, in degrees, have normals of their own where they meet."""

_SAME = 1e-6


def lighting_points(
    vertices_v3: ArrayLike, faces_f3: ArrayLike, *, crease: float = CREASE, name: str = "surface"
) -> Surface:
    """Return a surface whose vertices are the unique pairs of place and normal of a mesh.

    Vertices at one place are one, and a vertex at a sharp edge is as many as it has normals there: a cube of 8 corners
    has 24. The normal of a face's corner is the mean of those of the faces around the place that lie within `crease` of
    the face, weighted by their angles at it.

    Parameters
    ----------
    vertices_v3 : array_like, shape (n_vertex, 3)
    faces_f3 : array_like, shape (n_face, 3), int
    crease : float
        Degrees, 0 to 180.
    name : str
    """
    vertices_v3, faces_f3 = np.asarray(vertices_v3, np.float64), np.asarray(faces_f3)
    if not 0.0 <= crease <= 180.0:
        raise InputError(f"a crease is 0 to 180 degrees, got {crease:g}")
    if vertices_v3.ndim != 2 or vertices_v3.shape[1] != 3 or not np.isfinite(vertices_v3).all():
        raise InputError(f"vertices must be finite, of shape (vertex, 3), got {vertices_v3.shape}")
    if faces_f3.ndim != 2 or faces_f3.shape[1] != 3 or not len(faces_f3) or faces_f3.dtype.kind not in "iu":
        raise InputError(f"faces must be integers of shape (face, 3), got {faces_f3.dtype} {faces_f3.shape}")
    if faces_f3.min() < 0 or faces_f3.max() >= len(vertices_v3):
        raise InputError(f"faces name vertices from {faces_f3.min()} to {faces_f3.max()}, there are {len(vertices_v3)}")
    size = float(np.ptp(vertices_v3, axis=0).max()) or 1.0
    places, place_v = np.unique(np.rint(vertices_v3 / (_SAME * size)).astype(np.int64), axis=0, return_inverse=True)
    corners_fj = place_v.reshape(-1)[faces_f3]
    positions_p3 = np.zeros((len(places), 3))
    positions_p3[place_v.reshape(-1)] = vertices_v3
    normals_f3, angles_fj = _faces(positions_p3[corners_fj])
    normals_m3 = _corner_normals(corners_fj, normals_f3, angles_fj, np.cos(np.radians(crease)))
    pairs = np.column_stack([corners_fj.ravel(), np.rint(normals_m3 / (10.0 * _SAME)).astype(np.int64)])
    _, first_q, point_m = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    kept_f = (normals_f3 != 0.0).any(axis=1)
    if not kept_f.any():
        raise InputError("all faces of the mesh have no area")
    return Surface(
        positions_p3[corners_fj.ravel()[first_q]],
        point_m.reshape(-1, 3)[kept_f].astype(np.int32),
        normals_m3[first_q],
        name=name,
    )


def _faces(corners_fj3: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return unit normals of triangles (0 for those of no area), and their angles at each corner."""
    cross_f3 = np.cross(corners_fj3[:, 1] - corners_fj3[:, 0], corners_fj3[:, 2] - corners_fj3[:, 0])
    length_f1 = np.linalg.norm(cross_f3, axis=1, keepdims=True)
    normals_f3 = np.where(length_f1 > 0.0, cross_f3 / np.where(length_f1 > 0.0, length_f1, 1.0), 0.0)
    ahead_fj3, back_fj3 = (np.roll(corners_fj3, step, axis=1) - corners_fj3 for step in (-1, 1))
    cosine_fj = np.einsum("fja,fja->fj", ahead_fj3, back_fj3)
    return normals_f3, np.arctan2(length_f1, cosine_fj)


def _corner_normals(
    corners_fj: NDArray[np.intp], normals_f3: NDArray[np.float64], angles_fj: NDArray[np.float64], least: float
) -> NDArray[np.float64]:
    """Return the unit normal of each corner of each face, row by row, (3 n_face, 3)."""
    from scipy.sparse import csr_matrix

    n_corner = corners_fj.size
    face_m = np.repeat(np.arange(len(corners_fj)), 3)
    # Corners at one place, in pairs: a sparse matrix of corners times its transpose.
    at = csr_matrix((np.ones(n_corner, bool), (np.arange(n_corner), corners_fj.ravel())))
    own_e, other_e = (at @ at.T).nonzero()
    alike_e = np.einsum("ea,ea->e", normals_f3[face_m[own_e]], normals_f3[face_m[other_e]]) >= least - 1e-12
    own_e, other_e = own_e[alike_e], other_e[alike_e]
    total_m3 = np.zeros((n_corner, 3))
    np.add.at(total_m3, own_e, angles_fj.ravel()[other_e, None] * normals_f3[face_m[other_e]])
    length_m1 = np.linalg.norm(total_m3, axis=1, keepdims=True)
    up_3 = np.array([0.0, 0.0, 1.0])
    return np.where(length_m1 > 1e-12, total_m3 / np.where(length_m1 > 1e-12, length_m1, 1.0), up_3)
