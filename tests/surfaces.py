"""Small surfaces, and what a test compares of them."""

import numpy as np

from clrelight.surface import Surface

ARRAYS = ("vertices_v3", "faces_f3", "normals_v3", "tangents_v3", "albedo_vc", "texture_v2")


def make_grid(rows=4, columns=5, *, whole=True, **changes):
    """Return a bent sheet whose vertices are a grid, with all that a surface may hold, or only what it must."""
    rng = np.random.default_rng(11)
    v, u = np.indices((rows, columns)).reshape(2, -1)
    normals = rng.normal([0, 0, 9], size=(rows * columns, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = np.cross(normals, [0.0, 1.0, 0.0])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + columns], axis=1),
            np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1),
        ]
    )
    optional = {
        "tangents_v3": tangents,
        "albedo_vc": rng.random((rows * columns, 3), np.float32),
        "texture_v2": np.stack([u / columns, v / rows], axis=1),
        "grid": (rows, columns),
        "argument": "view",
    }
    held = {
        "vertices_v3": np.stack([u, v, 0.1 * u * v], axis=1).astype(np.float64),
        "faces_f3": faces,
        "normals_v3": normals,
        "name": "sheet é",
        **(optional if whole else {}),
        **changes,
    }
    return Surface(**held)


def surface_content(surface):
    """Return all of a surface that files keep, comparable with ==."""
    if surface is None:
        return None
    arrays = [getattr(surface, name) for name in ARRAYS]
    held = [None if each is None else (each.dtype.str, each.shape, each.tobytes()) for each in arrays]
    return (*held, surface.grid, surface.argument, surface.name)
