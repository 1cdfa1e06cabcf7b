"""What points see of the sky and of the surface, by rays, projected onto spherical harmonics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.index import coefficient_count, degrees_of_coefficients
from clrelight.lighting.irradiance import cosine_coefficients
from clrelight.memory import DEFAULT_MEMORY
from clrelight.surface import Surface
from clrelight.transfer.rays import Hits, RayScene
from clrelight.transfer.samples import Samples

_SAMPLE_BYTES = 64
"""Of a sample while its rays are traced."""
_TILE_VALUES = 1 << 16
"""Samples of all points of a tile: what they take stays in a processor's cache."""
FIRST = math.sqrt(0.25 / math.pi)
"""The first basis function."""


@dataclass
class Tally:
    """What rays met.

    Attributes
    ----------
    rays : int
        How many were traced.
    hits, behind : int
        How many met the surface, and its inner side, where that was looked at.
    energy : list of float
        Of light that was gathered: what the whole surface sends on by 0, 1, 2 ... bounces, where a white one without
        occluders sends on 1; of light that was shot: what was left unshot after each shot.
    """

    rays: int = 0
    hits: int = 0
    behind: int = 0
    energy: list[float] | None = None

    def count(self, hits: Hits) -> None:
        """Add what rays met."""
        met_r = hits.face_r >= 0
        self.hits += int(np.count_nonzero(met_r))
        self.behind += int(np.count_nonzero(met_r & hits.from_behind_r))


@dataclass(frozen=True)
class Points:
    """Where transfer is wanted: vertices of the surface, or any points on it.

    Attributes
    ----------
    normals_n3 : ndarray, shape (n, 3), float64
    starts_n3 : ndarray, shape (n, 3), float32
        Where their rays start, as a `RayScene` takes it; empty where there are none.
    """

    normals_n3: NDArray[np.float64]
    starts_n3: NDArray[np.float32]

    @property
    def count(self) -> int:
        """How many."""
        return len(self.normals_n3)


def points_at_once(count: int, degree: int, memory: int) -> int:
    """Return how many points are looked at together in so many directions."""
    return max(1, min(_TILE_VALUES // count, memory // check_memory(count, degree, memory)))


class Gatherer:
    """Looks at visibility around points, and projects what is seen.

    Parameters
    ----------
    points : Points
    samples : Samples
    degree : int
    scene : RayScene, optional
        What may be in the way.
    memory : int
        Bytes of rays that are held at a time.
    tally : Tally
        Counts the rays.
    """

    def __init__(
        self, points: Points, samples: Samples, degree: int, scene: RayScene | None, memory: int, tally: Tally
    ) -> None:
        self.points, self.scene, self.tally, self.degree = points, scene, tally, degree
        self.is_whole = samples.is_whole
        self.directions_s3 = np.ascontiguousarray(samples.directions_s3, np.float32)
        self._turned_3s = np.ascontiguousarray(self.directions_s3.T)
        self._share_s = (samples.weights_s / np.pi).astype(np.float32)
        self._basis_sk = np.empty((samples.count, coefficient_count(degree)), np.float32)
        for first in range(0, samples.count, _TILE_VALUES):
            part = slice(first, first + _TILE_VALUES)
            basis_sk = evaluate_basis(samples.directions_s3[part], degree)
            self._basis_sk[part] = basis_sk * (samples.weights_s[part] / np.pi)[:, None]
        self.step = points_at_once(samples.count, degree, memory)

    def tiles(self, first: int, end: int) -> Iterator[tuple[int, int]]:
        """Yield parts of some points that are looked at together."""
        for start in range(first, end, self.step):
            yield start, min(start + self.step, end)

    def open_sky(self, first: int, end: int) -> NDArray[np.float32]:
        """Return transfer by samples with nothing in the way, (n, n_coeff)."""
        return self._cosines(first, end) @ self._basis_sk

    def shadowed(self, first: int, end: int) -> NDArray[np.float32]:
        """Return transfer with the surface in the way, (n, n_coeff)."""
        cosine_ns = self._cosines(first, end)
        above_r = np.flatnonzero(cosine_ns)
        blocked_r = self._scene.blocked(*self._rays(first, end, above_r))
        self.tally.rays += len(above_r)
        return self._project(first, end, cosine_ns, above_r[blocked_r])[0]

    def hits(self, first: int, end: int) -> tuple[NDArray[np.float32], scipy.sparse.csr_array]:
        """Return transfer with the surface in the way, and what each point gathers of each of its vertices' radiance.

        Rows of the latter, (n, n_vertex), have sums of at most 1; what is met from behind sends on nothing.
        """
        cosine_ns = self._cosines(first, end)
        above_r = np.flatnonzero(cosine_ns)
        hits = self._scene.trace(*self._rays(first, end, above_r))
        self.tally.rays += len(above_r)
        self.tally.count(hits)
        met_m = np.flatnonzero((hits.face_r >= 0) & ~hits.from_behind_r)
        flat_m = above_r[met_m]
        row_m, sample_m = np.divmod(flat_m, len(self.directions_s3))
        share_m = np.take(cosine_ns.ravel(), flat_m) * np.take(self._share_s, sample_m)
        coeffs_nk, total_n = self._project(first, end, cosine_ns, above_r[hits.face_r >= 0])
        if self.is_whole:
            share_m /= np.take(total_n, row_m)
        weights_m3 = np.take(hits.weights_r3, met_m, axis=0) * share_m[:, None]
        corners_m3 = np.take(self._scene.surface.faces_f3, np.take(hits.face_r, met_m), axis=0)
        starts_n = 3 * np.searchsorted(row_m, np.arange(end - first + 1)).astype(np.int64)
        shape = (end - first, self._scene.surface.n_vertex)
        found = scipy.sparse.csr_array((weights_m3.ravel(), corners_m3.ravel(), starts_n), shape=shape)
        found.sum_duplicates()  # many samples meet the faces of one vertex: this is a third of it
        return coeffs_nk, found

    @property
    def _scene(self) -> RayScene:
        if self.scene is None:
            raise TypeError("rays need a scene")
        return self.scene

    def _cosines(self, first: int, end: int) -> NDArray[np.float32]:
        cosine_ns = self.points.normals_n3[first:end].astype(np.float32) @ self._turned_3s
        return np.maximum(cosine_ns, 0.0, out=cosine_ns)

    def _rays(self, first: int, end: int, above_r: NDArray[np.intp]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        row_r, sample_r = np.divmod(above_r, len(self.directions_s3))
        counts_n = np.bincount(row_r, minlength=end - first)
        starts_r3 = np.repeat(self.points.starts_n3[first:end], counts_n, axis=0)
        return starts_r3, np.take(self.directions_s3, sample_r, axis=0)

    def _project(
        self, first: int, end: int, cosine_ns: NDArray[np.float32], blocked_r: NDArray[np.intp]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return transfer where some rays are blocked, and the integral of the cosine over pi, as samples have it.

        Samples that cover the sphere see the open cosine too, which is known: their error there is taken off, as far as
        the sky is open. So a point without occluders has the exact function, and one that sees nothing has 0.
        """
        if not self.is_whole:
            cosine_ns.ravel()[blocked_r] = 0.0
            return cosine_ns @ self._basis_sk, np.ones(end - first, np.float32)
        open_nk = cosine_ns @ self._basis_sk
        cosine_ns.ravel()[blocked_r] = 0.0
        seen_nk = cosine_ns @ self._basis_sk
        total_n = open_nk[:, 0] / np.float32(FIRST)
        exact_nk = cosine_transfer(self.points.normals_n3[first:end], self.degree)
        open_nk /= total_n[:, None]
        seen_nk /= total_n[:, None]
        seen_nk += (seen_nk[:, :1] / open_nk[:, :1]) * (exact_nk - open_nk)
        return seen_nk, total_n


def cosine_transfer(normals_n3: NDArray[np.float64], degree: int) -> NDArray[np.float32]:
    """Return the transfer of white unoccluded points, ``A_l y_k(n) / pi``, (n, n_coeff): exact."""
    factors_k = (cosine_coefficients(degree) / np.pi)[degrees_of_coefficients(degree)]
    return (evaluate_basis(normals_n3, degree) * factors_k).astype(np.float32)


def check_memory(count: int, degree: int, memory: int) -> int:
    """Return the bytes of the rays of one point; InputError if they or the basis at the samples are beyond `memory`."""
    point_bytes = _SAMPLE_BYTES * count
    most = max(point_bytes, 4 * coefficient_count(degree) * count)
    if most > memory:
        raise InputError(
            f"{count} samples of degree {degree} take {most} bytes at once, more than the {memory} that --memory "
            "leaves for them"
        )
    return point_bytes


def check_degree(degree: int) -> None:
    """Raise InputError unless the basis is known to be accurate so far."""
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")


def albedo_of(surface: Surface) -> NDArray[np.float32]:
    """Return the albedo of each vertex, (n_vertex, channel)."""
    return np.ones((surface.n_vertex, 1), np.float32) if surface.albedo_vc is None else surface.albedo_vc


def points_of(surface: Surface, scene: RayScene | None) -> Points:
    """Return the vertices of a surface as points: of the scene's own, or of one whose vertices lie on that."""
    if scene is None:
        return Points(surface.normals_v3, np.empty((0, 3), np.float32))
    if scene.surface.vertices_v3 is surface.vertices_v3:
        return Points(surface.normals_v3, scene.starts_v3)
    return Points(surface.normals_v3, scene.starts_of(surface.vertices_v3, surface.normals_v3))


def direct_tiles(
    surface: Surface,
    degree: int,
    samples: Samples | None,
    scene: RayScene | None,
    *,
    block: int,
    memory: int = DEFAULT_MEMORY,
    tally: Tally | None = None,
    tell: Callable[[int, int], object] | None = None,
    part: tuple[int, int] | None = None,
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield transfer without bounces: the number of the first vertex, and (n, channel, n_coeff) of up to `block`.

    Without a scene nothing is in the way; without samples too, the function is exact. Of a `part` of the vertices,
    functions are those of all, bit for bit, where it begins a multiple of `points_at_once` behind a block.
    """
    albedo_vc, (top, count) = albedo_of(surface), part or (0, surface.n_vertex)
    gatherer = None
    if samples is not None:
        points = points_of(surface, scene)
        gatherer = Gatherer(points, samples, degree, scene, memory, Tally() if tally is None else tally)
    for first in range(top, count, block):
        end = min(first + block, count)
        if gatherer is None:
            coeffs_vk = cosine_transfer(surface.normals_v3[first:end], degree)
        else:
            coeffs_vk = np.empty((end - first, coefficient_count(degree)), np.float32)
            look = gatherer.open_sky if scene is None else gatherer.shadowed
            for start, stop in gatherer.tiles(first, end):
                coeffs_vk[start - first : stop - first] = look(start, stop)
                if tell is not None:
                    tell(stop, count)
        yield first, albedo_vc[first:end, :, None] * coeffs_vk[:, None, :]
