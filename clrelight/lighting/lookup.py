"""What an environment map shows in given directions: backgrounds and mirrors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.lighting import layouts
from clrelight.lighting.environment import Environment


def look_up(environment: Environment, directions_n3: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the radiance of the texels around unit directions, (n, channel) float32.

    Between the centres of four texels it is bilinear; lat-long maps go round, others end at their edges.
    """
    view_n3 = directions_n3 @ layouts.parse_axes(environment.axes)[1]
    height, width = environment.radiance_hwc.shape[:2]
    if environment.layout == "latlong":
        row_n, column_n, top_n, bottom_n = _latlong(view_n3, height, width)
    elif environment.layout == "angular":
        row_n, column_n, top_n, bottom_n = _angular(view_n3, height)
    else:
        row_n, column_n, top_n, bottom_n = _cube(view_n3, width)
    row_n = np.clip(row_n, top_n, bottom_n)
    above_n = np.minimum(np.floor(row_n), np.maximum(bottom_n - 1, top_n)).astype(np.intp)
    left_n = np.floor(column_n).astype(np.intp)
    if environment.layout != "latlong":
        column_n = np.clip(column_n, 0, width - 1)
        left_n = np.minimum(np.floor(column_n), max(width - 2, 0)).astype(np.intp)
    down_n1, right_n1 = (row_n - above_n)[:, None], (column_n - left_n)[:, None]
    below_n = np.minimum(above_n + 1, bottom_n)
    first_n, last_n = left_n % width, (left_n + 1) % width
    radiance_hwc = environment.radiance_hwc
    upper_nc = (1 - right_n1) * radiance_hwc[above_n, first_n] + right_n1 * radiance_hwc[above_n, last_n]
    lower_nc = (1 - right_n1) * radiance_hwc[below_n, first_n] + right_n1 * radiance_hwc[below_n, last_n]
    return ((1 - down_n1) * upper_nc + down_n1 * lower_nc).astype(np.float32)


_Place = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.intp], NDArray[np.intp]]
"""Row and column, in texels from the centre of the first, and the rows within which to stay."""


def _latlong(view_n3: NDArray[np.float64], height: int, width: int) -> _Place:
    azimuth_n = np.arctan2(view_n3[:, 1], view_n3[:, 0])  # from right towards forward
    column_n = ((1.5 * np.pi - azimuth_n) / (2.0 * np.pi) % 1.0) * width - 0.5
    row_n = np.arccos(np.clip(view_n3[:, 2], -1.0, 1.0)) / np.pi * height - 0.5
    return row_n, column_n, *_rows(len(view_n3), 0, height - 1)


def _angular(view_n3: NDArray[np.float64], size: int) -> _Place:
    across_n = np.hypot(view_n3[:, 0], view_n3[:, 2])
    scale_n = np.arctan2(across_n, view_n3[:, 1]) / np.pi / np.where(across_n > 0.0, across_n, 1.0)
    row_n = (1.0 - scale_n * view_n3[:, 2]) * size / 2.0 - 0.5
    return row_n, (1.0 + scale_n * view_n3[:, 0]) * size / 2.0 - 0.5, *_rows(len(view_n3), 0, size - 1)


def _cube(view_n3: NDArray[np.float64], size: int) -> _Place:
    right_n, forward_n, up_n = view_n3.T
    # Faces +X -X +Y -Y +Z -Z of Direct3D, whose y is our up and z our forward: how far right and up in each.
    faces = (
        (right_n, -forward_n, up_n),
        (-right_n, forward_n, up_n),
        (up_n, right_n, -forward_n),
        (-up_n, right_n, forward_n),
        (forward_n, right_n, up_n),
        (-forward_n, -right_n, up_n),
    )
    ahead_nf, across_nf, along_nf = (np.stack([face[part] for face in faces], axis=1) for part in range(3))
    face_n = np.argmax(ahead_nf, axis=1)
    pick = np.arange(len(view_n3)), face_n
    across_n, along_n = across_nf[pick] / ahead_nf[pick], along_nf[pick] / ahead_nf[pick]
    first_n = face_n * size
    row_n = first_n + (1.0 - along_n) * size / 2.0 - 0.5
    return row_n, (1.0 + across_n) * size / 2.0 - 0.5, first_n, first_n + size - 1


def _rows(count: int, first: int, last: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.full(count, first, np.intp), np.full(count, last, np.intp)
