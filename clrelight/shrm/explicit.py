"""Between reflection maps with coefficients and tables of radiance: maps of views, both ways, and earlier methods'."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.coefficients import theta_tables
from clrelight.errors import InputError, counted
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.shrm.record import Shrm
from clrelight.shrm.zonal import to_zonal, zonal_indices, zonal_view

_WORST_CONDITION = 1e8


def view_grid(count: int) -> NDArray[np.float64]:
    """Return count x count views in rings of equal steps of polar angle and azimuth, (count**2, 3) unit vectors.

    Every other ring is turned by half a step: else sines of count / 2 azimuths would be 0 at all of them.
    """
    row, step = np.divmod(np.arange(count * count), count)
    theta, phi = np.pi * (row + 0.5) / count, 2.0 * np.pi * (step + 0.5 * (row % 2)) / count
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)


def explicit_maps(shrm: Shrm, views_t3: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return a map of radiance for each view, (n_view, height, width, channel): O(P^2) a texel.

    Views are unit vectors in the frame of `shrm`: local ones differ from texel to texel in the world's.
    """
    basis_tk = evaluate_basis(views_t3, shrm.order).astype(shrm.maps_khwc.dtype)
    if shrm.frame == "zonal":
        basis_tk = basis_tk[:, zonal_indices(shrm.order)]
    flat_kx = shrm.maps_khwc.reshape(len(shrm.maps_khwc), -1)
    return (basis_tk @ flat_kx).reshape(len(views_t3), *shrm.maps_khwc.shape[1:])


def view_map(shrm: Shrm, view_3: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return the one dynamic map (height, width, channel) of a distant view; of a global or zonal map.

    By frequency-space-environment-maps, eq. 12.
    """
    if shrm.frame == "zonal":
        return zonal_view(shrm, view_3)
    if shrm.frame != "global":
        raise InputError("one map for a distant view needs a global reflection map, this one is local")
    return explicit_maps(shrm, np.asarray(view_3, np.float64)[None])[0]


def fit_maps(maps_thwc: NDArray[np.floating], views_t3: NDArray[np.float64], order: int, like: Shrm) -> Shrm:
    """Return the reflection map whose explicit maps come nearest to given ones, by least squares over the views.

    Parameters
    ----------
    maps_thwc : ndarray, shape (n_view, height, width, channel)
    views_t3 : ndarray, shape (n_view, 3)
        Unit vectors, in the frame of `like`.
    order : int
        P; the views must tell its coefficients apart.
    like : Shrm
        Whose frame, degree and labels the result has.
    """
    if len(maps_thwc) != len(views_t3):
        raise InputError(f"{len(maps_thwc)} maps need as many views, got {len(views_t3)}")
    basis_tk = evaluate_basis(views_t3, order)
    if len(views_t3) < coefficient_count(order) or np.linalg.cond(basis_tk) > _WORST_CONDITION:
        raise InputError(
            f"{counted(len(views_t3), 'view does', 'views do')} not tell the "
            f"{coefficient_count(order)} coefficients of order {order} apart"
        )
    flat_tx = maps_thwc.reshape(len(maps_thwc), -1)
    maps_kx = np.linalg.pinv(basis_tk).astype(flat_tx.dtype) @ flat_tx
    return replace(like, maps_khwc=maps_kx.reshape(-1, *maps_thwc.shape[1:]))


def without_azimuth(shrm: Shrm) -> Shrm:
    """Return a local reflection map with the coefficients of q = 0 alone: no view differs by its azimuth."""
    _want_local(shrm)
    if shrm.frame == "zonal":
        return shrm
    maps_khwc = np.zeros_like(shrm.maps_khwc)
    zonal = zonal_indices(shrm.order)
    maps_khwc[zonal] = shrm.maps_khwc[zonal]
    return replace(shrm, maps_khwc=maps_khwc)


def view_texture(shrm: Shrm, theta_o: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return Kautz and McCool's 3-D texture, (n_angle, height, width, channel), of a local reflection map.

    ``B(alpha, beta, theta_o) = sum_p B_p0(alpha, beta) f_p0(theta_o)`` (frequency-space-environment-maps, appendix C).
    """
    _want_local(shrm)
    table_pt = theta_tables(np.asarray(theta_o, np.float64), shrm.order)[0].astype(shrm.maps_khwc.dtype)
    return np.einsum("pt,phwc->thwc", table_pt, to_zonal(shrm).maps_khwc, optimize=True)


def interpolate_texture(
    texture_thwc: NDArray[np.floating], theta_o: NDArray[np.float64], angle_hw: NDArray[np.float64]
) -> NDArray[np.floating]:
    """Return the map (height, width, channel) of a 3-D texture at an angle ``theta_o`` for each texel, linearly."""
    place_hw = np.interp(angle_hw, theta_o, np.arange(len(theta_o)))
    lower_hw = np.minimum(place_hw.astype(np.intp), max(len(theta_o) - 2, 0))
    share_hw1 = (place_hw - lower_hw)[..., None].astype(texture_thwc.dtype)
    row, column = np.ogrid[: angle_hw.shape[0], : angle_hw.shape[1]]
    upper_hw = np.minimum(lower_hw + 1, len(theta_o) - 1)
    return (1 - share_hw1) * texture_thwc[lower_hw, row, column] + share_hw1 * texture_thwc[upper_hw, row, column]


@functools.lru_cache(maxsize=1)
def icosahedron() -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the vertices (12, 3), unit vectors, and the faces (20, 3) of an icosahedron."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = [(0.0, a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    vertices = np.array([np.roll(corner, turn) for corner in corners for turn in range(3)])
    apart = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    near = (apart > 0.0) & (apart < 2.0 + 1e-9)
    faces = [
        (i, j, k) for i in range(12) for j in range(i + 1, 12) for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]  # fmt: skip
    return vertices / np.sqrt(golden * golden + 1.0), np.array(faces)


def interpolate_icosahedron(maps_thwc: NDArray[np.floating], view_3: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return the map of a view between Cabral's twelve, (height, width, channel): those of its face's corners, weighed.

    Weights are those that combine the corners to a multiple of the view, scaled to a sum of 1.
    """
    vertices, faces = icosahedron()
    weights_f3 = np.stack([np.linalg.solve(vertices[face].T, view_3) for face in faces])
    face = int(np.argmax(weights_f3.min(axis=1)))  # the one face of which no weight is negative
    weights = np.maximum(weights_f3[face], 0.0)
    return np.tensordot((weights / weights.sum()).astype(maps_thwc.dtype), maps_thwc[faces[face]], axes=1)


def _want_local(shrm: Shrm) -> None:
    if shrm.frame == "global":
        raise InputError("views without an azimuth are those of a local reflection map, this one is global")
