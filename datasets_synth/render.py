"""Ray tracing of tori on a ground plane under distant lights: what the eye sees once, then each light's radiance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.transfer.brdfs import ggx_facets
from datasets_synth.shapes import Torus, snap_to_torus, torus_triangles

GROUND = -1
"""Owner of samples on the ground; others belong to the torus of that index."""

SUBSAMPLES = 2
"""Each pixel is the mean of SUBSAMPLES x SUBSAMPLES samples, on a regular grid."""

# A torus of 0.7 outer radius is then at most 1e-4 away from its mesh. Shadow rays start on the exact surface, this
# much outside: clear of the mesh, and a fiftieth of a pixel of a 256 x 256 picture.
MESH_MAJOR, MESH_MINOR = 256, 128
SHADOW_OFFSET = 2e-4


@dataclass(frozen=True)
class Material:
    """Diffuse reflectance plus a GGX lobe.

    Attributes
    ----------
    diffuse, specular : tuple of float
        Linear RGB: Lambertian reflectance, and Fresnel reflectance at normal incidence.
    roughness : float
        GGX alpha.
    """

    diffuse: tuple[float, float, float]
    specular: tuple[float, float, float]
    roughness: float


@dataclass(frozen=True)
class Camera:
    """A perspective view with square pixels; `width` is the width of the picture at unit distance."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    width: float


@dataclass(frozen=True)
class Samples:
    """What the eye sees: one entry per subsample, those of one pixel together; arrays float32 unless said.

    Attributes
    ----------
    points_s3, normals_s3, views_s3 : ndarray, shape (n_sample, 3)
        Position, outward unit normal, unit vector towards the eye.
    owner_s : ndarray, shape (n_sample,), int32
        Index of the torus, or `GROUND`.
    """

    points_s3: NDArray[np.float32]
    normals_s3: NDArray[np.float32]
    views_s3: NDArray[np.float32]
    owner_s: NDArray[np.int32]


class TorusTracer:
    """Tori above the ground plane z = 0, ready for rays."""

    def __init__(self, tori: Sequence[Torus]) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError:
            raise InputError("the ring scene needs ray tracing: pip install 'clrelight[synth]'") from None
        self.tori = tuple(tori)
        self._scene: Any = EmbreeScene()
        triangles = [torus_triangles(torus, MESH_MAJOR, MESH_MINOR) for torus in self.tori]
        TriangleMesh(self._scene, np.concatenate(triangles))
        # The first query builds the tree; later ones may then come from several threads.
        self.occluded(np.zeros((1, 3), np.float32), np.array([0.0, 0.0, 1.0]))

    def see(self, camera: Camera, size: int, rows: range) -> Samples:
        """Trace the eye's rays through some rows of a size x size picture; every ray must meet the ground."""
        origin = np.array(camera.eye)
        rays_s3 = _eye_rays(camera, size, rows)
        hit = self._scene.run(
            np.broadcast_to(origin, rays_s3.shape).astype(np.float32), rays_s3.astype(np.float32), output=1
        )
        to_ground_s = -origin[2] / rays_s3[:, 2]
        on_torus_s = (hit["primID"] >= 0) & (hit["tfar"] < to_ground_s)
        owner_s = np.where(on_torus_s, hit["primID"] // (2 * MESH_MAJOR * MESH_MINOR), GROUND).astype(np.int32)
        points_s3 = origin + to_ground_s[:, None] * rays_s3
        points_s3[:, 2] = 0.0
        normals_s3 = np.zeros_like(points_s3)
        normals_s3[:, 2] = 1.0
        for index, torus in enumerate(self.tori):
            mine = np.flatnonzero(owner_s == index)
            seen_s3 = origin + hit["tfar"][mine, None] * rays_s3[mine]
            points_s3[mine], normals_s3[mine] = snap_to_torus(torus, seen_s3)
        single = np.float32
        return Samples(points_s3.astype(single), normals_s3.astype(single), -rays_s3.astype(single), owner_s)

    def occluded(self, origins_s3: NDArray[np.float32], direction_3: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which of the points have a torus in that direction."""
        directions_s3 = np.broadcast_to(direction_3.astype(np.float32), origins_s3.shape)
        return self._scene.run(origins_s3, np.ascontiguousarray(directions_s3), query="OCCLUDED") == 0

    def visible(self, samples: Samples, light_3: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which samples face a distant light and have no torus before it."""
        facing_s = cosines(samples.normals_s3, light_3) > 0
        rows = np.flatnonzero(facing_s)
        origins_s3 = samples.points_s3[rows] + np.float32(SHADOW_OFFSET) * samples.normals_s3[rows]
        facing_s[rows] = ~self.occluded(origins_s3, light_3)
        return facing_s


def _eye_rays(camera: Camera, size: int, rows: range) -> NDArray[np.float64]:
    forward = np.array(camera.target) - np.array(camera.eye)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    step = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES
    x_ws = camera.width * ((np.arange(size)[:, None] + step) / size - 0.5)
    y_hs = camera.width * (0.5 - (np.array(rows)[:, None] + step) / size)
    x, y = np.broadcast_arrays(x_ws[None, :, None, :], y_hs[:, None, :, None])
    rays_s3 = forward + x.reshape(-1, 1) * right + y.reshape(-1, 1) * up
    return rays_s3 / np.linalg.norm(rays_s3, axis=1, keepdims=True)


def cosines(vectors_s3: NDArray[np.float32], direction_3: NDArray) -> NDArray[np.float32]:
    """Return dot products summed in a fixed order, so that no BLAS changes a byte of the result."""
    x, y, z = direction_3.astype(np.float32)
    return vectors_s3[:, 0] * x + vectors_s3[:, 1] * y + vectors_s3[:, 2] * z


def reflect_ggx(
    normals_s3: NDArray[np.float32], views_s3: NDArray[np.float32], light_3: NDArray[np.float64], material: Material
) -> NDArray[np.float32]:
    """Return the BRDF of the GGX lobe (Walter et al. 2007) for samples that face both the light and the eye.

    ``D F G / (4 (n.l) (n.v))`` with Schlick's Fresnel term and the height-correlated Smith term (Heitz 2014,
    eq. 99); shape (n_sample, 3), in 1/sr.
    """
    half_s3 = views_s3 + light_3.astype(np.float32)
    half_s3 /= np.sqrt(np.sum(half_s3 * half_s3, axis=1, keepdims=True))
    n_l = np.maximum(cosines(normals_s3, light_3), 0.0)
    n_v = np.maximum(np.sum(normals_s3 * views_s3, axis=1), np.float32(1e-3))
    n_h = np.sum(normals_s3 * half_s3, axis=1)
    l_h = np.clip(cosines(half_s3, light_3), 0.0, 1.0)
    a2 = np.float32(material.roughness**2)
    smith, density = ggx_facets(n_l, n_v, n_h, a2)
    specular_3 = np.array(material.specular, dtype=np.float32)
    fresnel_s3 = specular_3 + (1 - specular_3) * ((1 - l_h) ** 5)[:, None]
    return (density * np.float32(0.5) / np.maximum(smith, np.float32(1e-6)))[:, None] * fresnel_s3


def shade_pixels(
    tracer: TorusTracer,
    samples: Samples,
    albedo_s3: NDArray[np.float32],
    materials: Sequence[Material],
    light_3: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return each pixel's radiance times pi under a distant light of unit irradiance at normal incidence.

    Parameters
    ----------
    tracer : TorusTracer
        What casts shadows.
    samples : Samples
        What the eye sees.
    albedo_s3 : ndarray, shape (n_sample, 3), float32
        Diffuse reflectance of each sample.
    materials : sequence of Material
        Material of each torus; the ground is Lambertian.
    light_3 : ndarray, shape (3,), float64
        Direction towards the light.

    Returns
    -------
    ndarray, shape (n_pixel, 3), float32
        Mean over each pixel's samples of ``pi f(l, v) max(0, n.l) V(l)``: a white Lambertian that faces the
        light is 1.
    """
    lit = np.flatnonzero(tracer.visible(samples, light_3))
    owner_s = samples.owner_s[lit]
    reflectance_s3 = albedo_s3[lit]
    for index, material in enumerate(materials):
        mine = np.flatnonzero(owner_s == index)
        rows = lit[mine]
        lobe_s3 = reflect_ggx(samples.normals_s3[rows], samples.views_s3[rows], light_3, material)
        reflectance_s3[mine] += np.float32(np.pi) * lobe_s3
    radiance_s3 = np.zeros_like(albedo_s3)
    radiance_s3[lit] = reflectance_s3 * cosines(samples.normals_s3[lit], light_3)[:, None]
    per_pixel = radiance_s3.reshape(-1, SUBSAMPLES**2, 3)
    return np.mean(per_pixel, axis=1, dtype=np.float32)
