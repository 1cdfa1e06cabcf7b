"""A sphere in a picture: the normals that its pixels show, and the light that each of them mirrors to the eye."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.variation.circles import Circle

_LIMB = 1e-6


@dataclass(frozen=True)
class SphereView:
    """How a sphere is seen: from afar, or by a camera of known focal length.

    Attributes
    ----------
    circle : Circle
        Its outline.
    focal : float, optional
        In pixels; without it rays are parallel.
    middle_xy : (float, float)
        Where the camera's axis meets the picture.
    axis_3 : ndarray, shape (3,), float64
        Unit vector from the camera to the sphere's centre (0, 0, -1 where rays are parallel).
    sine : float
        Of half the angle that the sphere fills.
    """

    circle: Circle
    focal: float | None
    middle_xy: tuple[float, float]
    axis_3: NDArray[np.float64]
    sine: float

    def rays(self, x_p: NDArray[np.floating], y_p: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return unit vectors from the camera through places of the picture, (P, 3): x right, y up, z to the camera."""
        if self.focal is None:
            return np.broadcast_to(np.array([0.0, 0.0, -1.0]), (len(x_p), 3))
        return _rays(x_p, y_p, self.focal, self.middle_xy)

    def normals(self, x_p: NDArray[np.floating], y_p: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the sphere's unit normals at places of the picture, (P, 3); 0 beside it."""
        if self.focal is None:
            u_p, v_p = (x_p - self.circle.x) / self.circle.radius, (self.circle.y - y_p) / self.circle.radius
            depth_p = 1.0 - u_p * u_p - v_p * v_p
            normals_p3 = np.stack([u_p, v_p, np.sqrt(np.maximum(depth_p, 0.0))], axis=1)
            return np.where((depth_p > _LIMB)[:, None], normals_p3, 0.0)
        # The sphere has radius 1 and its centre at axis / sine: |t q - centre| = 1 at the nearer root.
        rays_p3, distance = self.rays(x_p, y_p), 1.0 / self.sine
        along_p = distance * (rays_p3 @ self.axis_3)
        depth_p = along_p * along_p - distance * distance + 1.0
        near_p = along_p - np.sqrt(np.maximum(depth_p, 0.0))
        normals_p3 = near_p[:, None] * rays_p3 - distance * self.axis_3
        return np.where((depth_p > _LIMB)[:, None], normals_p3, 0.0)

    def mirrored(self, x_p: NDArray[np.floating], y_p: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return unit vectors to the lights that highlights at these places are of, (P, 3); 0 beside the sphere.

        ``l = q - 2 (q . n) n`` of the ray q that meets the sphere: the view mirrored in the normal, which alone is half
        way to the light.
        """
        normals_p3, rays_p3 = self.normals(x_p, y_p), self.rays(x_p, y_p)
        beside_p: NDArray[np.bool_] = ~np.any(normals_p3 != 0.0, axis=1)
        lights_p3 = rays_p3 - 2.0 * np.sum(rays_p3 * normals_p3, axis=1, keepdims=True) * normals_p3
        return np.where(beside_p[:, None], 0.0, lights_p3)

    def degrees_a_pixel(self, light_3: NDArray[np.float64]) -> float:
        """Return by how many degrees the light turns where its highlight, or the circle, is off by a pixel."""
        # Half way between light and eye; d(angle) = 2 d(place) / (radius cos).
        cosine = np.sqrt(max(0.5 * (1.0 - float(light_3 @ self.axis_3)), 1e-4))
        return float(np.degrees(2.0 / (self.circle.radius * cosine)))


def _rays(
    x_p: NDArray[np.floating], y_p: NDArray[np.floating], focal: float, middle_xy: tuple[float, float]
) -> NDArray[np.float64]:
    rays_p3 = np.stack([x_p - middle_xy[0], middle_xy[1] - y_p, np.full(len(x_p), -focal)], axis=1)
    return rays_p3 / np.linalg.norm(rays_p3, axis=1, keepdims=True)


def view_sphere(
    circle: Circle,
    shape_hw: tuple[int, int],
    focal: float | None = None,
    outline_n2: NDArray[np.float64] | None = None,
) -> SphereView:
    """Return how a sphere is seen whose outline is a circle, or some points where a camera's focal length is known.

    The rays of an outline form a cone, ``q . a = cos``: a plane through their ends, by least squares. In a picture the
    cone is an ellipse, of which the circle is what is left at the camera's axis.

    Parameters
    ----------
    circle : Circle
        In pixels of the picture.
    shape_hw : (int, int)
        Rows and columns of the picture, whose middle the camera's axis meets.
    focal : float, optional
        In pixels.
    outline_n2 : ndarray, shape (n, 2), optional
        x and y of its outline; the circle's own where there are fewer than eight.

    Raises
    ------
    InputError
        If the focal length is not positive, or the outline is no cone of it.
    """
    middle = (shape_hw[1] - 1) / 2.0, (shape_hw[0] - 1) / 2.0
    if focal is None:
        return SphereView(circle, None, middle, np.array([0.0, 0.0, -1.0]), 0.0)
    if not 0.0 < focal < np.inf:
        raise InputError(f"focal must be a positive number of pixels, got {focal:g}")
    if outline_n2 is None or len(outline_n2) < 8:
        angle_n = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        outline_n2 = np.stack(
            [circle.x + circle.radius * np.cos(angle_n), circle.y + circle.radius * np.sin(angle_n)], axis=1
        )
    rays_n3 = _rays(outline_n2[:, 0], outline_n2[:, 1], focal, middle)
    weight_n = np.ones(len(rays_n3))
    for _ in range(10):  # points of other edges count less
        scaled_3 = np.linalg.lstsq(rays_n3 * weight_n[:, None], weight_n, rcond=None)[0]
        off_n = np.abs(rays_n3 @ scaled_3 - 1.0)
        weight_n = 1.0 / np.sqrt(1.0 + (off_n / max(1.5 * float(np.median(off_n)), 1e-9)) ** 2)
    axis_3: NDArray[np.float64] = np.asarray(scaled_3, np.float64)
    length = float(np.linalg.norm(axis_3))
    if not 1.0 < length < 1.0 / _LIMB:  # beyond, it would fill half of all directions
        raise InputError(f"a sphere of radius {circle.radius:.4g} pixels is not seen at focal length {focal:g} pixels")
    return SphereView(circle, focal, middle, axis_3 * (1.0 / length), float(np.sqrt(1.0 - 1.0 / length**2)))


@dataclass(frozen=True)
class FlatView:
    """A camera's picture turned until its axis meets a sphere's centre: there the outline is a circle about (0, 0).

    Attributes
    ----------
    focal : float
        In pixels.
    middle_xy : (float, float)
        Where the camera's axis meets the picture.
    turn_33 : ndarray, shape (3, 3), float64
        Takes the ray through the sphere's centre to (0, 0, -1).
    radius : float
        Of the outline, in pixels.
    """

    focal: float
    middle_xy: tuple[float, float]
    turn_33: NDArray[np.float64]
    radius: float

    def there(self, x_p: NDArray[np.floating], y_p: NDArray[np.floating]) -> tuple[NDArray, NDArray]:
        """Return x and y of the turned picture at places of the picture."""
        rays_p3 = _rays(x_p, y_p, self.focal, self.middle_xy) @ self.turn_33.T
        scale_p = -self.focal / np.minimum(rays_p3[:, 2], -1e-6)
        return rays_p3[:, 0] * scale_p, -rays_p3[:, 1] * scale_p

    def back(self, x_p: NDArray[np.floating], y_p: NDArray[np.floating]) -> tuple[NDArray, NDArray]:
        """Return x and y of the picture at places of the turned one."""
        rays_p3 = _rays(x_p, y_p, self.focal, (0.0, 0.0)) @ self.turn_33
        scale_p = -self.focal / rays_p3[:, 2]
        return self.middle_xy[0] + rays_p3[:, 0] * scale_p, self.middle_xy[1] - rays_p3[:, 1] * scale_p


def flat_view(sphere: SphereView) -> FlatView:
    """Return the turned picture of a sphere that a camera of known focal length sees."""
    if sphere.focal is None:
        raise ValueError("a camera far away has no turned picture")
    z_3 = -sphere.axis_3
    x_3 = np.array([z_3[2], 0.0, -z_3[0]]) / np.hypot(z_3[0], z_3[2])
    tangent = sphere.sine / np.sqrt(1.0 - sphere.sine**2)
    return FlatView(sphere.focal, sphere.middle_xy, np.stack([x_3, np.cross(z_3, x_3), z_3]), sphere.focal * tangent)
