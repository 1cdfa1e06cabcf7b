"""The hemisphere, or the sphere, as a square: equal areas stay equal, and the octahedron's edges are straight lines.

Clarberg (2008, Fast equal-area mapping of the (hemi)sphere using SIMD): the sphere's square has its upper half in the
diamond ``|u| + |v| <= 1`` and the lower one folded into the corners. The hemisphere's is that diamond, turned by 45
degrees into a square of its own: Shirley and Chiu's map of a disc (1997) under Lambert's equal-area projection.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def square_to_hemisphere(ab_n2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit vectors with z >= 0 (n, 3) of points of the square -1 .. 1 (n, 2).

    The square's centre is the zenith, its rim the horizon, and its corners are the axes -y, x, y and -x in turn.
    """
    a, b = np.asarray(ab_n2, np.float64).T
    # Turned by 45 degrees, the square's diagonals are the diamond's axes.
    return square_to_sphere(np.stack([(a - b) / 2.0, (a + b) / 2.0], axis=1))


def hemisphere_to_square(directions_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points of the square (n, 2) of unit vectors; those below the horizon count as on it."""
    held = np.array(directions_n3, np.float64)
    below = held[:, 2] < 0.0
    held[below, 2] = 0.0
    held[below] /= np.maximum(np.linalg.norm(held[below], axis=1, keepdims=True), np.finfo(float).tiny)
    u, v = sphere_to_square(held).T
    return np.clip(np.stack([u + v, v - u], axis=1), -1.0, 1.0)


def square_to_sphere(uv_n2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit vectors (n, 3) of points of the square -1 .. 1 (n, 2); its centre is z, its corners are -z."""
    u, v = np.asarray(uv_n2, np.float64).T
    inside = 1.0 - np.abs(u) - np.abs(v)  # below 0 in the lower half
    radius = 1.0 - np.abs(inside)
    turn = np.divide(np.abs(v) - np.abs(u), radius, out=np.zeros_like(radius), where=radius > 0.0)
    azimuth = (turn + 1.0) * (np.pi / 4.0)
    z = np.sign(inside) * (1.0 - radius**2)
    sine = radius * np.sqrt(np.maximum(2.0 - radius**2, 0.0))
    return np.stack([np.copysign(np.cos(azimuth), u) * sine, np.copysign(np.sin(azimuth), v) * sine, z], axis=1)


def sphere_to_square(directions_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points of the square (n, 2) of unit vectors."""
    x, y, z = np.asarray(directions_n3, np.float64).T
    across = np.hypot(x, y)
    # sqrt(1 - |z|), without the difference of two numbers that are nearly 1
    radius = across / np.sqrt(1.0 + np.abs(z))
    along = np.arctan2(np.abs(y), np.abs(x)) * (2.0 / np.pi) * radius
    u, v = radius - along, along
    lower = z < 0.0
    u, v = np.where(lower, 1.0 - v, u), np.where(lower, 1.0 - u, v)
    return np.stack([np.copysign(u, x), np.copysign(v, y)], axis=1)


def cell_nodes(side: int, pairs: int) -> NDArray[np.float64]:
    """Return directions in each cell of the hemisphere's square, (side, side, n_node, 3), all of equal solid angle.

    A mean over the cell is that over them: Gauss's two nodes of each of `pairs` parts along each side, or its centre
    alone for 0. What is lost is lost along the square's diagonals, where the map has a fold.
    """
    offsets = (np.arange(max(pairs, 1))[:, None] + 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)) / max(pairs, 1)
    within = offsets.ravel() if pairs else np.array([0.5])
    at = ((np.arange(side)[:, None] + within).ravel()) * (2.0 / side) - 1.0
    b, a = np.meshgrid(at, at, indexing="ij")
    directions = square_to_hemisphere(np.stack([a.ravel(), b.ravel()], axis=1))
    count = len(within)
    parted = directions.reshape(side, count, side, count, 3).transpose(0, 2, 1, 3, 4)
    return np.ascontiguousarray(parted.reshape(side, side, count * count, 3))
