"""Cameras: where the eye is, where it looks, and the ray of each point of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.errors import InputError
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.surface import Surface

FIELD_OF_VIEW = 30.0
"""Degrees from the lower to the upper edge of the picture, where nobody says otherwise."""

DIRECTION = (1.0, -2.0, 1.0)
"""From the middle of the surface to the eye, where nobody says otherwise: from the right, the front and above."""

UP = (0.0, 0.0, 1.0)
MAX_SIDE = 1 << 14
_MARGIN = 1.04
_ALONG = 1e-6


@dataclass(frozen=True)
class Camera:
    """A view with square pixels; checked when made.

    Attributes
    ----------
    eye_3, target_3 : array_like of 3 floats
        Where it stands, and what lies in the middle of the picture, in units of the positions.
    up_3 : array_like of 3 floats
        What points upwards in the picture; not along the view.
    field_of_view : float
        Degrees from the lower to the upper edge, above 0 and below 180.
    height : float, optional
        Where given the view is orthographic, and the picture so high in units of the positions.
    """

    eye_3: ArrayLike
    target_3: ArrayLike = (0.0, 0.0, 0.0)
    up_3: ArrayLike = UP
    field_of_view: float = FIELD_OF_VIEW
    height: float | None = None

    def __post_init__(self) -> None:
        for label in ("eye", "target", "up"):
            value = np.asarray(getattr(self, f"{label}_3"), np.float64)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise InputError(
                    f"the camera's {label} must be three finite numbers, got {getattr(self, f'{label}_3')}"
                )
            object.__setattr__(self, f"{label}_3", tuple(float(v) for v in value))
        if not 0.0 < self.field_of_view < 180.0:
            raise InputError(f"a field of view is above 0 and below 180 degrees, got {self.field_of_view:g}")
        if self.height is not None and not 0.0 < self.height < np.inf:
            raise InputError(f"the height of an orthographic view must be a finite number above 0, got {self.height:g}")
        view_3 = np.subtract(self.target_3, self.eye_3)
        if not view_3.any():
            raise InputError(f"the camera stands where it looks: eye and target are both {_text(self.eye_3)}")
        unit_3, up_3 = _unit(view_3, "a camera's view"), _unit(self.up_3, "what is up for a camera")
        if float(np.linalg.norm(np.cross(unit_3, up_3))) <= _ALONG:
            raise InputError(
                f"up must not point along the view: the camera looks along {_text(view_3)}, up is the same"
            )

    def axes(self) -> NDArray[np.float64]:
        """Return the directions right, up and forward as rows, (3, 3)."""
        forward_3 = _unit(np.subtract(self.target_3, self.eye_3), "a camera's view")
        right_3 = np.cross(forward_3, _unit(self.up_3, "what is up for a camera"))
        right_3 /= np.linalg.norm(right_3)
        return np.stack([right_3, np.cross(right_3, forward_3), forward_3])

    def rays(
        self, x_s: NDArray[np.float64], y_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return origins and unit directions of points of the picture, each (n, 3).

        `x_s` and `y_s` are measured from the middle to the right and upwards, in heights of the picture: y is -1/2 at
        its lower edge and 1/2 at the upper one.
        """
        right_3, up_3, forward_3 = self.axes()
        eye_3 = np.asarray(self.eye_3)
        if self.height is not None:
            origins_s3 = eye_3 + self.height * (x_s[:, None] * right_3 + y_s[:, None] * up_3)
            return origins_s3, np.broadcast_to(forward_3, origins_s3.shape)
        scale = 2.0 * np.tan(np.radians(self.field_of_view) / 2.0)
        directions_s3 = forward_3 + scale * (x_s[:, None] * right_3 + y_s[:, None] * up_3)
        directions_s3 /= np.linalg.norm(directions_s3, axis=1, keepdims=True)
        return np.broadcast_to(eye_3, directions_s3.shape), directions_s3

    def towards(self, points_v3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return unit vectors from points to the eye, (n, 3)."""
        if self.height is not None:
            return np.broadcast_to(-self.axes()[2], points_v3.shape)
        away_v3 = np.asarray(self.eye_3) - points_v3
        length_v = np.linalg.norm(away_v3, axis=1, keepdims=True)
        return away_v3 / np.where(length_v > 0.0, length_v, 1.0)

    def turned(self, degrees: float, axis_3: Sequence[float], about_3: NDArray[np.float64]) -> Camera:
        """Return the camera after a turn about an axis through a point, counterclockwise seen from the axis's tip."""
        turn = rotation_matrix("axis", (*axis_3, degrees))
        eye_3, target_3 = (turn @ np.subtract(place, about_3) + about_3 for place in (self.eye_3, self.target_3))
        return Camera(eye_3, target_3, turn @ np.asarray(self.up_3), self.field_of_view, self.height)


@dataclass(frozen=True)
class Framing:
    """How a camera is wanted; what is None is found from the surface.

    Attributes
    ----------
    eye_3 : sequence of 3 floats, optional
        Where it stands; default: where it sees the whole surface.
    target_3 : sequence of 3 floats, optional
        With `eye_3`: what it looks at; default: the middle of the surface's box.
    direction_3 : sequence of 3 floats, optional
        Without `eye_3`: from the surface to the eye; default `DIRECTION`.
    up_3 : sequence of 3 floats
    field_of_view : float
    orthographic : bool
        With `eye_3` the height of the picture is what a perspective view would show at the target.
    """

    eye_3: Sequence[float] | None = None
    target_3: Sequence[float] | None = None
    direction_3: Sequence[float] | None = None
    up_3: Sequence[float] = UP
    field_of_view: float = FIELD_OF_VIEW
    orthographic: bool = False

    def place(self, surface: Surface, *, aspect: float = 1.0, turning: bool = False) -> Camera:
        """Return the camera; InputError where what is wanted cannot be."""
        if self.eye_3 is None:
            if self.target_3 is not None:
                raise InputError("a target goes with an eye: the automatic camera looks at the middle of the surface")
            return frame_surface(
                surface,
                DIRECTION if self.direction_3 is None else self.direction_3,
                up=self.up_3,
                field_of_view=self.field_of_view,
                orthographic=self.orthographic,
                aspect=aspect,
                turning=turning,
            )
        if self.direction_3 is not None:
            raise InputError("give where the camera stands, or from which direction it looks, not both")
        target_3 = middle_of(surface) if self.target_3 is None else self.target_3
        camera = Camera(self.eye_3, target_3, self.up_3, self.field_of_view)
        if not self.orthographic:
            return camera
        distance = float(np.linalg.norm(np.subtract(self.eye_3, target_3)))
        return replace(camera, height=2.0 * distance * float(np.tan(np.radians(self.field_of_view) / 2.0)))


def frame_surface(
    surface: Surface,
    direction: Sequence[float] = DIRECTION,
    *,
    up: Sequence[float] = UP,
    field_of_view: float = FIELD_OF_VIEW,
    orthographic: bool = False,
    aspect: float = 1.0,
    turning: bool = False,
) -> Camera:
    """Return the nearest camera in a direction that sees a whole surface, its outline in the middle of the picture.

    Parameters
    ----------
    surface : Surface
    direction : sequence of 3 floats
        From the surface to the eye, of any length but 0.
    up : sequence of 3 floats
        Upwards in the picture. Where it lies along the direction, y takes its place (x, where that does too).
    field_of_view : float
        Degrees from the lower to the upper edge.
    orthographic : bool
    aspect : float
        Width of the picture over its height.
    turning : bool
        See it whole while it turns about `up` through the middle of its box.
    """
    away_3, up_3 = _unit(direction, "a camera's direction"), _unit(up, "what is up for a camera")
    points_n3 = _swept(surface, up_3) if turning else surface.vertices_v3
    upward = next(v for v in (up_3, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)) if _differ(away_3, v))
    middle_3 = middle_of(surface)
    axes = Camera(away_3, (0.0, 0.0, 0.0), upward, field_of_view).axes()  # by itself: beside a far middle 1 is nothing
    right_n, up_n, forward_n = axes @ (points_n3 - middle_3).T
    radius = surface.diagonal or 1.0
    slope = 0.0 if orthographic else float(np.tan(np.radians(field_of_view) / 2.0)) / _MARGIN
    # The planes of the picture's edges touch the points: each is a distance that it needs, sideways and away.
    shift_a, reach_a = np.zeros(3), []
    for axis, (side_n, wide) in enumerate(((right_n, aspect), (up_n, 1.0))):
        high, low = np.max(side_n - wide * slope * forward_n), np.max(-side_n - wide * slope * forward_n)
        shift_a[axis] = 0.5 * (high - low)
        reach_a.append(0.5 * (high + low) / wide)
    target_3 = middle_3 + shift_a @ axes
    if orthographic:
        height = 2.0 * _MARGIN * float(max(reach_a)) or radius
        return Camera(target_3 + radius * away_3, target_3, upward, field_of_view, height)
    distance = max(float(max(reach_a)) / slope, 1e-3 * radius - float(forward_n.min()))
    return Camera(target_3 + distance * away_3, target_3, upward, field_of_view)


def middle_of(surface: Surface) -> NDArray[np.float64]:
    """Return the middle of the box around a surface, (3,)."""
    return 0.5 * (surface.vertices_v3.min(axis=0) + surface.vertices_v3.max(axis=0))


def _unit(vector: ArrayLike, what: str) -> NDArray[np.float64]:
    """Return a vector of any length but 0 as a unit vector: also those whose squares float64 does not hold."""
    held_3 = np.asarray(vector, np.float64)
    if held_3.shape != (3,) or not np.isfinite(held_3).all() or not held_3.any():
        raise InputError(f"{what} is three finite numbers that are not all zero, got {_text(vector)}")
    scaled_3 = held_3 / np.abs(held_3).max()
    unit_3: NDArray[np.float64] = scaled_3 / np.linalg.norm(scaled_3)
    return unit_3


def _swept(surface: Surface, axis_3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points around the cylinder that a surface fills as it turns about a direction."""
    middle_3 = middle_of(surface)
    offset_v3 = surface.vertices_v3 - middle_3
    along_v = offset_v3 @ axis_3
    radius = float(np.sqrt(np.max(np.sum(offset_v3**2, axis=1) - along_v**2).clip(0.0)))
    across_3 = np.cross(axis_3, np.eye(3)[np.argmin(np.abs(axis_3))])
    across_3 /= np.linalg.norm(across_3) or 1.0
    angle_n = np.linspace(0.0, 2.0 * np.pi, 65)[:, None]
    circle_n3 = radius * (np.cos(angle_n) * across_3 + np.sin(angle_n) * np.cross(axis_3, across_3))
    return np.concatenate([middle_3 + circle_n3 + along * axis_3 for along in (along_v.min(), along_v.max())])


def _differ(away_3: NDArray[np.float64], up: ArrayLike) -> bool:
    return float(np.linalg.norm(np.cross(away_3, np.asarray(up)))) > 1e-3


def picture_size(size: int | Sequence[int]) -> tuple[int, int]:
    """Return width and height of a picture, one number being both; InputError where it is no size."""
    sides = np.atleast_1d(np.asarray(size))
    if (
        sides.dtype.kind not in "iu"
        or sides.shape not in ((1,), (2,))
        or not ((sides >= 1) & (sides <= MAX_SIDE)).all()
    ):
        raise InputError(f"a picture's size is one or two whole numbers from 1 to {MAX_SIDE}, got {size}")
    return int(sides[0]), int(sides[-1])


def _text(numbers: ArrayLike) -> str:
    return ", ".join(f"{v:g}" for v in np.ravel(numbers))
