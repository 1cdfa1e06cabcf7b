"""The record of a surface whose vertices carry spherical functions: `Surface`, checked once when made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import as_float64
from clrelight.directions import are_unit
from clrelight.errors import InputError

ARGUMENTS = "light", "view"
"""What the direction is that a vertex's function takes."""

_MOST_VERTICES = 1 << 31
_ROUNDING = 1e-4


@dataclass(frozen=True)
class Surface:
    """A triangle mesh; a map of its functions is (coefficient, vertex, 1, channel), or its grid's rows and columns.

    Attributes
    ----------
    vertices_v3 : array_like, shape (n_vertex, 3), float64
        Positions in the mesh's own unit, z up.
    faces_f3 : array_like, shape (n_face, 3), int32
        Vertices of each triangle, counterclockwise seen from outside.
    normals_v3 : array_like, shape (n_vertex, 3), float64
        Outward unit normals.
    tangents_v3 : array_like, shape (n_vertex, 3), float64, optional
        Unit vectors orthogonal to the normals. Where given, directions of the functions are in each vertex's own
        frame: x the tangent, y = normal x tangent, z the normal. None: in the axes of the positions.
    albedo_vc : array_like, shape (n_vertex, 1 or 3), float32, optional
        Diffuse reflectance from 0 to 1; None: 1.
    texture_v2 : array_like, shape (n_vertex, 2), float64, optional
        Texture coordinates.
    grid : tuple of int, optional
        Rows and columns where the vertices are a parameter grid, row by row.
    argument : str
        ``"light"``: functions of the direction to the light. ``"view"``: of the direction to the eye, under a light
        that is fixed.
    name : str
        What tables call it.
    notes : tuple of str
        What a file left open, and how it was taken.
    """

    vertices_v3: NDArray[np.float64]
    faces_f3: NDArray[np.int32]
    normals_v3: NDArray[np.float64]
    tangents_v3: NDArray[np.float64] | None = None
    albedo_vc: NDArray[np.float32] | None = None
    texture_v2: NDArray[np.float64] | None = None
    grid: tuple[int, int] | None = None
    argument: str = "light"
    name: str = "surface"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        vertices_v3 = _set_rows(self, "vertices_v3", 3)
        if not 1 <= len(vertices_v3) < _MOST_VERTICES:
            raise InputError(f"a surface has from 1 to {_MOST_VERTICES - 1} vertices, got {len(vertices_v3)}")
        self._check_faces(len(vertices_v3))
        for label in ("normals_v3", "tangents_v3"):
            if getattr(self, label) is None:
                continue
            vectors_v3 = _set_rows(self, label, 3, len(vertices_v3))
            if not are_unit(vectors_v3):
                raise InputError(f"{label[:-3]} must be unit vectors")
        if self.tangents_v3 is not None:
            off = np.abs(np.sum(self.tangents_v3 * self.normals_v3, axis=1)).max()
            if off > _ROUNDING:
                raise InputError(f"tangents must be orthogonal to the normals, one is off by {off:.2g}")
        if self.texture_v2 is not None:
            _set_rows(self, "texture_v2", 2, len(vertices_v3))
        self._check_albedo(len(vertices_v3))
        if self.grid is not None and (len(self.grid) != 2 or self.grid[0] * self.grid[1] != len(vertices_v3)):
            raise InputError(f"a grid of {self.grid} does not hold {len(vertices_v3)} vertices")
        if self.argument not in ARGUMENTS:
            raise InputError(f"argument must be one of {', '.join(ARGUMENTS)}, got {self.argument!r}")

    def _check_faces(self, n_vertex: int) -> None:
        faces = np.asarray(self.faces_f3)
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.dtype.kind not in "iu":
            raise InputError(f"faces must be integers of shape (face, 3), got {faces.dtype} {faces.shape}")
        if faces.min() < 0 or faces.max() >= n_vertex:
            raise InputError(f"faces name vertices from {faces.min()} to {faces.max()}, there are {n_vertex}")
        object.__setattr__(self, "faces_f3", np.ascontiguousarray(faces, np.int32))

    def _check_albedo(self, n_vertex: int) -> None:
        if self.albedo_vc is None:
            return
        albedo_vc = np.ascontiguousarray(self.albedo_vc, np.float32)
        if albedo_vc.ndim != 2 or albedo_vc.shape not in ((n_vertex, 1), (n_vertex, 3)):
            raise InputError(f"albedo must be ({n_vertex}, 1) or ({n_vertex}, 3), got shape {albedo_vc.shape}")
        if not (albedo_vc.min() >= 0.0 and albedo_vc.max() <= 1.0):  # NaN neither
            raise InputError("albedo must be from 0 to 1")
        object.__setattr__(self, "albedo_vc", albedo_vc)

    @property
    def n_vertex(self) -> int:
        """Number of vertices."""
        return len(self.vertices_v3)

    @property
    def map_shape(self) -> tuple[int, int]:
        """Height and width of maps of its functions."""
        return self.grid or (self.n_vertex, 1)

    @property
    def frame(self) -> str:
        """``"local"`` where functions are in the frames of the vertices, else ``"global"``."""
        return "global" if self.tangents_v3 is None else "local"

    @property
    def diagonal(self) -> float:
        """Length of the diagonal of the box around it."""
        return float(np.linalg.norm(np.ptp(self.vertices_v3, axis=0)))

    def frames(self) -> NDArray[np.float64]:
        """Return the axes (x, y, z) of the functions at each vertex as rows, shape (n_vertex, 3, 3)."""
        if self.tangents_v3 is None:
            return np.broadcast_to(np.eye(3), (self.n_vertex, 3, 3))
        across_v3 = np.cross(self.normals_v3, self.tangents_v3)
        return np.stack([self.tangents_v3, across_v3, self.normals_v3], axis=1)


def _set_rows(surface: Surface, label: str, width: int, count: int | None = None) -> NDArray[np.float64]:
    values = as_float64(getattr(surface, label), label[:-3])
    if values.ndim != 2 or values.shape[1] != width or count not in (None, len(values)):
        raise InputError(f"{label[:-3]} must have shape ({count or 'vertex'}, {width}), got {values.shape}")
    if not np.isfinite(values).all():
        bad = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise InputError(f"{label[:-3]} must be finite, number {bad} is {values[bad]}")
    object.__setattr__(surface, label, values)
    return values


def surface_facts(surface: Surface | None, config: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return in whose frames functions are, "frame", and of which direction, "argument"; None of a picture's.

    Of a surface, or without one what the config says of that which they were made for (see `without_surface`).
    """
    if surface is not None:
        return {"frame": surface.frame, "argument": surface.argument}
    said = config.get("surface")
    return said if isinstance(said, Mapping) else None


def check_surface(surface: Surface | None, shape: tuple[int, ...]) -> None:
    """Raise InputError where pixels of this height and width are not the surface's vertices."""
    if surface is not None and tuple(shape) != surface.map_shape:
        raise InputError(f"a surface of {surface.n_vertex} vertices has maps of {surface.map_shape}, got {shape}")
