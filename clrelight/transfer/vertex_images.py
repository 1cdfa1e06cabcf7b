"""Nearly square images of vertices, in which neighbours are alike: by halving, along a curve, and by sorting."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.surface import Surface

_WINDOW, _ROUNDS = 8, 40
"""Side in pixels of what is sorted at a time, and how often all of it is."""
_BLUR = 8.0, 0.7
"""Pixels that an image is blurred by in the first round, and in the last."""
_NORMALS = 0.25
"""Share of the diagonal that normals of two opposite directions are apart by, halved."""


def sort_image(image_hw: NDArray[np.int64], surface: Surface) -> NDArray[np.int64]:
    """Return an image of the same vertices, moved until neighbours have positions and normals alike.

    By linear assignment sorting (Barthel, Hezel, Jung and Schall 2023), which arranges pictures by what they show: the
    image of positions and normals is blurred, less each time; in windows whose place is drawn anew, vertices go to
    the pixels whose blurred values are nearest to theirs.
    """
    from scipy.ndimage import gaussian_filter
    from scipy.optimize import linear_sum_assignment

    height, width = image_hw.shape
    scale = _NORMALS * (surface.diagonal or 1.0)
    features_vf = np.concatenate([surface.vertices_v3 / scale, surface.normals_v3], axis=1)
    features_vf -= features_vf.mean(axis=0)
    sorted_hw, rng = image_hw.copy(), np.random.default_rng(0)
    for blur in np.geomspace(*_BLUR, _ROUNDS):
        # Only Generator.random is drawn: the one stream that NumPy versions have in common.
        top, left = (rng.random(2) * _WINDOW).astype(int)
        wanted_hwf = gaussian_filter(features_vf[sorted_hw], (blur, blur, 0.0), mode="nearest")
        for row in range(-top, height, _WINDOW):
            for column in range(-left, width, _WINDOW):
                part = np.s_[max(row, 0) : row + _WINDOW, max(column, 0) : column + _WINDOW]
                own_p = sorted_hw[part].ravel()
                wanted_pf = wanted_hwf[part].reshape(len(own_p), -1)
                cost_pp = np.square(features_vf[own_p][:, None] - wanted_pf[None]).sum(axis=2)
                moved_p = np.empty_like(own_p)
                moved_p[linear_sum_assignment(cost_pp)[1]] = own_p
                sorted_hw[part] = moved_p.reshape(sorted_hw[part].shape)
    return sorted_hw


def blocks_image(vertices_v3: NDArray[np.float64], height: int, width: int) -> NDArray[np.int64]:
    """Return an image of vertices that is halved with the box around them; what is left over repeats the last one."""
    count = len(vertices_v3)
    image_hw = np.empty((height, width), np.int64)
    listed_p = np.pad(np.arange(count), (0, height * width - count), mode="edge")
    pending = [(listed_p, slice(0, height), slice(0, width))]
    while pending:
        part_p, rows, columns = pending.pop()
        n_row, n_column = rows.stop - rows.start, columns.stop - columns.start
        if len(part_p) == 1:
            image_hw[rows, columns] = part_p[0]
            continue
        axis = int(np.ptp(vertices_v3[part_p], axis=0).argmax())
        part_p = part_p[np.argsort(vertices_v3[part_p, axis], kind="stable")]
        if n_row >= n_column:
            middle = rows.start + n_row // 2
            cut = (n_row // 2) * n_column
            pending += [(part_p[:cut], slice(rows.start, middle), columns)]
            pending += [(part_p[cut:], slice(middle, rows.stop), columns)]
        else:
            middle = columns.start + n_column // 2
            cut = (n_column // 2) * n_row
            pending += [(part_p[:cut], rows, slice(columns.start, middle))]
            pending += [(part_p[cut:], rows, slice(middle, columns.stop))]
    return image_hw


def hilbert_walk(height: int, width: int) -> Iterator[tuple[int, int]]:
    """Yield the pixels of any rectangle along a curve like Hilbert's, neighbours one after the other.

    By cutting the rectangle as J. Cerveny's generalised Hilbert curve does: along its longer side in two, or into three
    blocks of which the first and the last lie across.
    """
    start = (0, 0, 0, width, height, 0) if width >= height else (0, 0, height, 0, 0, width)
    pending = [start]
    while pending:
        row, column, along_r, along_c, across_r, across_c = pending.pop()
        n_along, n_across = abs(along_r + along_c), abs(across_r + across_c)
        step, side = (_sign(along_r), _sign(along_c)), (_sign(across_r), _sign(across_c))
        if n_across == 1 or n_along == 1:
            ahead, count = (step, n_along) if n_across == 1 else (side, n_across)
            yield from ((row + ahead[0] * i, column + ahead[1] * i) for i in range(count))
            continue
        half_r, half_c, cross_r, cross_c = along_r // 2, along_c // 2, across_r // 2, across_c // 2
        if 2 * n_along > 3 * n_across:
            if abs(half_r + half_c) % 2 and n_along > 2:
                half_r, half_c = half_r + step[0], half_c + step[1]
            parts = [
                (row, column, half_r, half_c, across_r, across_c),
                (row + half_r, column + half_c, along_r - half_r, along_c - half_c, across_r, across_c),
            ]
        else:
            if abs(cross_r + cross_c) % 2 and n_across > 2:
                cross_r, cross_c = cross_r + side[0], cross_c + side[1]
            last_r, last_c = row + along_r - step[0] + cross_r - side[0], column + along_c - step[1] + cross_c - side[1]
            parts = [
                (row, column, cross_r, cross_c, half_r, half_c),
                (row + cross_r, column + cross_c, along_r, along_c, across_r - cross_r, across_c - cross_c),
                (last_r, last_c, -cross_r, -cross_c, half_r - along_r, half_c - along_c),
            ]
        pending += parts[::-1]


def _sign(value: int) -> int:
    return (value > 0) - (value < 0)
