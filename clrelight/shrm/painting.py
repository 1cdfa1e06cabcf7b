"""Pictures of spheres and meshes under a reflection map: one dynamic map a picture, or each pixel's own view."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.shrm.explicit import explicit_maps, view_map
from clrelight.shrm.lookup import central_directions, look_up, view_sphere
from clrelight.shrm.record import Shrm
from clrelight.shrm.zonal import zonal_weights
from clrelight.surface import Surface
from clrelight.transfer.cameras import Camera
from clrelight.transfer.painting import Picture
from clrelight.transfer.rays import RayScene
from clrelight.transfer.views import SUBSAMPLES, View, check_seen, look

VIEWS = ("distant", "pixel")
"""Whose coefficients of the view count: one for the whole picture, or each pixel's own.

By frequency-space-environment-maps, eq. 12 and 6.
"""

_BYTES_A_RAY = 240


class Subject(Protocol):
    """What is shown."""

    def paint(
        self, shrm: Shrm, camera: Camera, turn: NDArray[np.float64], map_hwc: NDArray[np.floating] | None = None
    ) -> Picture:
        """Return the picture under light turned by a rotation (3, 3); by a dynamic map that is there already."""
        ...


def distant_view(camera: Camera, turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the direction to a camera, (3,), in the axes of light turned by a rotation: that turns the view back."""
    return np.asarray(-camera.axes()[2] @ turn)


@dataclass
class Clock:
    """What dynamic maps took: seconds for each texel, batch by batch."""

    seconds: list[float] = field(default_factory=list)

    def sum_maps(self, shrm: Shrm, views_i3: NDArray[np.float64]) -> list[NDArray[np.floating]]:
        """Return the dynamic maps of views, timed; of a global map by one product.

        By frequency-space-environment-maps, eq. 12.
        """
        since = time.perf_counter()
        if shrm.frame == "global":
            maps = list(explicit_maps(shrm, views_i3))
        else:
            maps = [view_map(shrm, view_3) for view_3 in views_i3]
        texels = len(maps) * maps[0].shape[0] * maps[0].shape[1]
        self.seconds.append((time.perf_counter() - since) / texels)
        return maps

    def rate(self, texels: int) -> float:
        """Return how many maps of so many texels are summed a second, by the median."""
        return 1.0 / max(float(np.median(self.seconds)) * texels, 1e-12)


@dataclass
class Sphere:
    """A sphere that fills a square picture, seen from afar."""

    size: int
    clock: Clock = field(default_factory=Clock)

    def camera(self, view_3: NDArray[np.float64]) -> Camera:
        """Return the camera in a direction."""
        back_3 = view_sphere(1, view_3).view_3
        upward = (0.0, 0.0, 1.0) if abs(back_3[2]) < 1.0 - 1e-9 else (0.0, 1.0, 0.0)
        return Camera(back_3, (0.0, 0.0, 0.0), upward, height=2.0)

    def paint(
        self, shrm: Shrm, camera: Camera, turn: NDArray[np.float64], map_hwc: NDArray[np.floating] | None = None
    ) -> Picture:
        """See `Subject`."""
        sphere = view_sphere(self.size, np.asarray(camera.eye_3), shrm.centre)
        if map_hwc is None:
            map_hwc = self.clock.sum_maps(shrm, distant_view(camera, turn)[None])[0]
        values_nc = look_up(map_hwc, sphere.central_n3 @ turn)
        return Picture(sphere.picture(values_nc).astype(np.float32), sphere.inside_hw.astype(np.float32), 0.0)


@dataclass
class Mesh:
    """A mesh, seen by rays; normals and views of its points come from its vertices.

    Attributes
    ----------
    surface : Surface
        Its tangents, where it has any, are those of fibres; else these run along meridians.
    size : (int, int)
        Width and height of pictures.
    subsamples : int
        Rays of a pixel are its square.
    views : str
        One of `VIEWS`. Central directions are each pixel's own either way.
    memory : int
        Bytes that rays and their values take, about.
    """

    surface: Surface
    size: tuple[int, int]
    subsamples: int = SUBSAMPLES
    views: str = "distant"
    memory: int = 1 << 28
    clock: Clock = field(default_factory=Clock)
    _held: dict[object, Seen] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.views not in VIEWS:
            raise InputError(f"views must be one of {', '.join(VIEWS)}, got {self.views!r}")
        self._scene = RayScene(self.surface)
        self._rows = max(1, self.memory // (self.size[0] * self.subsamples**2 * _BYTES_A_RAY))

    def paint(
        self, shrm: Shrm, camera: Camera, turn: NDArray[np.float64], map_hwc: NDArray[np.floating] | None = None
    ) -> Picture:
        """See `Subject`."""
        if map_hwc is None and self.views == "distant":
            map_hwc = self.clock.sum_maps(shrm, distant_view(camera, turn)[None])[0]
        bands, coverage, behind, outside = [], [], [], False
        for first in range(0, self.size[1], self._rows):
            seen = self.see(camera, (first, min(first + self._rows, self.size[1])), shrm.centre)
            central_s3 = seen.central_s3 @ turn
            if map_hwc is None:
                values_sc = own_views(shrm, central_s3, seen.towards_s3 @ turn)
            else:
                values_sc = look_up(map_hwc, central_s3)
            bands.append(seen.view.average(values_sc))
            coverage.append(seen.view.coverage_hw)
            behind.append(seen.view.behind * seen.view.coverage_p.sum())
            outside |= len(seen.view.pixel_s) > 0
        coverage_hw = np.concatenate(coverage)
        check_seen(self.surface, bool(coverage_hw.any()), outside)
        return Picture(np.concatenate(bands), coverage_hw, float(np.sum(behind) / coverage_hw.sum()))

    def see(self, camera: Camera, rows: tuple[int, int], centre: str) -> Seen:
        """Return what is seen of a band; that of the whole picture is kept while the camera stands still."""
        key = (camera, rows, centre)
        if key in self._held:
            return self._held[key]
        view = look(self._scene, camera, self.size, subsamples=self.subsamples, rows=rows)
        towards_s3 = camera.towards(view.at_samples(self.surface.vertices_v3))
        normals_s3 = _unit(view.at_samples(self.surface.normals_v3))
        if centre == "tangent" and self.surface.tangents_v3 is not None:
            central_s3 = _unit(view.at_samples(self.surface.tangents_v3))
        elif centre == "reflection":
            along_s1 = np.einsum("sa,sa->s", normals_s3, towards_s3)[:, None]
            central_s3 = 2.0 * along_s1 * normals_s3 - towards_s3
        else:
            central_s3 = central_directions(normals_s3, towards_s3[:1], centre)
        seen = Seen(view, central_s3, towards_s3)
        self._held = {key: seen} if rows == (0, self.size[1]) else {}
        return seen


@dataclass(frozen=True)
class Seen:
    """What rays meet, and at each sample the central direction and the direction to the eye, (n_sample, 3)."""

    view: View
    central_s3: NDArray[np.float64]
    towards_s3: NDArray[np.float64]


def own_views(shrm: Shrm, central_s3: NDArray[np.float64], towards_s3: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return the radiance (n, channel) of points towards views of their own: O(P^2) lookups, zonal O(P)."""
    if shrm.frame == "zonal":
        weights_ks = zonal_weights(np.clip(np.einsum("sa,sa->s", central_s3, towards_s3), -1.0, 1.0), shrm.order)
    else:
        weights_ks = evaluate_basis(towards_s3, shrm.order).T
    total_sc = np.zeros((len(central_s3), shrm.channels), shrm.maps_khwc.dtype)
    for weight_s, map_hwc in zip(weights_ks.astype(total_sc.dtype), shrm.maps_khwc, strict=True):
        total_sc += weight_s[:, None] * look_up(map_hwc, central_s3)
    return total_sc


def _unit(vectors_s3: NDArray[np.float64]) -> NDArray[np.float64]:
    length_s1 = np.linalg.norm(vectors_s3, axis=1, keepdims=True)
    return vectors_s3 / np.where(length_s1 > 0.0, length_s1, 1.0)
