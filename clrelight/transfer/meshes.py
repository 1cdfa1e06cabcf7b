"""Triangles as anybody may have made them, into a surface: what cannot be used is dropped, what is missing is made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, counted
from clrelight.surface import Surface

_FLAT = 1e-12
"""A face whose area is less than this share of its longest edge's square has none, beside the rounding of positions."""
_LARGEST, _SMALLEST = 1e30, 1e-30
"""Coordinates beyond, and surfaces below, have distances that the rays' float32 does not hold."""
_LEAST_NORMAL = 1e-6


def make_surface(
    vertices_v3: NDArray[np.float64],
    faces_f3: NDArray[np.integer],
    normals_v3: NDArray[np.float64] | None = None,
    *,
    texture_v2: NDArray[np.float64] | None = None,
    albedo_vc: NDArray[np.float32] | None = None,
    merge: bool = False,
    name: str = "surface",
    notes: tuple[str, ...] = (),
) -> Surface:
    """Return the surface of some triangles; its notes say what was dropped, made, or is odd.

    Parameters
    ----------
    vertices_v3 : ndarray, shape (n_vertex, 3), float64
    faces_f3 : ndarray, shape (n_face, 3), int
        Counterclockwise seen from outside.
    normals_v3 : ndarray, shape (n_vertex, 3), float64, optional
        Of any length; those that are not finite or have none are made, as all are without: sums of the faces' normals,
        weighted by their areas.
    texture_v2, albedo_vc : ndarray, optional
        As of `Surface`.
    merge : bool
        Make equal positions one vertex.
    name, notes
        As of `Surface`.

    Raises
    ------
    InputError
        If there is no face with an area, a face names a vertex that there is not, or a vertex of a face is not finite.
    """
    told, faces = list(notes), np.asarray(faces_f3)
    if not len(faces):
        raise InputError("it has no faces")
    if faces.min() < 0 or faces.max() >= len(vertices_v3):
        raise InputError(f"faces name vertices from {faces.min()} to {faces.max()}, there are {len(vertices_v3)}")
    _check_positions(vertices_v3, faces)
    held: dict[str, Any] = {"normals": normals_v3, "texture": texture_v2, "albedo": albedo_vc}
    if merge:
        first_m, same_v = merge_positions(vertices_v3)
        told.append(f"its {len(vertices_v3)} corners are at {len(first_m)} places, which became the vertices")
        vertices_v3, faces = vertices_v3[first_m], same_v[faces]
        held = dict.fromkeys(held)
    faces, area_normals_f3 = _drop_flat(vertices_v3, faces, told)
    vertices_v3, faces, held = _drop_unused(vertices_v3, faces, held, told)
    shape = _edges_of(faces, len(vertices_v3))
    same_v: NDArray[np.intp] | None = None  # type: ignore[no-redef]
    if shape.open:  # vertices that are double for the sake of their texture or normals are no hole
        same_v = merge_positions(vertices_v3)[1]
        shape = _edges_of(same_v[faces], len(vertices_v3))
    told.extend(shape.notes())
    if shape.is_closed and _volume(vertices_v3, faces) < 0:
        told.append("it is closed and inside out: its faces are clockwise seen from outside, so it is seen from within")
    texture_v2 = held["texture"]
    if texture_v2 is not None and not np.isfinite(texture_v2).all():
        told.append("its texture coordinates are not finite and are left out")
        texture_v2 = None
    seams = same_v if texture_v2 is not None else None
    normals_v3 = _normals_of(held["normals"], faces, area_normals_f3, len(vertices_v3), seams, told)
    return Surface(
        vertices_v3,
        faces.astype(np.int32),
        normals_v3,
        albedo_vc=held["albedo"],
        texture_v2=texture_v2,
        name=name,
        notes=tuple(told),
    )


def _check_positions(vertices_v3: NDArray[np.float64], faces: NDArray[np.integer]) -> None:
    with np.errstate(invalid="ignore"):
        sound_v = (np.abs(vertices_v3) <= _LARGEST).all(axis=1)
    used_v = np.zeros(len(vertices_v3), np.bool_)
    used_v[faces] = True
    bad_n = np.flatnonzero(used_v & ~sound_v)
    if bad_n.size:
        others = f" (and {bad_n.size - 1} more)" if bad_n.size > 1 else ""
        place = " ".join(f"{x:g}" for x in vertices_v3[bad_n[0]])
        raise InputError(f"vertex {bad_n[0]}{others} is at {place}, expected finite numbers up to {_LARGEST:g}")
    across = float(np.ptp(vertices_v3[used_v], axis=0).max())
    if 0.0 < across < _SMALLEST:
        raise InputError(f"it is {across:g} across, expected at least {_SMALLEST:g}: say it in a smaller unit")


def merge_positions(vertices_v3: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return one vertex of each position, in their order, and the number of each vertex's position."""
    order_v = np.lexsort(vertices_v3.T)
    sorted_v3 = vertices_v3[order_v]
    is_new_v = np.ones(len(order_v), np.bool_)
    is_new_v[1:] = (sorted_v3[1:] != sorted_v3[:-1]).any(axis=1)
    group_v = np.empty(len(order_v), np.intp)
    group_v[order_v] = np.cumsum(is_new_v) - 1
    first_g = np.full(int(is_new_v.sum()), len(order_v), np.intp)
    np.minimum.at(first_g, group_v, np.arange(len(order_v)))
    by_first_g = np.argsort(first_g)
    number_g = np.empty(len(first_g), np.intp)
    number_g[by_first_g] = np.arange(len(first_g))
    return first_g[by_first_g], number_g[group_v]


def area_normals(vertices_v3: NDArray[np.float64], faces_f3: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return outward normals of faces whose lengths are their areas, (n_face, 3)."""
    a_f3, b_f3, c_f3 = (vertices_v3[faces_f3[:, corner]] for corner in range(3))
    return 0.5 * np.cross(b_f3 - a_f3, c_f3 - a_f3)


def vertex_areas(surface: Surface) -> NDArray[np.float64]:
    """Return a third of the areas of the faces around each vertex, (n_vertex,)."""
    area_f = np.linalg.norm(area_normals(surface.vertices_v3, surface.faces_f3), axis=1) / 3.0
    return sum(np.bincount(surface.faces_f3[:, corner], area_f, surface.n_vertex) for corner in range(3))  # type: ignore


def _drop_flat(
    vertices_v3: NDArray[np.float64], faces: NDArray[np.integer], told: list[str]
) -> tuple[NDArray[np.integer], NDArray[np.float64]]:
    normals_f3 = area_normals(vertices_v3, faces)
    longest_f = np.zeros(len(faces))
    for one, other in ((0, 1), (1, 2), (2, 0)):
        edge_f3 = vertices_v3[faces[:, one]] - vertices_v3[faces[:, other]]
        longest_f = np.maximum(longest_f, np.einsum("fa,fa->f", edge_f3, edge_f3))
    with np.errstate(under="ignore"):
        has_area_f = np.linalg.norm(normals_f3, axis=1) > _FLAT * longest_f
    if has_area_f.all():
        return faces, normals_f3
    if not has_area_f.any():
        raise InputError(f"none of its {len(faces)} faces has an area")
    told.append(f"{counted(int(np.count_nonzero(~has_area_f)), 'face')} without area dropped")
    return faces[has_area_f], normals_f3[has_area_f]


def _drop_unused(
    vertices_v3: NDArray[np.float64], faces: NDArray[np.integer], held: dict[str, Any], told: list[str]
) -> tuple[NDArray[np.float64], NDArray[np.integer], dict[str, Any]]:
    used_v = np.zeros(len(vertices_v3), np.bool_)
    used_v[faces] = True
    if used_v.all():
        return vertices_v3, faces, held
    told.append(f"{np.count_nonzero(~used_v)} vertices of no face are dropped: the others are numbered anew")
    number_v = np.cumsum(used_v) - 1
    return vertices_v3[used_v], number_v[faces], {k: None if v is None else v[used_v] for k, v in held.items()}


@dataclass(frozen=True)
class _Edges:
    """Numbers of edges of one face, of more than two, and of two that are turned against each other."""

    open: int
    crowded: int
    against: int

    @property
    def is_closed(self) -> bool:
        return not (self.open or self.crowded or self.against)

    def notes(self) -> list[str]:
        found = []
        if self.open:
            found.append(f"it is open: {self.open} edges have one face, and its back may be seen")
        if self.crowded:
            found.append(f"it is no manifold: {self.crowded} edges have more than two faces")
        if self.against:
            found.append(f"{self.against} edges have two faces that are turned against each other")
        return found


def _edges_of(faces: NDArray[np.integer], n_vertex: int) -> _Edges:
    start_e = faces.astype(np.int64).ravel()
    end_e = np.roll(faces.astype(np.int64), -1, axis=1).ravel()
    key_e = np.minimum(start_e, end_e) * n_vertex + np.maximum(start_e, end_e)
    key_e = 2 * key_e + (start_e < end_e)
    key_e.sort()
    edge_e = key_e >> 1
    first_n = np.flatnonzero(np.append(True, edge_e[1:] != edge_e[:-1]))
    count_n = np.diff(np.append(first_n, len(edge_e)))
    two_n = first_n[count_n == 2]
    against = np.count_nonzero(key_e[two_n] == key_e[two_n + 1])
    return _Edges(int(np.count_nonzero(count_n == 1)), int(np.count_nonzero(count_n > 2)), int(against))


def _volume(vertices_v3: NDArray[np.float64], faces: NDArray[np.integer]) -> float:
    local_v3 = vertices_v3 - vertices_v3.mean(axis=0)  # far from 0, products would be rounded more than they differ
    a_f3, b_f3, c_f3 = (local_v3[faces[:, corner]] for corner in range(3))
    return float(np.einsum("fa,fa->", a_f3, np.cross(b_f3, c_f3))) / 6.0


def _normals_of(
    given_v3: NDArray[np.float64] | None,
    faces: NDArray[np.integer],
    area_normals_f3: NDArray[np.float64],
    n_vertex: int,
    same_v: NDArray[np.intp] | None,
    told: list[str],
) -> NDArray[np.float64]:
    """Return unit normals: those given where they are sound, others made; of vertices of one place the same."""
    length_v = np.zeros(n_vertex) if given_v3 is None else np.linalg.norm(given_v3, axis=1)
    sound_v = np.isfinite(length_v) & (length_v > _LEAST_NORMAL)
    if given_v3 is not None and sound_v.all():
        return given_v3 / length_v[:, None]
    corners = faces if same_v is None else same_v[faces]
    scaled_f3 = area_normals_f3 / np.abs(area_normals_f3).max()
    made_v3 = np.zeros((n_vertex, 3))
    for corner in range(3):
        for axis in range(3):
            made_v3[:, axis] += np.bincount(corners[:, corner], scaled_f3[:, axis], n_vertex)
    if same_v is not None:
        made_v3 = made_v3[same_v]
    made_length_v = np.linalg.norm(made_v3, axis=1)
    none_v = ~(made_length_v > 0)
    if none_v.any():  # faces back to back: that of one of them
        made_v3[faces.ravel()[::-1]] = np.where(
            none_v[faces.ravel()[::-1], None], np.repeat(scaled_f3, 3, axis=0)[::-1], made_v3[faces.ravel()[::-1]]
        )
        told.append(f"{np.count_nonzero(none_v)} vertices have faces back to back: the normal is that of one face")
        made_length_v = np.linalg.norm(made_v3, axis=1)
    made_v3 /= made_length_v[:, None]
    if given_v3 is None:
        told.append("it has no normals: they are made from its faces")
        return made_v3
    told.append(f"{np.count_nonzero(~sound_v)} normals are missing, and are made from the faces")
    return np.where(sound_v[:, None], given_v3 / np.where(sound_v, length_v, 1.0)[:, None], made_v3)
