"""The light of a relight folder: an octahedral table of bases, made of the axes of sampled display values.

`mrgb` has axes of red, green and blue together; `mycc` has a third of them for each of luminance and two differences,
which a viewer turns into colours (`to_ycc`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

COLOUR_SPACES = ("mrgb", "mycc")
_ROOM = 0.05
"""Of the range of the samples' planes, on either side, for pixels that are none of them."""


@dataclass(frozen=True)
class Table:
    """A folder's bases, as it holds them.

    Attributes
    ----------
    resolution : int
        Cells along a side of the square.
    codes_pd : ndarray, shape (plane + 1, cell · 3), uint8
        The mean, then the planes' bases.
    range_p, scale_p, bias_p : ndarray, shape (plane,), float64
    """

    resolution: int
    codes_pd: NDArray[np.uint8]
    range_p: NDArray[np.float64]
    scale_p: NDArray[np.float64]
    bias_p: NDArray[np.float64]

    @property
    def mean_d(self) -> NDArray[np.float64]:
        """The first base."""
        return self.codes_pd[0] / 255.0

    @property
    def bases_pd(self) -> NDArray[np.float64]:
        """The other ones."""
        return (self.codes_pd[1:].astype(np.float64) - 127.0) / self.range_p[:, None]

    @property
    def solver(self) -> NDArray[np.float32]:
        """What makes planes of display values apart from the mean, (cell · 3, plane)."""
        return np.linalg.pinv(self.bases_pd).astype(np.float32)


def octahedral_directions(resolution: int) -> NDArray[np.float64]:
    """Return the directions of the cells, (resolution², 3): those of a row follow each other, x + y, then y - x."""
    v, u = np.meshgrid(*2 * [np.linspace(-1.0, 1.0, resolution)], indexing="ij")
    x, y = (u - v).ravel() / 2.0, (u + v).ravel() / 2.0
    directions = np.stack([x, y, 1.0 - np.abs(x) - np.abs(y)], axis=1)
    directions[:, 2] = np.maximum(directions[:, 2], 0.0)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def to_ycc(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return luminance (r + 2 g + b) / 4, r - b and g - (r + b) / 2 of colours on the last axis, as relight does."""
    red, green, blue = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    between = (red + blue) / 2
    return np.stack([(between + green) / 2, red - blue, green - between], axis=-1)


def to_rgb(ycc: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return what `to_ycc` was given."""
    luminance, orange, greenness = ycc[..., 0], ycc[..., 1], ycc[..., 2]
    between = luminance - greenness / 2
    return np.stack([between + orange / 2, luminance + greenness / 2, between - orange / 2], axis=-1)


def make_table(values_nd: NDArray[np.float32], planes: int, resolution: int, space: str = "mrgb") -> Table:
    """Return bases for display values.

    Parameters
    ----------
    values_nd : ndarray, shape (sample, cell · 3), float32
        Of the colour space.
    planes : int
        Of `mycc` a third belongs to each component, in turn: relight puts what luminance has more behind the others,
        and OpenLIME takes it for others there.
    resolution : int
    space : str

    Returns
    -------
    Table
        Planes are scaled to the range that samples have, a twentieth more on either side.
    """
    mean_d = np.clip(values_nd.mean(axis=0, dtype=np.float64), 0.0, 1.0)
    codes_pd = np.empty((planes + 1, len(mean_d)), np.uint8)
    codes_pd[0] = np.rint(255.0 * mean_d)
    apart_nd = values_nd - (codes_pd[0] / 255.0).astype(np.float32)
    if space == "mrgb":
        vectors_pd = _axes(apart_nd, planes)
    else:
        vectors_pd = np.zeros((planes, len(mean_d)))
        for component in range(3):
            vectors_pd[component::3, component::3] = _axes(apart_nd[:, component::3], planes // 3)
    range_p = 127.0 / np.abs(vectors_pd).max(axis=1)
    codes_pd[1:] = np.rint(range_p[:, None] * vectors_pd) + 127.0
    table = Table(resolution, codes_pd, range_p, np.ones(planes), np.zeros(planes))
    found_np = apart_nd @ table.solver
    low_p, high_p = found_np.min(axis=0).astype(np.float64), found_np.max(axis=0).astype(np.float64)
    room_p = _ROOM * (high_p - low_p) + 1e-6
    scale_p = high_p - low_p + 2.0 * room_p
    return Table(resolution, codes_pd, range_p, scale_p, (room_p - low_p) / scale_p)


def _axes(apart_nd: NDArray[np.float32], count: int) -> NDArray[np.float64]:
    """Return the principal axes of samples, (axis, dimension), the largest first."""
    from scipy.linalg import eigh  # slow to load, and most commands load this module

    # The largest alone: half the time of all.
    wanted = [apart_nd.shape[1] - count, apart_nd.shape[1] - 1]
    _, vectors_da = eigh((apart_nd.T @ apart_nd).astype(np.float64), subset_by_index=wanted)
    return vectors_da[:, ::-1].T
