"""Pictures of surfaces whose vertices carry functions: per vertex and per pixel, band by band, over a background."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.memory import DEFAULT_MEMORY
from clrelight.surface import Surface
from clrelight.tiles import row_tiles
from clrelight.transfer.cameras import Camera, picture_size
from clrelight.transfer.lit_functions import Functions
from clrelight.transfer.rays import RayScene
from clrelight.transfer.shading import is_hemispherical, send, shade_vertices, shade_views
from clrelight.transfer.sources import Source, add_light, shade_by
from clrelight.transfer.views import SUBSAMPLES, View, check_seen, look

SHADINGS = ("vertex", "pixel")
"""Radiance at vertices, interpolated; or functions at pixels, under light and towards the eye as these have them."""

Background = Callable[[NDArray[np.float64]], NDArray]
"""Radiance (n, channel) in directions (n, 3)."""

_BYTES_A_RAY = 160


@dataclass(frozen=True)
class Picture:
    """A picture before it lies on a background.

    Attributes
    ----------
    radiance_hwc : ndarray, shape (height, width, channel), float32
        Of the surface, times the part of the pixel that it covers.
    coverage_hw : ndarray, shape (height, width), float32
    behind : float
        Part of what is seen of the surface that is its inner side, which is black.
    """

    radiance_hwc: NDArray[np.float32]
    coverage_hw: NDArray[np.float32]
    behind: float


@dataclass
class Painter:
    """Makes pictures of one map on its surface.

    Attributes
    ----------
    coefficients : CoefficientMap
        In memory where `shading` is ``"pixel"``.
    surface : Surface
    size : (int, int)
        Width and height.
    subsamples : int
        Rays of a pixel are its square.
    shading : str
        One of `SHADINGS`.
    memory : int
        Bytes that rays and functions of one band take.
    body : Surface, optional
        The mesh that wears the map as a texture, whose texels `surface` holds; default: the surface itself.
    """

    coefficients: CoefficientMap
    surface: Surface
    size: tuple[int, int]
    subsamples: int = SUBSAMPLES
    shading: str = "vertex"
    memory: int = DEFAULT_MEMORY
    body: Surface | None = None
    _held: dict[object, View] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        picture_size(self.size)
        if self.shading not in SHADINGS:
            raise InputError(f"shading must be one of {', '.join(SHADINGS)}, got {self.shading!r}")
        self._scene = RayScene(self.body or self.surface)
        per_row = self.size[0] * self.subsamples**2 * _BYTES_A_RAY
        self._rows = max(1, self.memory // per_row)

    def paint(self, sources: Sequence[Source], camera: Camera) -> Picture:
        """Return the picture under some lights, or of functions of the direction to the eye without any."""
        height = self.size[1]
        by_eye = self.surface.argument == "view"
        if by_eye and sources:
            raise InputError("functions of the direction to the eye are for one fixed light: give no other")
        if not by_eye and not sources:
            raise InputError("functions of the direction to the light need one: give a light")
        per_pixel = self.shading == "pixel"
        at_pixels = [source for source in sources if per_pixel and not source.is_distant]
        at_vertices = [source for source in sources if not per_pixel or source.is_distant]
        radiance_vc = None
        if at_vertices:
            radiance_vc = shade_vertices(self.coefficients, at_vertices, surface=self.surface, memory=self.memory)
        elif by_eye and not per_pixel:
            eyes_v3 = camera.towards(self.surface.vertices_v3)
            radiance_vc = shade_views(self.coefficients, eyes_v3, surface=self.surface)
        bands, coverage, behind, outside = [], [], [], False
        for rows in row_tiles((0, height), self._rows):
            view = self._view(camera, rows)
            bands.append(self._paint_band(view, radiance_vc, at_pixels, camera))
            coverage.append(view.coverage_hw)
            behind.append(view.behind * view.coverage_p.sum())
            outside |= len(view.pixel_s) > 0
        coverage_hw = np.concatenate(coverage)
        check_seen(self._scene.surface, bool(coverage_hw.any()), outside)
        return Picture(np.concatenate(bands), coverage_hw, float(np.sum(behind) / coverage_hw.sum()))

    def _view(self, camera: Camera, rows: tuple[int, int]) -> View:
        """Return what is seen of a band; that of the whole picture is kept for the next one by the same camera."""
        found = self._held.get((camera, rows))
        if found is None:
            found = look(
                self._scene,
                camera,
                self.size,
                subsamples=self.subsamples,
                rows=rows,
                texture=self.shading == "pixel",
                texels=None if self.body is None else self.surface.grid,
            )
            self._held = {(camera, rows): found} if self._rows >= self.size[1] else {}
        return found

    def _paint_band(
        self, view: View, radiance_vc: NDArray | None, sources: Sequence[Source], camera: Camera
    ) -> NDArray[np.float32]:
        if radiance_vc is not None and not sources:
            return view.interpolate(radiance_vc)
        total_sc = self._shade_samples(view, sources, camera)
        if radiance_vc is not None:
            total_sc = add_light(total_sc, view.at_samples(radiance_vc))
        return view.average(total_sc)

    def _shade_samples(self, view: View, sources: Sequence[Source], camera: Camera) -> NDArray[np.float64]:
        """Return the radiance of points of the picture: each corner's own function there, in its own frame."""
        n_coeff, channel = self.coefficients.n_coeff, self.coefficients.image_shape[2]
        coeffs_kvc = self.coefficients.to_float32().coeffs_khwc.reshape(n_coeff, -1, channel)
        frames_v33 = None if self.surface.tangents_v3 is None else self.surface.frames()
        hemispherical = is_hemispherical(self.coefficients)
        # In global axes corners share a direction: their functions are summed first, and evaluated once.
        apart = 1 if frames_v33 is None else view.corners_sj.shape[1]
        step = max(1, self.memory // (apart * n_coeff * (4 * channel + 40)))
        parts = [np.zeros((0, channel))]
        for at in range(0, len(view.pixel_s), step):
            corners_sj, weights_sj = view.corners_sj[at : at + step], view.weights_sj[at : at + step]
            points_s3 = np.einsum("sj,sja->sa", weights_sj, self.surface.vertices_v3[corners_sj])
            points_n3 = np.repeat(points_s3, apart, axis=0)
            if frames_v33 is None:
                corners = zip(weights_sj.T[..., None], corners_sj.T, strict=True)
                functions = Functions(sum(weight_s1 * coeffs_kvc[:, at_s] for weight_s1, at_s in corners), points_n3)
            else:
                corners_n = corners_sj.ravel()
                functions = Functions(coeffs_kvc[:, corners_n], points_n3, frames_v33[corners_n], hemispherical)
            lit_nc = shade_by(sources, functions) if sources else send(functions, camera.towards(points_n3))
            shares_sj = np.ones_like(weights_sj[:, :1]) if apart == 1 else weights_sj
            parts.append(np.einsum("sj,sjc->sc", shares_sj, lit_nc.reshape(*shares_sj.shape, -1)))
        return np.concatenate(parts[1:] or parts)


def put_on(picture: Picture, background: Background, camera: Camera, rows_at_once: int = 256) -> NDArray[np.float32]:
    """Return a picture on a background, (height, width, channel) float32; a gray one becomes coloured where that is."""
    height, width = picture.coverage_hw.shape
    bands = []
    for first, end in row_tiles((0, height), rows_at_once):
        down_h, across_w = np.arange(first, end) + 0.5, np.arange(width) + 0.5
        y_n, x_n = np.meshgrid(0.5 - down_h / height, (across_w - 0.5 * width) / height, indexing="ij")
        behind_nc = np.asarray(background(camera.rays(x_n.ravel(), y_n.ravel())[1]))
        left_hw1 = 1.0 - picture.coverage_hw[first:end, :, None]
        band_hwc = picture.radiance_hwc[first:end] + left_hw1 * behind_nc.reshape(end - first, width, -1)
        bands.append(band_hwc.astype(np.float32))
    return np.concatenate(bands)
