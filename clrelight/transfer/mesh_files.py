"""Meshes as files hold them, by trimesh: PLY, OBJ, STL, OFF, glTF."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from clrelight.errors import InputError
from clrelight.surface import Surface


def read_mesh(path: str | os.PathLike[str]) -> Surface:
    """Return the surface that a file holds."""
    try:
        import trimesh
    except ImportError:
        raise InputError("meshes need trimesh: pip install 'clrelight[surfaces]'") from None
    mesh = trimesh.load(path, process=False, force="mesh")
    normals_v3 = np.asarray(mesh.vertex_normals, np.float64)
    return Surface(mesh.vertices, np.asarray(mesh.faces, np.int32), normals_v3, name=Path(path).stem)
