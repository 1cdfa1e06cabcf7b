"""What figures of reflection maps are made of: a light and its truth, spheres, earlier methods, errors, labels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.harmonics.latlong import latitude_weights, synthesize_latlong
from clrelight.lighting.environment import Environment, read_environment
from clrelight.lighting.light import Light
from clrelight.lighting.lookup import look_up as look_up_environment
from clrelight.lighting.projection import project_environment
from clrelight.lighting.relighting import automatic_exposure, map_tones
from clrelight.relight import to_display
from clrelight.shrm.angular import integrate_directions
from clrelight.shrm.explicit import icosahedron, view_map, view_texture
from clrelight.shrm.lookup import look_up, render_sphere, view_sphere
from clrelight.shrm.painting import Mesh, own_views
from clrelight.shrm.prefilter import build_shrm
from clrelight.shrm.record import Shrm, grid_directions
from clrelight.shrm.zonal import build_zonal
from clrelight.transfer.cameras import Camera
from clrelight.transfer.painting import Picture, put_on

_ROWS = 64
"""Of the light's map: what degree 31 holds, as in the paper's figures, whose F is 30."""

_PICKED = 400


def paints(data: Path) -> dict[str, Path]:
    """Return the measured files by their names as people say them."""
    return {file.stem.replace("_", " ").capitalize(): file for file in sorted((data / "brdf").glob("*.brdf"))}


@dataclass
class Stage:
    """A light, as a map of `_ROWS` rows without what that cannot hold; checked against integration over its texels."""

    whole: Environment
    light: Light

    @classmethod
    def of(cls, probe: Path, axes: str) -> Stage:
        """Return the stage of a probe."""
        whole, _ = read_environment(probe, axes=axes)
        return cls(whole, project_environment(whole, _ROWS // 2 - 1))

    @classmethod
    def grace(cls, data: Path) -> Stage:
        """Return that of Grace Cathedral."""
        return cls.of(data / "probes" / "grace_latlong.exr", "right,forward,down")

    @cached_property
    def texels(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Directions, and radiance times solid angle, of the light's map."""
        map_hwc = synthesize_latlong(self.light.coeffs_kc, _ROWS, _ROWS)
        weights_t = np.repeat(latitude_weights(_ROWS) * (2.0 * np.pi / _ROWS), _ROWS)
        return grid_directions(_ROWS, _ROWS).reshape(-1, 3), weights_t[:, None] * map_hwc.reshape(_ROWS * _ROWS, -1)

    def shrm(self, brdf: CentredBrdf, degree: int, order: int) -> Shrm:
        """Return the reflection map, 4 F rows; of fibres a zonal one."""
        rho = brdf_coefficients(brdf, degree, order)
        if brdf.has_azimuth or brdf.is_radial:
            return build_shrm(self.light, rho, 4 * degree, frame="global", dtype=np.float32)
        return build_zonal(self.light, rho, 4 * degree, dtype=np.float32)

    def sphere(self, shrm: Shrm, view: tuple[float, float, float], size: int) -> NDArray[np.float32]:
        """Return a sphere's picture."""
        return render_sphere(shrm, view_sphere(size, np.asarray(view), shrm.centre)).astype(np.float32)

    def truth(self, brdf: CentredBrdf, view: tuple[float, float, float], size: int) -> NDArray[np.float32]:
        """Return a sphere's picture by integration over all angles for every pixel."""
        sphere = view_sphere(size, np.asarray(view), brdf.centre)
        return sphere.picture(self._integrate(brdf, sphere.central_n3, sphere.view_3)).astype(np.float32)

    def _integrate(
        self, brdf: CentredBrdf, central_n3: NDArray[np.float64], views: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        return integrate_directions(*self.texels, brdf, central_n3, views)

    def texture(
        self, brdf: CentredBrdf, view: tuple[float, float, float], size: int, count: int
    ) -> NDArray[np.float32]:
        """Return a sphere's picture by Kautz and McCool's 3-D texture of some angles, linearly between them."""
        sphere = view_sphere(size, np.asarray(view), brdf.centre)
        zonal = build_zonal(self.light, brdf_coefficients(brdf, 30, 12 if brdf.has_azimuth else 32), 90)
        texture_thwc = view_texture(zonal, np.linspace(0.0, np.pi, count))
        cosine_n = np.clip(sphere.central_n3 @ sphere.view_3, -1.0, 1.0)
        place_n = np.arccos(cosine_n) / np.pi * (count - 1)
        lower_n = np.minimum(place_n.astype(np.intp), count - 2)
        values_nc = np.zeros((len(place_n), zonal.channels))
        for t in range(count - 1):
            here_n = lower_n == t
            if here_n.any():
                share_n1 = (place_n[here_n] - t)[:, None]
                ends = [look_up(texture_thwc[t + step], sphere.central_n3[here_n]) for step in (0, 1)]
                values_nc[here_n] = (1.0 - share_n1) * ends[0] + share_n1 * ends[1]
        return sphere.picture(values_nc).astype(np.float32)

    def icosahedron(self, brdf: CentredBrdf, view: tuple[float, float, float], size: int) -> NDArray[np.float32]:
        """Return a sphere's picture by Cabral's maps: integrated for the corners of the view's face, and weighed."""
        sphere = view_sphere(size, np.asarray(view), brdf.centre)
        vertices, faces = icosahedron()
        weights_f3 = np.stack([np.linalg.solve(vertices[face].T, sphere.view_3) for face in faces])
        face = int(np.argmax(weights_f3.min(axis=1)))
        weights = np.maximum(weights_f3[face], 0.0)
        maps = [self._integrate(brdf, sphere.central_n3, vertices[corner]) for corner in faces[face]]
        mixed_nc = sum(weight * each for weight, each in zip(weights / weights.sum(), maps, strict=True))
        return sphere.picture(np.asarray(mixed_nc)).astype(np.float32)

    def errors_at(self, mesh: Mesh, camera: Camera, shrm: Shrm, brdf: CentredBrdf) -> tuple[float, float]:
        """Return relative RMS errors at some points of a mesh's picture, beside integration for each one's own view.

        Of one dynamic map for the picture's middle, and of coefficients for each point's view.
        """
        seen = mesh.see(camera, (0, mesh.size[1]), shrm.centre)
        chosen = np.random.default_rng(0).choice(len(seen.central_s3), _PICKED, replace=False)
        central_n3, towards_n3 = seen.central_s3[chosen], seen.towards_s3[chosen]
        truth_nc = self._integrate(brdf, central_n3, towards_n3)
        distant_nc = look_up(view_map(shrm, -camera.axes()[2]), central_n3)
        return relative([distant_nc], [truth_nc]), relative([own_views(shrm, central_n3, towards_n3)], [truth_nc])

    def behind(self, picture: Picture, camera: Camera) -> NDArray[np.float32]:
        """Return a mesh's picture before its environment."""
        return put_on(picture, lambda directions_n3: look_up_environment(self.whole, directions_n3), camera)


@dataclass(frozen=True)
class Shown:
    """A picture of linear radiance, what stands below it, and the picture whose exposure it has, if not its own."""

    picture_hwc: NDArray[np.float32]
    name: str
    error: float | None = None
    like_hwc: NDArray[np.float32] | None = None
    is_difference: bool = False

    def label(self) -> str:
        """Return the line below it."""
        return self.name if self.error is None else f"{self.name}: {self.error:.3f}"

    def display(self) -> NDArray[np.uint8]:
        """Return display values; differences, which are exposed already, are not mapped."""
        if self.is_difference:
            return to_display(self.picture_hwc, "srgb")
        of = self.picture_hwc if self.like_hwc is None else self.like_hwc
        scaled = np.float32(2.0 ** automatic_exposure(of)) * self.picture_hwc
        return to_display(map_tones(np.maximum(scaled, 0.0), "reinhard"), "srgb")


def difference(found_hwc: NDArray, truth_hwc: NDArray) -> NDArray[np.float32]:
    """Return the absolute difference at the truth's exposure, not amplified."""
    return (np.float32(2.0 ** automatic_exposure(truth_hwc)) * np.abs(found_hwc - truth_hwc)).astype(np.float32)


def relative(found: list[NDArray], truth: list[NDArray]) -> float:
    """Return the RMS error of pictures as a part of the truth's RMS."""
    off = sum(float(np.sum((a.astype(np.float64) - b) ** 2)) for a, b in zip(found, truth, strict=True))
    return float(np.sqrt(off / sum(float(np.sum(b.astype(np.float64) ** 2)) for b in truth)))
