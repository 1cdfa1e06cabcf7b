"""Values of lat-long maps between texels, and pictures of spheres that look them up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.shrm.explicit import view_map
from clrelight.shrm.record import Shrm


def look_up(map_hwc: NDArray[np.floating], directions_n3: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return the bilinear values (n, channel) of a lat-long map at unit vectors.

    Beyond its first and last row a map goes on at the other side of the pole. What is smooth on the sphere may be
    looked up anywhere, as may maps of one distant view; coefficients of local maps, whose frames turn about the poles,
    may not.
    """
    height, width = map_hwc.shape[:2]
    place = np.arctan2(np.hypot(directions_n3[:, 0], directions_n3[:, 1]), directions_n3[:, 2]) / np.pi * height - 0.5
    azimuth = np.arctan2(directions_n3[:, 1], directions_n3[:, 0])
    along = (1.5 * np.pi - azimuth) / (2.0 * np.pi) * width - 0.5
    row, column = np.floor(place).astype(np.intp), np.floor(along).astype(np.intp)
    down, right = ((each - whole)[:, None].astype(map_hwc.dtype) for each, whole in ((place, row), (along, column)))
    upper, lower = (
        (1 - right) * map_hwc[_texel(row + step, column, height, width)]
        + right * map_hwc[_texel(row + step, column + 1, height, width)]
        for step in (0, 1)
    )
    return (1 - down) * upper + down * lower


def _texel(
    row: NDArray[np.intp], column: NDArray[np.intp], height: int, width: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of texels, beyond a pole those on its other side."""
    beyond = (row < 0) | (row >= height)
    inside = np.where(row < 0, -1 - row, np.where(row >= height, 2 * height - 1 - row, row))
    return inside, np.where(beyond, column + width // 2, column) % width


@dataclass(frozen=True)
class SphereView:
    """What a distant camera sees of a sphere that fills its square picture.

    Attributes
    ----------
    normals_n3, central_n3 : ndarray, shape (n, 3), float64
        Of the pixels on the sphere, in the world's axes: normals, and central directions for a reflectance.
    inside_hw : ndarray, shape (size, size), bool
        Which pixels are on the sphere, in the order of the others.
    view_3 : ndarray, shape (3,)
        Towards the camera.
    """

    normals_n3: NDArray[np.float64]
    central_n3: NDArray[np.float64]
    inside_hw: NDArray[np.bool_]
    view_3: NDArray[np.float64]

    def picture(self, values_nc: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return values of pixels on the sphere as a picture (size, size, channel), 0 around it."""
        picture_hwc = np.zeros((*self.inside_hw.shape, values_nc.shape[1]), values_nc.dtype)
        picture_hwc[self.inside_hw] = values_nc
        return picture_hwc


def view_sphere(size: int, view_3: NDArray[np.float64], centre: str = "reflection") -> SphereView:
    """Return what a distant camera in direction `view_3` sees of a sphere, with z up in the picture.

    The tangent of fibres is along meridians, from the lower pole to the upper one.
    """
    if size < 1:
        raise InputError(f"a picture has 1 pixel at least, got {size}")
    back = np.asarray(view_3, np.float64)
    length = np.linalg.norm(back)
    if back.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise InputError("a view is a direction x, y, z that is not 0")
    back = back / length
    upward = np.array([0.0, 0.0, 1.0]) if abs(back[2]) < 1.0 - 1e-9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(upward, back)
    right /= np.linalg.norm(right)
    along = 2.0 * (np.arange(size) + 0.5) / size - 1.0
    x_hw, y_hw = np.meshgrid(along, -along)
    square_hw = x_hw * x_hw + y_hw * y_hw
    inside_hw = square_hw < 1.0
    parts = x_hw[inside_hw], y_hw[inside_hw], np.sqrt(1.0 - square_hw[inside_hw])
    normals_n3 = np.stack(parts, axis=1) @ np.stack([right, np.cross(back, right), back])
    return SphereView(normals_n3, central_directions(normals_n3, back, centre), inside_hw, back)


def central_directions(
    normals_n3: NDArray[np.float64], view_3: NDArray[np.float64], centre: str
) -> NDArray[np.float64]:
    """Return central directions (n, 3) of normals: themselves, the view mirrored at them, or meridians' tangents."""
    if centre == "normal":
        return normals_n3
    if centre == "reflection":
        return 2.0 * (normals_n3 @ view_3)[:, None] * normals_n3 - view_3
    upward = np.array([0.0, 0.0, 1.0]) - normals_n3[:, 2:] * normals_n3
    length = np.linalg.norm(upward, axis=1, keepdims=True)
    return np.where(length > 1e-12, upward / np.maximum(length, 1e-12), np.array([1.0, 0.0, 0.0]))


def render_sphere(shrm: Shrm, sphere: SphereView, turn: NDArray[np.float64] | None = None) -> NDArray[np.floating]:
    """Return the sphere's picture (size, size, channel) by one dynamic map, under light turned by a rotation.

    By frequency-space-environment-maps, eq. 12.

    Light turned by R is what a view turned by its inverse sees: the map stays as it is.

    Parameters
    ----------
    shrm : Shrm
        Global or zonal.
    sphere : SphereView
        Of the map's own central direction.
    turn : ndarray, shape (3, 3), optional
        Rotation of the light.
    """
    back = np.eye(3) if turn is None else np.asarray(turn, np.float64)
    values_nc = look_up(view_map(shrm, sphere.view_3 @ back), sphere.central_n3 @ back)
    return sphere.picture(values_nc)


def local_view(shrm: Shrm, view_3: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return the map (height, width, channel) of a distant view of a local map.

    By frequency-space-environment-maps, eq. 3 and 6.
    """
    if shrm.frame != "local":
        return view_map(shrm, view_3)
    height, width, channel = shrm.maps_khwc.shape[1:]
    basis_nk = evaluate_basis(local_views(shrm, view_3).reshape(-1, 3), shrm.order)
    flat_knc = shrm.maps_khwc.reshape(len(shrm.maps_khwc), -1, channel)
    return np.einsum("nk,knc->nc", basis_nk, flat_knc, optimize=True).reshape(height, width, channel)


def local_views(shrm: Shrm, view_3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a view of the world in the frame ``Rz(beta) Ry(alpha)`` of each texel, (height, width, 3)."""
    alpha_h, beta_w = shrm.angles()
    x, y, z = np.asarray(view_3, np.float64)
    along_w = np.cos(beta_w) * x + np.sin(beta_w) * y
    across_w = np.cos(beta_w) * y - np.sin(beta_w) * x
    cosine_h1, sine_h1 = np.cos(alpha_h)[:, None], np.sin(alpha_h)[:, None]
    local_x = cosine_h1 * along_w - sine_h1 * z
    return np.stack([local_x, np.broadcast_to(across_w, local_x.shape), sine_h1 * along_w + cosine_h1 * z], axis=-1)
