"""Surfaces for tests, by trimesh or by formula, and cameras' rays computed apart."""

import numpy as np
import pytest

from clrelight.surface import Surface

trimesh = pytest.importorskip("trimesh", reason="surfaces need trimesh: pip install 'clrelight[surfaces]'")
pytest.importorskip("embreex", reason="surfaces need embreex: pip install 'clrelight[surfaces]'")


def unit(vectors_n3):
    vectors_n3 = np.asarray(vectors_n3, np.float64)
    return vectors_n3 / np.linalg.norm(vectors_n3, axis=-1, keepdims=True)


def tangents_of(normals_v3, seed=0):
    """Return unit vectors across the normals, turned by chance."""
    rng = np.random.default_rng(seed)
    return unit(np.cross(normals_v3, unit(rng.standard_normal(normals_v3.shape))))


def sphere(level=4, tangents=False, **fields):
    """Return the unit sphere, its normals exact."""
    mesh = trimesh.creation.icosphere(level)
    points_v3 = unit(mesh.vertices)
    tangents_v3 = tangents_of(points_v3) if tangents else None
    return Surface(points_v3, mesh.faces.astype(np.int32), points_v3, tangents_v3, **fields)


def torus_grid(rows=48, columns=24, major=1.0, minor=0.4, **fields):
    """Return a torus about z as a parameter grid that wraps both ways, with tangents along the rows."""
    u, v = np.meshgrid(2 * np.pi * np.arange(rows) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    u, v = u.ravel(), v.ravel()
    normals_v3 = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
    centres_v3 = major * np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=1)
    tangents_v3 = np.stack([-np.sin(u), np.cos(u), np.zeros_like(u)], axis=1)
    row, column = np.divmod(np.arange(rows * columns), columns)
    down, right = (row + 1) % rows, (column + 1) % columns
    a, b, c, d = row * columns + column, down * columns + column, down * columns + right, row * columns + right
    faces_f3 = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    return Surface(centres_v3 + minor * normals_v3, faces_f3, normals_v3, tangents_v3, grid=(rows, columns), **fields)


def pixel_rays(camera, width, height):
    """Return origin and directions (height, width, 3) of pixels' centres of a perspective view, by its definition."""
    eye, target = np.asarray(camera.eye_3), np.asarray(camera.target_3)
    forward = unit(target - eye)
    right = unit(np.cross(forward, camera.up_3))
    up = np.cross(right, forward)
    slope = np.tan(np.radians(camera.field_of_view / 2))
    y = slope * (1 - 2 * (np.arange(height) + 0.5) / height)
    x = slope * (2 * (np.arange(width) + 0.5) - width) / height
    return eye, unit(forward + x[None, :, None] * right + y[:, None, None] * up)


def meet_sphere(origin, directions):
    """Return where rays first meet the unit sphere, and whether they do."""
    b = directions @ origin
    root = b * b - (origin @ origin - 1)
    met = root > 0
    return origin + (-b - np.sqrt(np.where(met, root, 0)))[..., None] * directions, met
