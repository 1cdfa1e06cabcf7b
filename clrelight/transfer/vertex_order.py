"""The order of a surface's vertices, and images of them: codecs look for what is alike in neighbours."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse import csgraph

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.surface import Surface
from clrelight.transfer.vertex_images import blocks_image, hilbert_walk, sort_image

ORDERS = ("file", "morton", "hilbert", "graph", "blocks", "sorted")
"""Orders of `reorder`."""
IMAGES = ("blocks", "sorted")
"""Those that are images."""

_BITS = 20


@dataclass(frozen=True)
class VertexOrder:
    """Where the vertices of a surface, or the pixels of an image of it, come from.

    Attributes
    ----------
    source_p : ndarray, shape (n_pixel,), int64
        The vertex of the surface before that each one is; where an image has more pixels, its last ones repeat.
    n_vertex : int
        Of the surface before.
    name : str
        One of `ORDERS`.
    """

    source_p: NDArray[np.int64]
    n_vertex: int
    name: str

    def apply(self, values: NDArray[Any], axis: int = 0) -> NDArray[Any]:
        """Return values of the surface before, put into this order along an axis."""
        return np.take(values, self.source_p, axis=axis)

    def undo(self, values: NDArray[Any], axis: int = 0) -> NDArray[Any]:
        """Return values in this order as they stood before."""
        return np.take(values, self.places(), axis=axis)

    def places(self) -> NDArray[np.int64]:
        """Return, for each vertex of the surface before, where it now is: (n_vertex,)."""
        place_v = np.empty(self.n_vertex, np.int64)
        place_v[self.source_p[::-1]] = np.arange(len(self.source_p) - 1, -1, -1)  # of repeats the first
        return place_v


def reorder(surface: Surface, order: str) -> tuple[Surface, VertexOrder]:
    """Return the surface with its vertices in another order, and the order.

    ``"file"``: as they are. ``"morton"``, ``"hilbert"``: along a curve through the positions. ``"graph"``: Cuthill and
    McKee's reversed, in which the vertices of an edge stand near each other. ``"blocks"``, ``"sorted"``: images, see
    `fold_surface`.
    """
    if order in IMAGES:
        return fold_surface(surface, order)
    source_v = vertex_order(surface, order)
    chosen = VertexOrder(source_v, surface.n_vertex, order)
    if order == "file":
        return surface, chosen
    return _arranged(surface, chosen, None), chosen


def fold_surface(surface: Surface, order: str = "sorted") -> tuple[Surface, VertexOrder]:
    """Return the surface as a nearly square image of its vertices, and where its pixels come from.

    ``"blocks"`` halves the image again and again, and the vertices with it, along the longest side of the box around
    them: what is near in the image is near on the surface, but for the cuts. ``"sorted"`` moves the vertices of that
    image until neighbours are alike in position and normal (`sort_image`). Another order is laid along a Hilbert
    curve through the image. Pixels that are left repeat the last vertex, and no face uses them.
    """
    count = surface.n_vertex
    height = math.isqrt(count)
    width = -(-count // height)
    if order in IMAGES:
        image_hw = blocks_image(surface.vertices_v3, height, width)
        image_hw = sort_image(image_hw, surface) if order == "sorted" else image_hw
    else:
        listed_p = np.pad(vertex_order(surface, order), (0, height * width - count), mode="edge")
        image_hw = np.empty((height, width), np.int64)
        image_hw[tuple(np.array(list(hilbert_walk(height, width))).T)] = listed_p
    folded = VertexOrder(image_hw.ravel(), count, order)
    return _arranged(surface, folded, (height, width)), folded


def vertex_order(surface: Surface, order: str) -> NDArray[np.int64]:
    """Return the vertices (n_vertex,) in an order of `ORDERS` that is a list."""
    if order == "file":
        return np.arange(surface.n_vertex)
    if order == "graph":
        return _graph_order(surface)
    if order not in ("morton", "hilbert"):
        raise InputError(f"vertices are ordered by {', '.join(ORDERS)}, got {order!r}")
    low_3, extent = surface.vertices_v3.min(axis=0), np.ptp(surface.vertices_v3, axis=0).max() or 1.0
    cells_v3 = np.minimum((surface.vertices_v3 - low_3) / extent * (1 << _BITS), (1 << _BITS) - 1).astype(np.int64)
    if order == "hilbert":
        cells_v3 = _to_hilbert(cells_v3)
    code_v = np.zeros(surface.n_vertex, np.int64)
    for bit in range(_BITS - 1, -1, -1):
        for axis in range(3):
            code_v = code_v << 1 | cells_v3[:, axis] >> bit & 1
    return np.argsort(code_v, kind="stable")


def reorder_map(coefficients: CoefficientMap, surface: Surface, order: VertexOrder) -> CoefficientMap:
    """Return a map of the surface before as one of `surface`, the one that came with the order."""
    height, width, channel = coefficients.image_shape
    if height * width != order.n_vertex:
        raise InputError(f"an order of {order.n_vertex} vertices is not one of a map of {height} by {width}")

    def arranged(values: Any, lead: tuple[int, ...]) -> Any:
        flat = np.asarray(values).reshape(*lead, order.n_vertex, channel)
        return order.apply(flat, len(lead)).reshape(*lead, *surface.map_shape, channel)

    others: dict[str, Any] = {
        name: None if value is None else arranged(value, ())
        for name, value in (("lambda_hwc", coefficients.lambda_hwc), ("rank_hwc", coefficients.rank_hwc))
    }
    coeffs = arranged(coefficients.coeffs_khwc, (coefficients.n_coeff,))
    return replace(coefficients, coeffs_khwc=coeffs, surface=surface, **others)


def _arranged(surface: Surface, order: VertexOrder, grid: tuple[int, int] | None) -> Surface:
    """Return the surface with its vertices in this order, and faces that name them."""
    held: dict[str, Any] = {
        name: None if value is None else order.apply(value)
        for name in ("vertices_v3", "normals_v3", "tangents_v3", "albedo_vc", "texture_v2")
        for value in (getattr(surface, name),)
    }
    faces_f3 = order.places()[surface.faces_f3].astype(np.int32)
    return replace(surface, faces_f3=faces_f3, grid=grid, **held)


def _graph_order(surface: Surface) -> NDArray[np.int64]:
    edges_e2 = np.concatenate([surface.faces_f3[:, [0, 1]], surface.faces_f3[:, [1, 2]], surface.faces_f3[:, [2, 0]]])
    ones = np.ones(len(edges_e2), bool)
    graph = scipy.sparse.csr_array((ones, edges_e2.T), shape=(surface.n_vertex, surface.n_vertex))
    graph = scipy.sparse.csr_array(graph + graph.T)
    return np.asarray(csgraph.reverse_cuthill_mckee(graph, symmetric_mode=True), np.int64)


def _to_hilbert(cells_v3: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return cells whose bits, interleaved, are places on a Hilbert curve (Skilling 2004), axis by axis."""
    x = cells_v3.copy()
    for bit in range(_BITS - 1, 0, -1):
        q, below = 1 << bit, (1 << bit) - 1
        for axis in range(3):
            there = (x[:, axis] & q) > 0
            swap = np.where(there, 0, (x[:, 0] ^ x[:, axis]) & below)
            x[:, 0] ^= np.where(there, below, swap)
            x[:, axis] ^= swap
    for axis in (1, 2):
        x[:, axis] ^= x[:, axis - 1]
    flip = np.zeros(len(x), np.int64)
    for bit in range(_BITS - 1, 0, -1):
        flip ^= np.where(x[:, 2] & (1 << bit), (1 << bit) - 1, 0)
    return x ^ flip[:, None]
