"""What a camera sees of a surface, by rays: each picture is then a sum over the vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.surface import Surface
from clrelight.tiles import row_tiles
from clrelight.transfer.cameras import Camera, frame_surface, picture_size
from clrelight.transfer.rays import RayScene

SUBSAMPLES = 3
"""Each pixel is the mean of SUBSAMPLES x SUBSAMPLES rays, on a regular grid, where nobody says otherwise."""

MAX_SUBSAMPLES = 16
_RAYS_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class View:
    """What the rays of each pixel meet of the outer side of a surface; those that meet one face are one sample.

    Attributes
    ----------
    width, height : int
        Of the picture.
    pixel_s : ndarray, shape (n_sample,), int64
        Pixel of each sample, row by row.
    share_s : ndarray, shape (n_sample,), float32
        Part of the pixel's rays.
    corners_sj : ndarray, shape (n_sample, 3 or 4), int32
        Vertices around the point that is met: those of the face, or of the cell of the parameter grid.
    weights_sj : ndarray, shape (n_sample, 3 or 4), float32
        Their shares in it, sum 1.
    coverage_p : ndarray, shape (height * width,), float32
        Part of each pixel's rays that meet the surface, on either side.
    behind : float
        Part of the rays that meet it which meet the inner side; these are black.
    """

    width: int
    height: int
    pixel_s: NDArray[np.int64]
    share_s: NDArray[np.float32]
    corners_sj: NDArray[np.int32]
    weights_sj: NDArray[np.float32]
    coverage_p: NDArray[np.float32]
    behind: float

    @property
    def coverage_hw(self) -> NDArray[np.float32]:
        """Part of each pixel that the surface covers, (height, width)."""
        return self.coverage_p.reshape(self.height, self.width)

    @cached_property
    def _mean(self) -> Any:
        """The sparse matrix from samples to pixels."""
        from scipy.sparse import csr_matrix

        samples_s = np.arange(len(self.pixel_s))
        shape = (self.width * self.height, len(self.pixel_s))
        return csr_matrix((self.share_s, (self.pixel_s, samples_s)), shape=shape)

    def average(self, values_sc: NDArray) -> NDArray[np.float32]:
        """Return the picture of values of the samples (n_sample, channel): (height, width, channel), 0 elsewhere."""
        image_pc = np.asarray(self._mean @ values_sc, np.float32)
        return image_pc.reshape(self.height, self.width, values_sc.shape[1])

    def at_samples(self, values_vc: NDArray) -> NDArray:
        """Return values of vertices (n_vertex, channel) at the samples, (n_sample, channel)."""
        total = self.weights_sj[:, :1] * values_vc[self.corners_sj[:, 0]]
        for j in range(1, self.corners_sj.shape[1]):
            total += self.weights_sj[:, j : j + 1] * values_vc[self.corners_sj[:, j]]
        return total

    def interpolate(self, values_vc: NDArray) -> NDArray[np.float32]:
        """Return the picture of values of the vertices, each ray's share between its corners (Gouraud)."""
        return self.average(self.at_samples(values_vc))


def look(
    scene: RayScene,
    camera: Camera,
    size: int | Sequence[int],
    *,
    subsamples: int = SUBSAMPLES,
    rows: tuple[int, int] | None = None,
    texture: bool = False,
    texels: tuple[int, int] | None = None,
) -> View:
    """Return what a camera sees.

    Parameters
    ----------
    scene : RayScene
    camera : Camera
    size : int or two ints
        Width and height of the picture.
    subsamples : int
        Each pixel has the mean of its square.
    rows : (int, int), optional
        First row and the row behind the last of a band of the picture; default: all. The view's height is the band's.
    texture : bool
        Where the vertices are a parameter grid: shares among the four corners of a cell, as a texture is read, instead
        of among the three of a face.
    texels : (int, int), optional
        Rows and columns of a texture that the surface wears: corners are then its texels, row by row, around the
        texture coordinates that are met.
    """
    width, height = picture_size(size)
    if texels is not None and scene.surface.texture_v2 is None:
        raise InputError("a surface without texture coordinates wears no texture")
    if not 1 <= subsamples <= MAX_SUBSAMPLES:
        raise InputError(f"subsamples must be 1 to {MAX_SUBSAMPLES}, got {subsamples}")
    first, end = rows or (0, height)
    step = max(1, _RAYS_AT_ONCE // (width * subsamples**2))
    bands = row_tiles((first, end), step)
    found = [_look_at_rows(scene, camera, (width, height), subsamples, band) for band in bands]
    share_s, face_s, weights_sj, coverage_p = (np.concatenate([each[i] for each in found]) for i in (1, 2, 3, 5))
    # Pixels of a band begin at its first row.
    pixel_s = np.concatenate([each[0] + (band[0] - first) * width for each, band in zip(found, bands, strict=True)])
    counts = np.sum([each[4] for each in found], axis=0)
    corners_sj = scene.surface.faces_f3[face_s]
    if texels is not None and scene.surface.texture_v2 is not None:
        places_s2 = np.einsum("sj,sja->sa", weights_sj, scene.surface.texture_v2[corners_sj])
        corners_sj, weights_sj = _texels(texels, places_s2)
    elif texture and scene.surface.grid is not None:
        corners_sj, weights_sj = _cells(scene.surface.grid, corners_sj, weights_sj)
    return View(
        width,
        end - first,
        pixel_s,
        share_s,
        corners_sj,
        weights_sj,
        (coverage_p / subsamples**2).astype(np.float32),
        float(counts[1] / counts[0]) if counts[0] else 0.0,
    )


def _look_at_rows(
    scene: RayScene, camera: Camera, size: tuple[int, int], subsamples: int, rows: tuple[int, int]
) -> tuple[NDArray, NDArray, NDArray, NDArray, tuple[int, int], NDArray]:
    """Return pixel, share, face and weights of samples, counts of hits (all, from behind), and hits of each pixel."""
    width, height = size
    steps = (np.arange(subsamples) + 0.5) / subsamples
    across_w = (np.arange(width)[:, None] + steps).ravel()
    down_h = (np.arange(*rows)[:, None] + steps).ravel()
    y_r, x_r = np.meshgrid(0.5 - down_h / height, (across_w - 0.5 * width) / height, indexing="ij")
    origins_r3, directions_r3 = camera.rays(x_r.ravel(), y_r.ravel())
    with np.errstate(over="ignore"):  # of distances where nothing is met
        hits = scene.hit_from(_enter(scene.surface, origins_r3, directions_r3), directions_r3.astype(np.float32))
    row_h, column_w = np.repeat(np.arange(rows[1] - rows[0]), subsamples), np.repeat(np.arange(width), subsamples)
    pixel_r = (row_h[:, None] * width + column_w).ravel()
    met_r = hits.face_r >= 0
    kept_r = met_r & ~hits.from_behind_r
    n_face = len(scene.surface.faces_f3)
    held_r = pixel_r[kept_r] * n_face + hits.face_r[kept_r]
    found_s, sample_r, count_s = np.unique(held_r, return_inverse=True, return_counts=True)
    weights_r3 = hits.weights_r3[kept_r]
    weights_s3 = np.stack([np.bincount(sample_r, weights_r3[:, j], len(found_s)) for j in range(3)], axis=1)
    pixel_s, face_s = np.divmod(found_s, n_face)
    coverage_p = np.bincount(pixel_r[met_r], minlength=width * (rows[1] - rows[0]))
    return (
        pixel_s,
        (count_s / subsamples**2).astype(np.float32),
        face_s,
        (weights_s3 / count_s[:, None]).astype(np.float32),
        (int(met_r.sum()), int(met_r.sum() - kept_r.sum())),
        coverage_p,
    )


def _enter(
    surface: Surface, origins_s3: NDArray[np.float64], directions_s3: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where rays come to the ball around the surface: Embree's float32 is finest there, not at a far eye."""
    low_3, high_3 = surface.vertices_v3.min(axis=0), surface.vertices_v3.max(axis=0)
    ahead_s = np.einsum("sa,sa->s", 0.5 * (low_3 + high_3) - origins_s3, directions_s3) - 0.51 * surface.diagonal
    return origins_s3 + np.maximum(ahead_s, 0.0)[:, None] * directions_s3


def _cells(
    grid: tuple[int, int], corners_s3: NDArray[np.int32], weights_s3: NDArray[np.float32]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return corners and bilinear weights in the cells of a parameter grid, whose ends may meet."""
    ends, shares = [], []
    for count, at_s3 in zip(grid, np.divmod(corners_s3, grid[1]), strict=True):
        base_s = at_s3[:, 0]
        offset_s3 = (at_s3 - base_s[:, None] + count // 2) % count - count // 2  # the short way round
        place_s = base_s + np.einsum("sj,sj->s", weights_s3.astype(np.float64), offset_s3)
        low_s = np.floor(place_s)
        ends.append(np.stack([low_s % count, (low_s + 1) % count], axis=1).astype(np.int32))
        shares.append(np.stack([1.0 - (place_s - low_s), place_s - low_s], axis=1))
    return _bilinear(grid, ends, shares)


def _texels(grid: tuple[int, int], places_s2: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return corners and bilinear weights among texels; row 0 is at v = 1, column 0 at u = 0 (`texel_surface`)."""
    ends, shares = [], []
    for count, along_s in zip(grid, (1.0 - places_s2[:, 1], places_s2[:, 0]), strict=True):
        place_s = np.clip(along_s * count - 0.5, 0.0, count - 1.0)
        low_s = np.minimum(np.floor(place_s), max(count - 2, 0))
        ends.append(np.stack([low_s, np.minimum(low_s + 1, count - 1)], axis=1).astype(np.int32))
        shares.append(np.stack([1.0 - (place_s - low_s), place_s - low_s], axis=1))
    return _bilinear(grid, ends, shares)


def _bilinear(
    grid: tuple[int, int], ends: list[NDArray[np.int32]], shares: list[NDArray[np.float64]]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    corners_sj = ends[0][:, [0, 0, 1, 1]] * grid[1] + ends[1][:, [0, 1, 0, 1]]
    weights_sj = shares[0][:, [0, 0, 1, 1]] * shares[1][:, [0, 1, 0, 1]]
    return corners_sj, weights_sj.astype(np.float32)


def check_seen(surface: Surface, met: bool, outside: bool) -> None:
    """Raise InputError where a camera's rays meet nothing of a surface, or its inner side alone."""
    if not met:
        low_3, high_3 = surface.vertices_v3.min(axis=0), surface.vertices_v3.max(axis=0)
        box = " to ".join("(" + ", ".join(f"{v:.4g}" for v in corner) + ")" for corner in (low_3, high_3))
        raise InputError(
            f"the camera sees nothing of the surface, which lies in the box {box}: turn it there, or leave eye and "
            "target to the automatic camera"
        )
    if not outside:
        raise InputError(
            "the camera sees only the inner side of the surface: it stands inside, or the faces are turned inwards"
        )


def render_surface(
    surface: Surface,
    radiance_vc: NDArray,
    camera: Camera | None = None,
    size: int | Sequence[int] = 512,
    *,
    subsamples: int = SUBSAMPLES,
    background: Sequence[float] | float = 0.0,
    scene: RayScene | None = None,
) -> NDArray[np.float32]:
    """Return a picture of values of a surface's vertices, interpolated over its faces (Gouraud).

    Parameters
    ----------
    surface : Surface
    radiance_vc : ndarray, shape (n_vertex, channel), float
    camera : Camera, optional
        Default: `frame_surface`.
    size : int or two ints
        Width and height, one number being both.
    subsamples : int
        Each pixel is the mean of its square of rays.
    background : float or one a channel
        Where no surface is.
    scene : RayScene, optional
        That of the surface, where it is there already.

    Returns
    -------
    ndarray, shape (height, width, channel), float32
    """
    width, height = picture_size(size)
    values_vc = np.asarray(radiance_vc)
    if values_vc.ndim != 2 or len(values_vc) != surface.n_vertex:
        raise InputError(f"radiance must be ({surface.n_vertex}, channel), one row a vertex, got {values_vc.shape}")
    placed = camera or frame_surface(surface, aspect=width / height)
    view = look(scene or RayScene(surface), placed, size, subsamples=subsamples)
    check_seen(surface, bool(view.coverage_p.any()), len(view.pixel_s) > 0)
    return view.interpolate(values_vc) + (1.0 - view.coverage_hw[..., None]) * np.asarray(background, np.float32)
