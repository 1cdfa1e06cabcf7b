"""Texels of a mesh's texture as points on it: a surface that is a grid."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.surface import Surface
from clrelight.transfer.meshes import area_normals

MOST_SIDE = 1 << 14
_CANDIDATES = 1 << 20
_ROUNDING = 1e-9


@dataclass(frozen=True)
class _Covered:
    """The face at the middle of each texel, -1 where there is none, and where in it."""

    face_t: NDArray[np.int64]
    weights_t3: NDArray[np.float64]


def texel_surface(surface: Surface, rows: int, columns: int) -> Surface:
    """Return the points of a surface that are at the middles of a texture's texels, as a grid.

    Row 0 is at v = 1, column 0 at u = 0. Where the texture has nothing, texels have the point of the nearest that has
    something, so that they can be filtered and coded; no face is there, nor between charts.

    Raises
    ------
    InputError
        If the surface has no texture coordinates, the grid is too large, or too coarse for any face of it.
    """
    if surface.texture_v2 is None:
        raise InputError(f"{surface.name} has no texture coordinates, so it has no texels")
    if not (2 <= rows <= MOST_SIDE and 2 <= columns <= MOST_SIDE):
        raise InputError(f"texels must be 2 to {MOST_SIDE} rows and columns, got {rows} and {columns}")
    covered = _rasterize(surface.texture_v2, surface.faces_f3, rows, columns)
    own_t = covered.face_t >= 0
    if not own_t.any():
        raise InputError(f"no texel of {rows} × {columns} lies in its texture: its coordinates must be within 0 and 1")
    faces_n3 = _cells(surface, covered, rows, columns)
    nearest_t = _nearest(own_t.reshape(rows, columns))
    corners_t3 = surface.faces_f3[covered.face_t[nearest_t]]
    weights_t3 = covered.weights_t3[nearest_t]

    def blend(values_vx: NDArray) -> NDArray[np.float64]:
        return np.einsum("tc,tcx->tx", weights_t3, values_vx[corners_t3].astype(np.float64))

    normals_t3 = blend(surface.normals_v3)
    length_t = np.linalg.norm(normals_t3, axis=1, keepdims=True)
    normals_t3 = np.where(length_t > _ROUNDING, normals_t3, surface.normals_v3[corners_t3[:, 0]])
    normals_t3 /= np.linalg.norm(normals_t3, axis=1, keepdims=True)
    points_t3 = blend(surface.vertices_v3)
    y_t, x_t = np.indices((rows, columns)).reshape(2, -1)
    note = f"{np.count_nonzero(~own_t)} of {own_t.size} texels are in no chart, and hold what the nearest holds"
    return Surface(
        points_t3,
        _turned_outward(points_t3, normals_t3, faces_n3),
        normals_t3,
        albedo_vc=None if surface.albedo_vc is None else np.clip(blend(surface.albedo_vc), 0, 1).astype(np.float32),
        texture_v2=np.stack([(x_t + 0.5) / columns, 1.0 - (y_t + 0.5) / rows], axis=1),
        grid=(rows, columns),
        argument=surface.argument,
        name=surface.name,
        notes=() if own_t.all() else (note,),
    )


def _rasterize(texture_v2: NDArray[np.float64], faces_f3: NDArray[np.int32], rows: int, columns: int) -> _Covered:
    x_f3 = texture_v2[:, 0][faces_f3] * columns - 0.5
    y_f3 = (1.0 - texture_v2[:, 1][faces_f3]) * rows - 0.5
    left_f, right_f = _span(x_f3, columns)
    top_f, bottom_f = _span(y_f3, rows)
    count_f = np.maximum(right_f - left_f, 0) * np.maximum(bottom_f - top_f, 0)
    found = _Covered(np.full(rows * columns, -1, np.int64), np.zeros((rows * columns, 3)))
    for faces_n in _batches(count_f):
        counts_n = count_f[faces_n]
        face_m = np.repeat(faces_n, counts_n)
        local_m = np.arange(len(face_m)) - np.repeat(np.cumsum(counts_n) - counts_n, counts_n)
        width_m = (right_f - left_f)[face_m]
        px_m, py_m = left_f[face_m] + local_m % width_m, top_f[face_m] + local_m // width_m
        weights_m3 = _barycentric(x_f3[face_m], y_f3[face_m], px_m, py_m)
        inside_m = np.isfinite(weights_m3).all(axis=1) & (weights_m3 >= -_ROUNDING).all(axis=1)
        texel_m = (py_m * columns + px_m)[inside_m]
        found.face_t[texel_m] = face_m[inside_m]
        found.weights_t3[texel_m] = np.clip(weights_m3[inside_m], 0.0, 1.0)
    found.weights_t3[:] /= np.maximum(found.weights_t3.sum(axis=1, keepdims=True), _ROUNDING)
    return found


def _span(x_f3: NDArray[np.float64], size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first texel and the one behind the last that faces may cover along an axis."""
    low_f, high_f = np.clip(x_f3.min(axis=1), -1, size), np.clip(x_f3.max(axis=1), -1, size)
    first_f = np.maximum(np.ceil(low_f - _ROUNDING), 0).astype(np.int64)
    return first_f, np.minimum(np.floor(high_f + _ROUNDING), size - 1).astype(np.int64) + 1


def _batches(count_f: NDArray[np.int64]) -> Iterator[NDArray[np.intp]]:
    faces_n = np.flatnonzero(count_f)
    batch_n = np.cumsum(count_f[faces_n]) // _CANDIDATES
    for batch in np.unique(batch_n):
        yield faces_n[batch_n == batch]


def _barycentric(
    x_m3: NDArray[np.float64], y_m3: NDArray[np.float64], px_m: NDArray[np.int64], py_m: NDArray[np.int64]
) -> NDArray[np.float64]:
    dx_m3, dy_m3 = x_m3 - px_m[:, None], y_m3 - py_m[:, None]
    area_m3 = np.roll(dx_m3, -1, axis=1) * np.roll(dy_m3, -2, axis=1)
    area_m3 -= np.roll(dx_m3, -2, axis=1) * np.roll(dy_m3, -1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return area_m3 / area_m3.sum(axis=1, keepdims=True)


def _nearest(own_hw: NDArray[np.bool_]) -> NDArray[np.intp]:
    from scipy.ndimage import distance_transform_edt  # slow to load

    row_hw, column_hw = distance_transform_edt(~own_hw, return_distances=False, return_indices=True)
    return (row_hw * own_hw.shape[1] + column_hw).ravel()


def _cells(surface: Surface, covered: _Covered, rows: int, columns: int) -> NDArray[np.int64]:
    """Return two triangles of each cell whose four texels are of one chart."""
    faces_f3, count = surface.faces_f3, surface.n_vertex
    ends = np.concatenate([faces_f3[:, :2], faces_f3[:, 1:]]).T
    links = scipy.sparse.coo_array((np.ones(ends.shape[1], np.int8), (ends[0], ends[1])), shape=(count, count))
    chart_v = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
    chart_t = np.where(covered.face_t >= 0, chart_v[faces_f3[covered.face_t, 0]], -1).reshape(rows, columns)
    a_hw, b_hw, c_hw, d_hw = chart_t[:-1, :-1], chart_t[:-1, 1:], chart_t[1:, :-1], chart_t[1:, 1:]
    whole_hw = (a_hw >= 0) & (a_hw == b_hw) & (a_hw == c_hw) & (a_hw == d_hw)
    y_n, x_n = np.nonzero(whole_hw)
    if not len(y_n):
        raise InputError(f"texels of {rows} × {columns} are too coarse for its texture: no four are of one chart")
    at_n = y_n * columns + x_n
    return np.concatenate(
        [
            np.stack([at_n, at_n + columns, at_n + 1], axis=1),
            np.stack([at_n + 1, at_n + columns, at_n + columns + 1], axis=1),
        ]
    )


def _turned_outward(
    points_t3: NDArray[np.float64], normals_t3: NDArray[np.float64], faces_n3: NDArray[np.int64]
) -> NDArray[np.int32]:
    across_n3 = area_normals(points_t3, faces_n3)
    against_n = np.einsum("na,na->n", across_n3, normals_t3[faces_n3[:, 0]]) < 0
    faces_n3[against_n] = faces_n3[against_n][:, ::-1]
    return faces_n3.astype(np.int32)
