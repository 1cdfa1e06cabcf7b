"""Meshes as files hold them, by trimesh: PLY, OBJ, STL, OFF, GLB."""

from __future__ import annotations

import io
import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import srgb_to_linear
from clrelight.errors import InputError
from clrelight.surface import Surface
from clrelight.transfer.mesh_text import readable
from clrelight.transfer.meshes import make_surface

FORMATS = ("ply", "obj", "stl", "off", "glb")
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_MOST_INSTANCES = 10_000


@dataclass(frozen=True)
class _Part:
    """One mesh of a file; attributes as of a `Surface`, None where the file has none."""

    vertices_v3: NDArray[np.float64]
    faces_f3: NDArray[np.int64]
    normals_v3: NDArray[np.float64] | None
    texture_v2: NDArray[np.float64] | None
    colors_v3: NDArray[np.uint8] | None


def read_mesh(path: str | os.PathLike[str], *, colors: bool = False, up: str | None = None) -> Surface:
    """Return the surface that a file holds; its `notes` say what was left open, and how it was taken.

    Several meshes become one. Polygons are cut into triangles; faces without area and vertices of no face are dropped;
    normals that are not there are made, each the mean of its faces' weighted by their areas; equal positions of an STL
    are one vertex. Nothing beside the file is read.

    Parameters
    ----------
    path : path
        Its ending says the format: one of `FORMATS`.
    colors : bool
        Take the colours of vertices as albedo: in sRGB, but for GLB's, which are linear.
    up : str, optional
        The axis that points up, and becomes z: ``"y"`` or ``"z"``; default: z, of GLB y, which is that format's.

    Raises
    ------
    InputError
        If there is no such file, it is of no such format, damaged, or holds no faces, or a number that is none.
    """
    place = Path(os.fsdecode(path))
    kind = place.suffix[1:].lower()
    if kind not in FORMATS:
        raise InputError(f"{place}: meshes are read from {', '.join(FORMATS)}, this name ends in {place.suffix!r}")
    if up not in (None, "y", "z"):
        raise InputError(f"up must be y or z, got {up!r}")
    parts = _load(place, kind)
    triangles = [part for part in parts if len(part.faces_f3)]
    if not triangles:
        points = sum(len(part.vertices_v3) for part in parts)
        held = f"{points} points and no faces" if points else "nothing"
        raise InputError(f"{place} holds {held}: a surface is made of triangles, or the file is cut short")
    part, notes = _join(triangles), []
    if len(triangles) > 1:
        notes.append(f"its {len(triangles)} meshes are taken as one")
    turn_33 = _Y_UP if (up or ("y" if kind == "glb" else "z")) == "y" else None
    if turn_33 is not None:
        notes.append("y is up: turned so that z is")
    try:
        return make_surface(
            _turned(part.vertices_v3, turn_33),
            part.faces_f3,
            None if part.normals_v3 is None else _turned(part.normals_v3, turn_33),
            texture_v2=part.texture_v2,
            albedo_vc=_albedo_of(part, kind) if colors else None,
            merge=kind == "stl",
            name=place.stem,
            notes=tuple(notes),
        )
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


def _load(place: Path, kind: str) -> list[_Part]:
    """Return the meshes of a file, from its bytes alone: no other file that it names is opened."""
    try:
        import trimesh
    except ImportError:
        raise InputError("meshes need trimesh: pip install 'clrelight[surfaces]'") from None
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # what it thinks of a file is said below
    try:
        content = place.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {place}: {error.strerror}") from None
    if not content:
        raise InputError(f"{place} is empty")
    options = {"skip_materials": True} if kind in ("obj", "ply") else {}
    try:
        with np.errstate(all="ignore"):  # numbers that are none are refused later, in a line
            held = io.BytesIO(readable(content, kind))
            return list(_parts_of(trimesh.load_scene(held, file_type=kind, process=False, **options)))
    except InputError as error:
        raise InputError(f"{place}: {error}") from None
    except MemoryError:
        raise InputError(f"{place} claims more than fits into memory: it is damaged, or too large") from None
    except Exception as error:  # a damaged file makes its parsers raise nearly anything
        first = (str(error).splitlines() or [""])[0]
        raise InputError(
            f"{place} is cut short, damaged or no {kind.upper()}: {first or type(error).__name__}"
        ) from None


def _parts_of(scene: Any) -> Iterator[_Part]:
    nodes = scene.graph.nodes_geometry
    if len(nodes) > _MOST_INSTANCES:
        raise InputError(f"a scene has at most {_MOST_INSTANCES} meshes, got {len(nodes)}")
    for node in nodes:
        matrix_44, name = scene.graph[node]
        mesh = scene.geometry[name]
        yield _part_of(mesh, np.asarray(matrix_44, np.float64))


def _part_of(mesh: Any, matrix_44: NDArray[np.float64]) -> _Part:
    vertices_v3 = np.asarray(getattr(mesh, "vertices", np.empty((0, 3))), np.float64).reshape(-1, 3)
    faces_f3 = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), np.int64).reshape(-1, 3)
    # Asked of the mesh itself, missing normals would be made, without a word and with their own weights.
    normals_v3 = mesh.vertex_normals if "vertex_normals" in getattr(mesh, "_cache", {}) else None
    if not np.array_equal(matrix_44, np.eye(4)):
        linear_33 = matrix_44[:3, :3]
        vertices_v3 = vertices_v3 @ linear_33.T + matrix_44[:3, 3]
        if np.linalg.det(linear_33) < 0:  # mirrored
            faces_f3 = faces_f3[:, ::-1]
        if normals_v3 is not None:
            normals_v3 = np.asarray(normals_v3) @ np.linalg.pinv(linear_33)
    visual = getattr(mesh, "visual", None)
    texture: Any = getattr(visual, "uv", None)
    colors = getattr(visual, "vertex_colors", None) if getattr(visual, "kind", None) in ("vertex", "face") else None
    count = len(vertices_v3)
    return _Part(
        vertices_v3,
        faces_f3,
        None if normals_v3 is None else np.asarray(normals_v3, np.float64),
        np.asarray(texture, np.float64) if texture is not None and np.shape(texture) == (count, 2) else None,
        np.asarray(colors)[:, :3] if colors is not None and len(colors) == count else None,
    )


def _join(parts: list[_Part]) -> _Part:
    if len(parts) == 1:
        return parts[0]
    starts = np.cumsum([0, *(len(part.vertices_v3) for part in parts)])

    def joined(name: str, width: int, missing: float | None) -> Any:
        held = [getattr(part, name) for part in parts]
        if all(each is None for each in held) or (missing is None and any(each is None for each in held)):
            return None
        filled = [
            np.full((len(part.vertices_v3), width), missing) if each is None else each
            for part, each in zip(parts, held, strict=True)
        ]
        return np.concatenate(filled)

    return _Part(
        np.concatenate([part.vertices_v3 for part in parts]),
        np.concatenate([part.faces_f3 + start for part, start in zip(parts, starts, strict=False)]),
        joined("normals_v3", 3, 0.0),  # to be made
        joined("texture_v2", 2, None),
        joined("colors_v3", 3, 255),
    )


def _turned(vectors_v3: NDArray[np.float64], turn_33: NDArray[np.float64] | None) -> NDArray[np.float64]:
    return vectors_v3 if turn_33 is None else vectors_v3 @ turn_33.T


def _albedo_of(part: _Part, kind: str) -> NDArray[np.float32]:
    if part.colors_v3 is None:
        raise InputError("it holds no colours of vertices to take as albedo: give numbers instead")
    value_vc = part.colors_v3.astype(np.float64) / 255.0
    return (value_vc if kind == "glb" else srgb_to_linear(value_vc)).astype(np.float32)
