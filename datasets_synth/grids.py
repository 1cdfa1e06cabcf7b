"""Surfaces over a parameter grid: their triangles, where columns, or rows and columns, close upon themselves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def grid_triangles(rows: int, columns: int, *, rows_wrap: bool) -> NDArray[np.int32]:
    """Return the triangles of a grid of vertices whose last column has the first as its neighbour.

    Each vertex is in the grid once: it is the indices that close the seams. Counterclockwise seen from the side of
    (direction of growing columns) x (direction of growing rows).

    Parameters
    ----------
    rows, columns : int
        At least 3 of what wraps, 2 else.
    rows_wrap : bool
        Whether the last row has the first as its neighbour too; else the first and the last row are closed by fans.
    """
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    below = np.roll(index, -1, axis=0) if rows_wrap else index[1:]
    above = index if rows_wrap else index[:-1]
    a, b, c, d = above, np.roll(above, -1, axis=1), np.roll(below, -1, axis=1), below
    faces_f3 = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    if rows_wrap:
        return faces_f3
    first, last = index[0], index[-1]
    fan_f3 = [np.stack([np.full(columns - 2, row[0]), row[1:-1], row[2:]], axis=-1) for row in (first, last)]
    return np.concatenate([fan_f3[0][:, ::-1], faces_f3, fan_f3[1]])
