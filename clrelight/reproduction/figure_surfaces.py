"""Surfaces of the figures, by trimesh."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.surface import Surface
from clrelight.transfer.cameras import Camera

Mesh = tuple[NDArray, NDArray]
"""Vertices and faces."""

BALL_AT = np.array([-1.45, 1.3, 0.96])


def join(parts: Sequence[Mesh], albedos: Sequence[Sequence[float]] | None = None) -> Surface:
    """Return meshes as one surface, each with its own colour."""
    vertices, faces, first = [], [], 0
    for vertices_v3, faces_f3 in parts:
        vertices.append(vertices_v3)
        faces.append(faces_f3 + first)
        first += len(vertices_v3)
    vertices_v3, faces_f3 = np.concatenate(vertices), np.concatenate(faces).astype(np.int32)
    corners_fj3 = vertices_v3[faces_f3]
    areas_f3 = np.cross(corners_fj3[:, 1] - corners_fj3[:, 0], corners_fj3[:, 2] - corners_fj3[:, 0])
    normals_v3 = np.zeros_like(vertices_v3)
    np.add.at(normals_v3, faces_f3.ravel(), np.repeat(areas_f3, 3, axis=0))
    length_v1 = np.linalg.norm(normals_v3, axis=1, keepdims=True)
    normals_v3 = np.where(length_v1 > 0.0, normals_v3 / np.where(length_v1 > 0.0, length_v1, 1.0), (0.0, 0.0, 1.0))
    colours_vc = None
    if albedos is not None:
        counts = [len(part[0]) for part in parts]
        colours_vc = np.repeat(np.asarray(albedos, np.float32), counts, axis=0)
    return Surface(vertices_v3, faces_f3, normals_v3, albedo_vc=colours_vc)


@functools.cache
def plain(shape: str, level: int = 5) -> Surface:
    """Return a ball of radius 1, or a torus."""
    import trimesh

    if shape == "ball":
        mesh = trimesh.creation.icosphere(level)
        points_v3 = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
        return Surface(points_v3, mesh.faces.astype(np.int32), points_v3)
    mesh = trimesh.creation.torus(1.0, 0.42, 96, 48)
    return join([(np.asarray(mesh.vertices), np.asarray(mesh.faces))])


def sheet(corner: Sequence[float], along: Sequence[float], across: Sequence[float], cells: int) -> Mesh:
    """Return a parallelogram in so many cells each way; its normal is along x across."""
    u, v = (grid.ravel()[:, None] / cells for grid in np.indices((cells + 1, cells + 1)))
    vertices_v3 = np.asarray(corner, float) + u * np.asarray(along, float) + v * np.asarray(across, float)
    at = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    down, right = at + cells + 1, at + 1
    return vertices_v3, np.concatenate([np.stack([at, down, down + 1], 1), np.stack([at, down + 1, right], 1)])


def table_scene(armadillo: Surface) -> tuple[Surface, NDArray[np.int64]]:
    """Return figure 1's things, and of each vertex what it is: 0 white, 1 mirror, 2 pool ball."""
    import trimesh

    ball = plain("ball", 6)
    low, high = armadillo.vertices_v3.min(axis=0), armadillo.vertices_v3.max(axis=0)
    scale = 1.9 / (high[2] - low[2])
    middle = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    turned_v3 = (armadillo.vertices_v3 - middle) * scale * (-1.0, -1.0, 1.0)
    table = trimesh.creation.cylinder(3.1, 0.12, sections=256)
    parts = [
        (turned_v3 + np.array([0.75, 0.25, 0.0]), armadillo.faces_f3),
        (0.62 * ball.vertices_v3 + np.array([-0.75, -0.5, 0.62]), ball.faces_f3),
        (np.asarray(table.vertices) - (0.0, 0.0, 0.06), np.asarray(table.faces)),
        (0.6 * ball.vertices_v3 + np.array([-2.15, 0.0, 0.6]), ball.faces_f3),
        (0.55 * ball.vertices_v3 + np.array([2.15, -0.3, 0.55]), ball.faces_f3),
    ]
    kind_v = np.repeat([0, 0, 0, 1, 2], [len(part[0]) for part in parts])
    surface = join(parts)
    normals_v3 = surface.normals_v3.copy()
    start = len(parts[0][0]) + len(parts[1][0])
    rim = slice(start, start + len(parts[2][0]))  # the table's top is flat up to its edge
    normals_v3[rim] = np.where(surface.vertices_v3[rim, 2:] > -0.01, (0.0, 0.0, 1.0), normals_v3[rim])
    return Surface(surface.vertices_v3, surface.faces_f3, normals_v3), kind_v


def object_scene() -> tuple[Surface, Camera]:
    """Return a white ball and a torus on a white floor before a red and a green wall, and a camera."""
    ball, ring = plain("ball"), plain("torus")
    white, red, green = (0.85, 0.85, 0.85), (0.8, 0.12, 0.1), (0.15, 0.6, 0.2)
    parts = [
        sheet((-3, -3, 0), (6, 0, 0), (0, 6, 0), 72),
        sheet((-3, -3, 0), (0, 6, 0), (0, 0, 3.2), 40),
        sheet((-3, 3, 0), (6, 0, 0), (0, 0, 3.2), 40),
        (0.95 * ball.vertices_v3 + BALL_AT, ball.faces_f3),
        (ring.vertices_v3 + np.array([0.75, -0.55, 0.43]), ring.faces_f3),
    ]
    surface = join(parts, [white, red, green, white, white])
    return surface, Camera((7.5, -9.5, 6.5), (-0.35, 0.2, 0.75), field_of_view=28.0)
