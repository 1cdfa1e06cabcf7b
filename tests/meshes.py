"""Meshes whose transfer is known."""

import numpy as np

from clrelight.surface import Surface


def icosphere(level=3, radius=1.0, centre=(0.0, 0.0, 0.0), inside=False):
    """Return a sphere of triangles, its normals exact; from `inside`, it is seen from within."""
    g = (1.0 + np.sqrt(5.0)) / 2.0
    v = np.array([[s * a, t * b, 0.0] for a, b in ((1.0, g),) for s in (-1, 1) for t in (-1, 1)])
    v = np.concatenate([v, np.roll(v, 1, axis=1), np.roll(v, 2, axis=1)])
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    near = [(i, j, k) for i in range(12) for j in range(i) for k in range(j) if _close(v, i, j, k)]
    f = np.array([(i, j, k) if np.linalg.det(v[[i, j, k]]) > 0 else (i, k, j) for i, j, k in near])
    for _ in range(level):
        v, f = _divided(v, f)
    if inside:
        return Surface(v * radius + centre, f[:, ::-1], -v, name="cave")
    return Surface(v * radius + centre, f, v, name="sphere")


def _close(v, *three):
    return all(v[a] @ v[b] > 0.4 for a, b in ((three[0], three[1]), (three[1], three[2]), (three[0], three[2])))


def _divided(v, f):
    edges = np.sort(f[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    middle = v[unique].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    ab, bc, ca = (number.reshape(-1, 3) + len(v)).T
    a, b, c = f.T
    faces = np.concatenate([np.stack(each, axis=1) for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return np.concatenate([v, middle]), faces


def joined(*parts, name="scene"):
    """Return surfaces as one."""
    starts = np.cumsum([0, *(part.n_vertex for part in parts)])
    return Surface(
        np.concatenate([part.vertices_v3 for part in parts]),
        np.concatenate([part.faces_f3 + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.normals_v3 for part in parts]),
        name=name,
    )


def quad(corner, u, v, rows=1, columns=1):
    """Return a flat sheet from `corner` along u and v, its normal u × v."""
    corner, u, v = (np.asarray(each, np.float64) for each in (corner, u, v))
    i, j = np.indices((rows + 1, columns + 1)).reshape(2, -1)
    points = corner + (j / columns)[:, None] * u + (i / rows)[:, None] * v
    at = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    faces = np.concatenate(
        [
            np.stack([at, at + 1, at + columns + 2], axis=1),
            np.stack([at, at + columns + 2, at + columns + 1], axis=1),
        ]
    )
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    return Surface(points, faces, np.tile(normal, (len(points), 1)), name="sheet")


def open_box(cells=8):
    """Return the inside of a box without its lid: a floor and four walls, seen from within."""
    floor = quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), cells, cells)
    walls = [
        quad((1, -1, 0), (0, 2, 0), (0, 0, 1), cells, cells),
        quad((-1, 1, 0), (0, -2, 0), (0, 0, 1), cells, cells),
        quad((1, 1, 0), (-2, 0, 0), (0, 0, 1), cells, cells),
        quad((-1, -1, 0), (2, 0, 0), (0, 0, 1), cells, cells),
    ]
    inward = []
    for wall in walls:
        away = np.einsum("a,a->", wall.normals_v3[0], wall.vertices_v3.mean(axis=0) - [0, 0, 0.5])
        inward.append(wall if away < 0 else _turned(wall))
    return joined(floor, *inward, name="open box")


def _turned(part):
    return Surface(part.vertices_v3, part.faces_f3[:, ::-1], -part.normals_v3)
