"""Lights near a surface, seen from each vertex: points, spheres and polygons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degrees_of_coefficients
from clrelight.harmonics.polygon import polygon_coefficients
from clrelight.harmonics.zonal import axis_factors, cap_kernels
from clrelight.lighting.lamps import WHITE, checked_colour
from clrelight.transfer.lit_functions import Functions
from clrelight.transfer.sources import set_vector, tint

_FLAT = 1e-4
"""Corners of a polygon lie in a plane to this part of its size."""


@dataclass(frozen=True)
class PointLight:
    """A small lamp; what faces it at distance r receives the irradiance ``intensity / r**2``.

    Attributes
    ----------
    position_3 : sequence of 3 floats
        In units of the positions.
    intensity : sequence of 1 or 3 floats
        Radiance times area: not negative.
    """

    position_3: Sequence[float]
    intensity: Sequence[float] = WHITE
    is_distant = False

    def __post_init__(self) -> None:
        set_vector(self, "position_3", "the position of a point light")
        checked_colour(self.intensity)

    def shade(self, functions: Functions) -> NDArray[np.float64]:
        """See `Source`: the functions in the direction to the lamp (noise-resistant-fitting, eq. 6)."""
        way_n3 = np.asarray(self.position_3) - functions.points_n3
        distance_n1 = np.linalg.norm(way_n3, axis=1, keepdims=True)
        if not np.all(distance_n1 > 0.0):
            raise InputError(f"the point light at {_text(self.position_3)} lies on the surface: move it off")
        return tint(functions.evaluate(way_n3 / distance_n1) / distance_n1**2, checked_colour(self.intensity))


@dataclass(frozen=True)
class SphereLight:
    """A ball that shines; a vertex sees it as a round light, one within it sees light everywhere.

    Attributes
    ----------
    centre_3 : sequence of 3 floats
    radius : float
        Above 0, both in units of the positions.
    radiance : sequence of 1 or 3 floats
        Not negative.
    """

    centre_3: Sequence[float]
    radius: float
    radiance: Sequence[float] = WHITE
    is_distant = False

    def __post_init__(self) -> None:
        set_vector(self, "centre_3", "the centre of a sphere")
        if not 0.0 < self.radius < np.inf:
            raise InputError(f"the radius of a sphere must be a finite number above 0, got {self.radius:g}")
        checked_colour(self.radiance)

    def shade(self, functions: Functions) -> NDArray[np.float64]:
        """See `Source`: the functions times the cap that each sees (spherical-harmonic-lighting, synth_light)."""
        way_n3 = np.asarray(self.centre_3) - functions.points_n3
        distance_n = np.linalg.norm(way_n3, axis=1)
        share_n = np.divide(self.radius, distance_n, out=np.ones_like(distance_n), where=distance_n > self.radius)
        angle_n = np.where(distance_n > self.radius, np.arcsin(share_n), np.pi)
        safe_n1 = np.where(distance_n > 0.0, distance_n, 1.0)[:, None]
        direction_n3 = np.where(distance_n[:, None] > 0.0, way_n3 / safe_n1, (0.0, 0.0, 1.0))
        degree = functions.light_degree
        factors_nl = axis_factors(degree) * cap_kernels(angle_n, degree)
        basis_nk = evaluate_basis(functions.local(direction_n3), degree)
        light_nk = factors_nl[:, degrees_of_coefficients(degree)] * basis_nk
        return tint(functions.receive(light_nk[..., None]), checked_colour(self.radiance))


@dataclass(frozen=True)
class PolygonLight:
    """A flat polygon that shines; each vertex has its exact projection on the basis.

    Attributes
    ----------
    corners_n3 : array_like, shape (3 or more, 3)
        In a plane, in units of the positions, counterclockwise seen from the side that shines.
    radiance : sequence of 1 or 3 floats
        Not negative.
    two_sided : bool
        Shine to both sides.
    """

    corners_n3: ArrayLike
    radiance: Sequence[float] = WHITE
    two_sided: bool = False
    is_distant = False

    def __post_init__(self) -> None:
        corners_n3 = np.asarray(self.corners_n3, np.float64)
        if corners_n3.ndim != 2 or corners_n3.shape[1] != 3 or len(corners_n3) < 3 or not np.isfinite(corners_n3).all():
            raise InputError(f"a polygon has 3 or more corners of three finite numbers, got {self.corners_n3!r}")
        normal_3 = _area_vector(corners_n3)
        size = float(np.linalg.norm(np.ptp(corners_n3, axis=0)))
        area = float(np.linalg.norm(normal_3))
        if not area > 1e-12 * size * size:
            raise InputError("the corners of a polygon lie on a line: it has no area")
        off = np.abs((corners_n3 - corners_n3.mean(axis=0)) @ (normal_3 / area)).max()
        if off > _FLAT * size:
            raise InputError(f"the corners of a polygon must lie in a plane, one is {off:.3g} off it")
        checked_colour(self.radiance)
        object.__setattr__(self, "corners_n3", corners_n3)

    def shade(self, functions: Functions) -> NDArray[np.float64]:
        """See `Source`."""
        corners_j3 = np.asarray(self.corners_n3)
        ways_nj3 = corners_j3 - functions.points_n3[:, None]
        if np.any(np.all(ways_nj3 == 0.0, axis=2)):
            raise InputError("a corner of a polygon light lies on the surface: move it off")
        height_n = -(functions.points_n3 - corners_j3.mean(axis=0)) @ _area_vector(corners_j3)
        light_nk = polygon_coefficients(functions.local(ways_nj3), functions.light_degree)
        light_nk *= np.sign(light_nk[:, :1])
        shines_n = (height_n != 0.0) if self.two_sided else (height_n < 0.0)
        light_nk = np.where(shines_n[:, None], light_nk, 0.0)
        return tint(functions.receive(light_nk[..., None]), checked_colour(self.radiance))


def _area_vector(corners_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the normal of a polygon, of its area's length."""
    offset_n3 = corners_n3 - corners_n3[0]
    return 0.5 * np.cross(offset_n3[1:-1], offset_n3[2:]).sum(axis=0)


def _text(numbers: Sequence[float]) -> str:
    return ", ".join(f"{v:g}" for v in numbers)
