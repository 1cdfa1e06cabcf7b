"""Frames of vertices: tangents, and functions turned from the axes of the positions into them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.rotation_batch import rotate_each
from clrelight.surface import Surface

FRAMES = ("global", "local")
_SOUTH = 1e-7


def tangents_of(normals_v3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a unit vector orthogonal to each normal, (n, 3): smooth in the normal everywhere but at -z.

    The first axis of the frame that the shortest turn makes of the axes as it takes z to the normal (Frisvad 2012).
    """
    x_v, y_v, z_v = normals_v3.T
    south_v = z_v < _SOUTH - 1.0
    a_v = 1.0 / np.where(south_v, 1.0, 1.0 + z_v)
    tangents_v3 = np.stack([1.0 - a_v * x_v * x_v, -a_v * x_v * y_v, -x_v], axis=1)
    tangents_v3[south_v] = [1.0, 0.0, 0.0]
    off_v = np.einsum("va,va->v", tangents_v3, normals_v3)
    tangents_v3 -= off_v[:, None] * normals_v3  # normals are of unit length within rounding, or less
    return tangents_v3 / np.linalg.norm(tangents_v3, axis=1, keepdims=True)


def with_frames(surface: Surface, frame: str) -> Surface:
    """Return the surface with functions in the axes of the positions, or in each vertex's own frame.

    ``local`` keeps the tangents that there are, else makes them by `tangents_of`.
    """
    if frame not in FRAMES:
        raise InputError(f"frame must be {' or '.join(FRAMES)}, got {frame!r}")
    if frame == "global":
        return replace(surface, tangents_v3=None)
    if surface.tangents_v3 is not None:
        return surface
    return replace(surface, tangents_v3=tangents_of(surface.normals_v3))


def turn_into_frames(coeffs_vck: NDArray[np.float32], frames_v33: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return functions in the vertices' frames that are given in the axes of the positions.

    ``f'(d) = f(d_x t + d_y b + d_z n)``: what was said of s is said of F s, where F has the frame's axes as rows.

    Parameters
    ----------
    coeffs_vck : ndarray, shape (n_vertex, channel, n_coeff), float32
    frames_v33 : ndarray, shape (n_vertex, 3, 3), float64
        As of `Surface.frames`.
    """
    turned_vkc = rotate_each(coeffs_vck.transpose(0, 2, 1), frames_v33)
    return np.ascontiguousarray(turned_vkc.transpose(0, 2, 1), np.float32)
