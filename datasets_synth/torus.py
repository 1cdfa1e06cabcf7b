"""The "torus" scene: a torus in its own shadow, a function at every vertex (noise-resistant-fitting, fig. 3b)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.sampling import make_pattern
from clrelight.surface import Surface
from clrelight.transfer.functions import sample_transfer
from datasets_synth.codes import check_dtype, to_codes
from datasets_synth.grids import grid_triangles
from datasets_synth.texture import tile_albedo

MAJOR, MINOR = 1.0, 0.42
"""Radii of the torus; the hole is narrow enough for the inner half to lie in shadow most of the time."""

SMALLEST_SIZE = 8
ALBEDOS = ("white", "tiles")


def torus_surface(rows: int, columns: int, major: float = MAJOR, minor: float = MINOR) -> Surface:
    """Return a torus about the z axis as a parameter grid that wraps both ways.

    Row i is at the angle 2 pi i / rows around the axis, column j at 2 pi j / columns around the tube, from its outside
    upwards. Vertices, normals and tangents (along growing rows, around the axis) are exact.
    """
    if min(rows, columns) < 3:
        raise InputError(f"a torus needs at least 3 rows and 3 columns, got {rows} and {columns}")
    if not 0.0 < minor < major:
        raise InputError(f"the tube's radius must be above 0 and below {major:g}, got {minor:g}")
    around, across = np.meshgrid(_turn(rows), _turn(columns), indexing="ij")
    outward = np.stack([np.cos(around), np.sin(around), np.zeros_like(around)], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    normals = np.cos(across)[..., None] * outward + np.sin(across)[..., None] * up
    tangents = np.stack([-np.sin(around), np.cos(around), np.zeros_like(around)], axis=-1)
    return Surface(
        (major * outward + minor * normals).reshape(-1, 3),
        grid_triangles(rows, columns, rows_wrap=True)[:, ::-1],
        normals.reshape(-1, 3),
        tangents.reshape(-1, 3),
        grid=(rows, columns),
        name="torus",
    )


def render_torus(
    *,
    size: int = 128,
    lights: int = 256,
    pattern: str = "uniform",
    seed: int = 0,
    dtype: str = "float32",
    albedo: str = "white",
    progress: Callable[[int, int], None] | None = None,
) -> LightStack:
    """Return the torus's functions ``albedo max(0, s_z) V(s)``, sampled in each vertex's own frame.

    Parameters
    ----------
    size : int
        Rows and columns of the grid, at least 8.
    lights : int
        Number of directions.
    pattern : str
        One of `clrelight.sampling.PATTERNS`.
    seed : int
        Seed of the tiles and of the scattered pattern.
    dtype : str
        One of `datasets_synth.codes.DTYPES`.
    albedo : str
        ``"white"``, or ``"tiles"``: the ring's ground, seen from above, in colour.
    progress : callable, optional
        Called as ``progress(done, total)``.

    Returns
    -------
    LightStack
        ``images_ihwc`` of shape (lights, size, size, 1 or 3), with its surface, name ``"torus"``.

    Raises
    ------
    InputError
        A bad argument, or the packages for ray tracing are not installed.
    """
    if size < SMALLEST_SIZE:
        raise InputError(f"size must be at least {SMALLEST_SIZE} rows and columns, got {size}")
    if albedo not in ALBEDOS:
        raise InputError(f"albedo must be one of {', '.join(ALBEDOS)}, got {albedo!r}")
    check_dtype(dtype)
    directions_i3 = make_pattern(pattern, lights, seed)
    surface = torus_surface(size, size)
    if albedo == "tiles":
        surface = replace(surface, albedo_vc=tile_albedo(surface.vertices_v3[:, :2], seed).astype(np.float32))
    return to_codes(sample_transfer(surface, directions_i3, progress=progress), dtype)


def _turn(count: int) -> NDArray[np.float64]:
    return np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
