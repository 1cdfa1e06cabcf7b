"""Raw functions of a surface's vertices: samples over directions, which fits take as they take photographs.

Two kinds (noise-resistant-fitting, sections II-B and III-A): what a vertex reflects of a distant light from each
direction (eq. 3 and 6, the torus), and what it sends to an eye in each direction under a light that stays (eq. 2, the
sculpture). Directions are in the vertices' own frames where the surface has tangents, so that all share one hemisphere.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import as_float64, check_directions
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.memory import PIECE_BYTES
from clrelight.surface import Surface
from clrelight.transfer.brdfs import Brdf
from clrelight.transfer.gathering import albedo_of
from clrelight.transfer.rays import RayScene

KINDS = ("unshadowed", "shadowed")
"""What `sample_transfer` takes into account."""

_RAY_BYTES = 64
"""Of one ray with all its temporaries."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class FixedLight:
    """A light that stays, as distant lights from many directions.

    Attributes
    ----------
    directions_l3 : ndarray, shape (n_light, 3), float64
        Unit vectors in the axes of the positions.
    irradiance_lc : ndarray, shape (n_light, 3), float64
        Radiance times solid angle of each: the irradiance at normal incidence.
    """

    directions_l3: NDArray[np.float64]
    irradiance_lc: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "directions_l3", as_float64(self.directions_l3, "directions"))
        object.__setattr__(self, "irradiance_lc", as_float64(self.irradiance_lc, "irradiance"))
        check_directions(self.directions_l3, None)
        if self.irradiance_lc.shape != (len(self.directions_l3), 3):
            raise InputError(
                f"irradiance must have shape ({len(self.directions_l3)}, 3), got {self.irradiance_lc.shape}"
            )
        if not (np.isfinite(self.irradiance_lc) & (self.irradiance_lc >= 0.0)).all():
            raise InputError("irradiance must be finite and not negative")


def sample_transfer(
    surface: Surface,
    directions_i3: NDArray[np.floating],
    kind: str = "shadowed",
    *,
    progress: Progress | None = None,
) -> LightStack:
    """Return what each vertex reflects of distant lights of unit irradiance at normal incidence, times pi.

    ``albedo max(0, n.s) V(s)``: the paper's ``rho max(0, s_z) V(s)`` (eq. 6), which is pi times the transfer function
    ``T(s) = (albedo / pi) max(0, n.s) V(s)``. A white vertex that faces the light is 1, the peak.

    Parameters
    ----------
    surface : Surface
        Its albedo counts; without, it is white and has one channel.
    directions_i3 : array_like, shape (n_light, 3)
        Unit vectors to the lights: in each vertex's own frame where the surface has tangents, else in the axes of
        the positions.
    kind : str
        One of `KINDS`: ``"unshadowed"`` leaves the visibility V out.
    progress : callable, optional
        Called as ``progress(vertices done, vertices in all)``.

    Returns
    -------
    LightStack
        ``images_ihwc`` of shape (n_light, *surface.map_shape, channel), float32.

    Raises
    ------
    InputError
        Bad directions, an unknown kind, a surface of functions of the view, or no package for rays.
    """
    if kind not in KINDS:
        raise InputError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
    if surface.argument != "light":
        raise InputError(f"{surface.name} carries functions of the view, not of the light")
    directions_i3 = as_float64(directions_i3, "directions")
    check_directions(directions_i3, None)
    scene = RayScene(surface) if kind == "shadowed" else None
    albedo_vc = albedo_of(surface)
    samples_ivc = np.empty((len(directions_i3), *albedo_vc.shape), np.float32)
    frames_v33 = surface.frames()

    def fill(vertices_v: NDArray[np.intp]) -> None:
        axes_v3i = np.swapaxes(frames_v33[vertices_v], 1, 2) @ directions_i3.T
        cosine_vi = np.einsum("va,vai->vi", surface.normals_v3[vertices_v], axes_v3i)
        lit_vi = cosine_vi > 0.0
        if scene is not None:
            rows_r, columns_r = np.nonzero(lit_vi)
            rays_r3 = axes_v3i[rows_r, :, columns_r].astype(np.float32)
            lit_vi[rows_r, columns_r] = ~scene.occluded(vertices_v[rows_r], rays_r3)
        value_iv = np.where(lit_vi, cosine_vi, 0.0).T
        samples_ivc[:, vertices_v] = np.minimum(value_iv, 1.0)[:, :, None] * albedo_vc[vertices_v]

    _in_tiles(fill, surface.n_vertex, len(directions_i3) * _RAY_BYTES, progress)
    return _stack_of(surface, samples_ivc, directions_i3)


def sample_views(
    surface: Surface,
    views_i3: NDArray[np.floating],
    light: FixedLight,
    brdf: Brdf,
    *,
    shadowed: bool = True,
    progress: Progress | None = None,
) -> LightStack:
    """Return the radiance that each vertex sends to eyes in many directions, under a light that stays (eq. 2).

    ``L(v) = sum over lights of E_l f(s_l, v) max(0, n.s_l) V(s_l)``, with one ray from each vertex to each light.

    Parameters
    ----------
    surface : Surface
        With tangents. Its albedo, where it has one, scales the matte part of the BRDF.
    views_i3 : array_like, shape (n_view, 3)
        Unit vectors to the eyes, in each vertex's own frame, z > 0.
    light : FixedLight
    brdf : Brdf
        f, see `clrelight.transfer.brdfs`.
    shadowed : bool
        Whether other parts of the surface stand in the way of the light.
    progress : callable, optional
        Called as ``progress(vertices done, vertices in all)``.

    Returns
    -------
    LightStack
        ``images_ihwc`` of shape (n_view, *surface.map_shape, 3), float32; peak 1. The surface's `argument` is
        ``"view"``.

    Raises
    ------
    InputError
        Bad directions, no tangents, or no package for rays.
    """
    if surface.tangents_v3 is None:
        raise InputError(f"radiance by view needs frames: {surface.name} has no tangents")
    views_i3 = as_float64(views_i3, "directions")
    check_directions(views_i3, None)
    if views_i3[:, 2].min() <= 0.0:
        raise InputError("views must be above the surface, z > 0")
    surface = replace(surface, argument="view")
    scene = RayScene(surface) if shadowed else None
    samples_ivc = np.empty((len(views_i3), surface.n_vertex, 3), np.float32)
    albedo_vc = albedo_of(surface)
    frames_v33 = surface.frames()

    def fill(vertices_v: NDArray[np.intp]) -> None:
        for vertex in vertices_v:
            lights_l3 = light.directions_l3 @ frames_v33[vertex].T
            above_l = np.flatnonzero(lights_l3[:, 2] > 0.0)
            if scene is not None:
                rays_r3 = light.directions_l3[above_l].astype(np.float32)
                above_l = above_l[~scene.occluded(np.full(len(above_l), vertex), rays_r3)]
            arriving_lc = light.irradiance_lc[above_l] * lights_l3[above_l, 2:]
            pair = lights_l3[above_l, None], views_i3[None]
            sent_ic = _sum_lights(arriving_lc * albedo_vc[vertex], brdf.matte(*pair))
            samples_ivc[:, vertex] = sent_ic + _sum_lights(arriving_lc, brdf.gloss(*pair))

    _in_tiles(fill, surface.n_vertex, len(light.directions_l3) * len(views_i3) * 64, progress)
    return _stack_of(surface, samples_ivc, views_i3)


def _sum_lights(arriving_lc: NDArray[np.float64], reflected_lic: NDArray[np.float64]) -> NDArray[np.float64]:
    if reflected_lic.shape[2] == 1:
        return reflected_lic[..., 0].T @ arriving_lc
    return np.stack([arriving_c @ reflected_lic[..., c] for c, arriving_c in enumerate(arriving_lc.T)], axis=1)


def _in_tiles(
    fill: Callable[[NDArray[np.intp]], None], n_vertex: int, bytes_each: int, progress: Progress | None
) -> None:
    """Call `fill` with tiles of vertices, several at once, each small enough to pass through memory."""
    step = int(np.clip(PIECE_BYTES // max(bytes_each, 1), 1, 1 << 12))
    tiles = [np.arange(first, min(first + step, n_vertex)) for first in range(0, n_vertex, step)]
    done = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # Embree and NumPy let go of Python's lock
        for tile, _ in zip(tiles, pool.map(fill, tiles), strict=True):
            done += len(tile)
            if progress is not None:
                progress(done, n_vertex)


def _stack_of(surface: Surface, samples_ivc: NDArray[np.float32], directions_i3: NDArray[np.float64]) -> LightStack:
    images_ihwc = samples_ivc.reshape(len(samples_ivc), *surface.map_shape, samples_ivc.shape[2])
    return LightStack(images_ihwc, directions_i3, peak=1.0, transfer="linear", name=surface.name, surface=surface)
