"""Diffuse radiance transfer: how much of the light from each direction a surface's vertices send on.

``T(s) = rho / pi max(0, n . s) V(s)``, projected onto spherical harmonics (spherical-harmonic-lighting, "diffuse
shadowed transfer"), and with what reaches them by way of other parts of the surface; a white unoccluded surface under
radiance 1 from everywhere sends on 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.memory import DEFAULT_MEMORY
from clrelight.surface import Surface
from clrelight.threads import on_one_thread
from clrelight.transfer.bounces import Traced, check_bounces, gathered_tiles, interreflected
from clrelight.transfer.frames import turn_into_frames
from clrelight.transfer.gathering import Gatherer, Tally, check_degree, check_memory, direct_tiles, points_of
from clrelight.transfer.rays import RayScene
from clrelight.transfer.samples import Samples, as_samples

KINDS = ("unshadowed", "shadowed", "interreflected")
_BLOCK = 1 << 14


@dataclass(frozen=True)
class Transport:
    """What transfer is asked for.

    Attributes
    ----------
    degree : int
    kind : str
        One of `KINDS`.
    samples : Samples, optional
        Directions in the axes of the positions; None only where unshadowed: then the function is exact.
    bounces, threshold, way
        Of interreflected transfer: see `interreflected`.
    memory : int
        Bytes of rays and their hits.
    """

    degree: int
    kind: str = "shadowed"
    samples: Samples | None = None
    bounces: int = 3
    threshold: float = 0.0
    way: str = "gather"
    memory: int = DEFAULT_MEMORY

    def __post_init__(self) -> None:
        check_degree(self.degree)
        if self.kind not in KINDS:
            raise InputError(f"transfer must be {', '.join(KINDS[:-1])} or {KINDS[-1]}, got {self.kind!r}")
        if self.samples is None and self.kind != "unshadowed":
            raise InputError(f"{self.kind} transfer needs samples")
        check_bounces(self.bounces, self.threshold, self.way)
        if self.samples is not None:  # before meshes are read, and trees are built
            for_rays = self.memory // 4 if self.kind == "interreflected" else self.memory
            check_memory(self.samples.count, self.degree, for_rays)

    def tiles(
        self,
        surface: Surface,
        scene: RayScene | None,
        *,
        block: int = _BLOCK,
        tally: Tally | None = None,
        tell: Callable[[int, int], object] | None = None,
        tell_bounces: Callable[[int, int], object] | None = None,
        part: tuple[int, int] | None = None,
        elsewhere: Traced | None = None,
    ) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """Yield the number of the first vertex, and the transfer of up to `block` in the surface's frames.

        Of shape (n_coeff, n, channel). The scene, of the same surface or of one that it is points of (its texels), is
        needed unless transfer is unshadowed. A `part` of the vertices is for transfer without bounces, see
        `direct_tiles`. Of interreflected transfer at vertices others may trace the rays `elsewhere`.
        """
        seen = None if self.kind == "unshadowed" else scene
        for first, coeffs_vck in self._tiles(surface, seen, block, tally, tell, tell_bounces, part, elsewhere):
            if surface.tangents_v3 is not None:
                vertices = slice(first, first + len(coeffs_vck))
                coeffs_vck = turn_into_frames(coeffs_vck, surface.frames()[vertices])
            yield first, coeffs_vck.transpose(2, 0, 1)

    def _tiles(
        self,
        surface: Surface,
        scene: RayScene | None,
        block: int,
        tally: Tally | None,
        tell: Callable[[int, int], object] | None,
        tell_bounces: Callable[[int, int], object] | None,
        part: tuple[int, int] | None,
        elsewhere: Traced | None,
    ) -> Iterator[tuple[int, NDArray[np.float32]]]:
        if self.kind != "interreflected":
            yield from direct_tiles(
                surface,
                self.degree,
                self.samples,
                scene,
                block=block,
                memory=self.memory,
                tally=tally,
                tell=tell,
                part=part,
            )
            return
        if scene is None or self.samples is None:
            raise TypeError("interreflected transfer needs a scene and samples")
        is_own = scene.surface.vertices_v3 is surface.vertices_v3
        whole_vck = interreflected(
            surface if is_own else scene.surface,
            self.degree,
            self.samples,
            scene,
            bounces=self.bounces if is_own or self.way == "shoot" else max(self.bounces - 1, 0),
            threshold=self.threshold,
            way=self.way,
            memory=self.memory,
            tally=tally,
            tell=tell,
            tell_bounces=tell_bounces,
            elsewhere=elsewhere,
        )
        if is_own:
            for first in range(0, len(whole_vck), block):
                yield first, whole_vck[first : first + block]
            return
        lit_vck = whole_vck if self.bounces or self.way == "shoot" else np.zeros_like(whole_vck)
        counted = Tally() if tally is None else tally
        gatherer = Gatherer(points_of(surface, scene), self.samples, self.degree, scene, self.memory // 4, counted)
        yield from gathered_tiles(surface, gatherer, lit_vck, block)


def transfer_vertices(
    surface: Surface,
    degree: int,
    kind: str = "shadowed",
    samples_s3: Samples | NDArray[np.float64] | int | None = None,
    *,
    bounces: int = 3,
    threshold: float = 0.0,
    way: str = "gather",
    seed: int = 0,
    scene: RayScene | None = None,
    memory: int = DEFAULT_MEMORY,
    tally: Tally | None = None,
) -> NDArray[np.float32]:
    """Return the transfer of all vertices, in the surface's frames.

    Parameters
    ----------
    surface : Surface
    degree : int
        Of the coefficients.
    kind : str
        ``"unshadowed"``, ``"shadowed"`` or ``"interreflected"``.
    samples_s3 : Samples, int or array_like, optional
        So many stratified directions, a square; or directions (n_sample, 3), float64, in the axes of the positions,
        weighted by their Voronoi cells. Default: 1024; unshadowed transfer is exact without.
    bounces : int
        Of interreflected transfer, at most, where it is gathered.
    threshold : float
        Bounces end when what is left is no more than this share of the direct light.
    way : str
        ``"gather"`` or ``"shoot"``.
    seed : int
        Of the stratified directions.
    scene : RayScene, optional
        The surface's own, where it is there already.
    memory : int
        Bytes of rays and hits that are held; the result comes on top, of interreflected transfer three times.
    tally : Tally, optional
        Gets what rays met.

    Returns
    -------
    ndarray, shape (n_coeff, n_vertex, channel), float32
        Channels are the albedo's, one without.

    Raises
    ------
    InputError
        If the request makes no sense, or one vertex's rays take more than `memory`.
    """
    exact = kind == "unshadowed" and samples_s3 is None
    wanted = Transport(
        degree, kind, None if exact else as_samples(samples_s3, seed), bounces, threshold, way, memory=memory
    )
    if scene is None and kind != "unshadowed":
        scene = RayScene(surface)
    channels = 1 if surface.albedo_vc is None else surface.albedo_vc.shape[1]
    coeffs_kvc = np.empty((coefficient_count(degree), surface.n_vertex, channels), np.float32)
    with on_one_thread():
        for first, tile_kvc in wanted.tiles(surface, scene, tally=tally):
            coeffs_kvc[:, first : first + tile_kvc.shape[1]] = tile_kvc
    return coeffs_kvc
