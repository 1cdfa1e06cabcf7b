"""Light that other parts of the surface send on: bounce after bounce, gathered or shot.

``T_b(v) = rho(v) sum_s w_s T_{b-1}(what s meets)``: transfer vectors are radiosities that are linear in the light, so
each bounce is one sparse matrix, the hits of all rays, times the vectors of the last one. Rays are traced once where
their hits fit into memory, and again where they do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.memory import DEFAULT_MEMORY
from clrelight.surface import Surface
from clrelight.transfer.gathering import FIRST, Gatherer, Tally, albedo_of, points_of
from clrelight.transfer.meshes import vertex_areas
from clrelight.transfer.rays import RayScene
from clrelight.transfer.samples import Samples

WAYS = ("gather", "shoot")
MOST_BOUNCES = 1000
_SHOT = 0.9
"""Share of the unshot energy that is sent on in a round."""

Tell = Callable[[int, int], object]


class Traced(Protocol):
    """Traces the rays of parts of the vertices in other processes."""

    def hits(
        self, parts: Sequence[tuple[int, int]], tally: Tally
    ) -> Iterator[tuple[NDArray[np.float32], scipy.sparse.csr_array]]:
        """Return what `Gatherer.hits` does of each part, in their order; the tally gets what rays met."""

    def rows(self, number: int) -> scipy.sparse.csr_array:
        """Return the rows of one of those parts once more."""


class Operator:
    """What each vertex gathers of each other one's radiance, as parts of some rows each.

    Parameters
    ----------
    gatherer : Gatherer
        Of the surface's own vertices.
    memory : int
        Bytes of hits to keep; what is beyond is traced again whenever it is needed.
    elsewhere : Traced, optional
        Other processes that trace the same rays.

    Attributes
    ----------
    parts : list of tuple of int
        First and end of each part's rows.
    """

    def __init__(self, gatherer: Gatherer, memory: int, elsewhere: Traced | None = None) -> None:
        self._gatherer, self._left, self._elsewhere = gatherer, memory, elsewhere
        self.parts = list(gatherer.tiles(0, gatherer.points.count))
        self._kept: dict[int, Any] = {}

    def direct(self, tell: Tell | None = None) -> NDArray[np.float32]:
        """Trace the rays of all vertices; return transfer without a bounce, white, (n_vertex, n_coeff)."""
        found = []
        traced: Iterator[tuple[NDArray[np.float32], scipy.sparse.csr_array]]
        if self._elsewhere is None:
            traced = (self._gatherer.hits(*part) for part in self.parts)
        else:
            traced = self._elsewhere.hits(self.parts, self._gatherer.tally)
        for number, ((_, end), (coeffs_vk, rows)) in enumerate(zip(self.parts, traced, strict=True)):
            found.append(coeffs_vk)
            n_bytes = rows.data.nbytes + rows.indices.nbytes + rows.indptr.nbytes
            if n_bytes <= self._left:
                self._left -= n_bytes
                self._kept[number] = rows
            if tell is not None:
                tell(end, self._gatherer.points.count)
        return np.concatenate(found)

    @property
    def kept(self) -> float:
        """The share of parts whose hits are kept."""
        return len(self._kept) / len(self.parts)

    def rows(self, number: int) -> scipy.sparse.csr_array:
        """Return the rows of a part."""
        kept = self._kept.get(number)
        if kept is None and self._elsewhere is not None:
            return self._elsewhere.rows(number)
        return self._gatherer.hits(*self.parts[number])[1] if kept is None else kept

    def columns(self, number: int, vertices_n: NDArray[np.intp]) -> scipy.sparse.csc_array:
        """Return what the rows of a part gather of some vertices."""
        kept = self._kept.get(number)
        if isinstance(kept, scipy.sparse.csr_array):  # in the order of columns from now on
            self._kept[number] = kept = kept.tocsc()
        whole = self.rows(number).tocsc() if kept is None else kept
        return whole[:, vertices_n]


@dataclass(frozen=True)
class Spread:
    """How light goes on between vertices.

    Attributes
    ----------
    operator : Operator
    albedo_vc : ndarray, shape (n_vertex, 1 or channel), float32
    areas_v : ndarray, shape (n_vertex,), float64
        Of what each vertex stands for.
    """

    operator: Operator
    albedo_vc: NDArray[np.float32]
    areas_v: NDArray[np.float64]

    def energy(self, coeffs_vck: NDArray[np.float32]) -> float:
        """Return what all vertices send on under the same light from everywhere."""
        return float(self.areas_v @ coeffs_vck[:, :, 0].sum(axis=1, dtype=np.float64))

    def gather(
        self, start_vck: NDArray[np.float32], bounces: int, threshold: float, tell: Tell | None = None
    ) -> tuple[NDArray[np.float32], list[float]]:
        """Return start and all bounces of it together, and the energy of each.

        It ends after so many bounces, or once one has no more than `threshold` of the start's energy.
        """
        last_vck, total_vck = start_vck, start_vck.copy()
        energy = [self.energy(start_vck)]
        for bounce in range(bounces):
            if energy[-1] <= threshold * energy[0]:
                break
            flat_vq = last_vck.reshape(len(last_vck), -1)
            next_vck = np.empty_like(last_vck)
            for number, (first, end) in enumerate(self.operator.parts):
                next_vck[first:end] = (self.operator.rows(number) @ flat_vq).reshape(end - first, *last_vck.shape[1:])
            next_vck *= self.albedo_vc[:, :, None]
            total_vck += next_vck
            last_vck = next_vck
            energy.append(self.energy(last_vck))
            if tell is not None:
                tell(bounce + 1, bounces)
        return total_vck, energy

    def shoot(
        self, start_vck: NDArray[np.float32], threshold: float, tell: Tell | None = None
    ) -> tuple[NDArray[np.float32], list[float]]:
        """Return start and all bounces of it together, and the energy that is unshot after each round.

        In each, those vertices that hold most of the unshot energy send it on to all that see them, by the columns of
        the operator, until `threshold` of the start's is left (Cohen et al. 1988, progressive refinement).
        """
        total_vck, unshot_vck = start_vck.copy(), start_vck.copy()
        energy = [self.energy(start_vck)]
        for _ in range(MOST_BOUNCES):
            if energy[-1] <= threshold * energy[0]:
                return total_vck, energy
            shooters_n = self._shooters(unshot_vck)
            sent_nq = unshot_vck[shooters_n].reshape(len(shooters_n), -1)
            unshot_vck[shooters_n] = 0.0
            for number, (first, end) in enumerate(self.operator.parts):
                got_vq = self.operator.columns(number, shooters_n) @ sent_nq
                got_vck = self.albedo_vc[first:end, :, None] * got_vq.reshape(end - first, *start_vck.shape[1:])
                total_vck[first:end] += got_vck
                unshot_vck[first:end] += got_vck
            energy.append(self.energy(unshot_vck))
            if tell is not None:
                done = math.log(max(energy[-1] / energy[0], 1e-30)) / math.log(threshold)
                tell(int(1000 * min(max(done, 0.0), 1.0)), 1000)
        left = energy[-1] / energy[0]
        raise InputError(f"{left:.2g} of the light is left after {MOST_BOUNCES} rounds of shots: raise --threshold")

    def _shooters(self, unshot_vck: NDArray[np.float32]) -> NDArray[np.intp]:
        """Return the fewest vertices that hold `_SHOT` of the unshot energy."""
        held_v = self.areas_v * unshot_vck[:, :, 0].sum(axis=1, dtype=np.float64)
        order_v = np.argsort(-held_v, kind="stable")
        reached_v = np.cumsum(held_v[order_v])
        count = int(np.searchsorted(reached_v, _SHOT * reached_v[-1])) + 1
        return np.sort(order_v[:count])


def interreflected(
    surface: Surface,
    degree: int,
    samples: Samples,
    scene: RayScene,
    *,
    bounces: int = 3,
    threshold: float = 0.0,
    way: str = "gather",
    memory: int = DEFAULT_MEMORY,
    tally: Tally | None = None,
    tell: Tell | None = None,
    tell_bounces: Tell | None = None,
    elsewhere: Traced | None = None,
) -> NDArray[np.float32]:
    """Return transfer with the light of other parts of the surface, (n_vertex, channel, n_coeff).

    Parameters
    ----------
    surface : Surface
    degree : int
    samples : Samples
    scene : RayScene
        Of the surface.
    bounces : int
        At most, where light is gathered; shooting goes on to the threshold.
    threshold : float
        Of the direct light's energy: what remains is left out.
    way : str
        ``"gather"`` or ``"shoot"``.
    memory : int
        Bytes of hits and of rays; the maps come on top.
    tally : Tally, optional
        Gets what rays met, and the energies.
    tell, tell_bounces : callable, optional
        Told how much of the rays, and of the bounces, is done.
    elsewhere : Traced, optional
        Other processes that trace the rays.
    """
    check_bounces(bounces, threshold, way)
    counted = Tally() if tally is None else tally
    gatherer = Gatherer(points_of(surface, scene), samples, degree, scene, memory // 4, counted)
    operator = Operator(gatherer, memory - memory // 4, elsewhere)
    albedo_vc = albedo_of(surface)
    start_vck = albedo_vc[:, :, None] * operator.direct(tell)[:, None, :]
    areas_v = vertex_areas(surface)
    spread = Spread(operator, albedo_vc, areas_v)
    if way == "gather":
        total_vck, energy = spread.gather(start_vck, bounces, threshold, tell_bounces)
    else:
        total_vck, energy = spread.shoot(start_vck, threshold, tell_bounces)
    white = FIRST * float(areas_v.sum()) * albedo_vc.shape[1]
    counted.energy = [each / white for each in energy]
    return total_vck


def gathered_tiles(
    surface: Surface, gatherer: Gatherer, lit_vck: NDArray[np.float32], block: int
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield transfer at points of a scene that gather what its vertices send on: first point, (n, channel, n_coeff)."""
    albedo_nc, flat_vq = albedo_of(surface), lit_vck.reshape(len(lit_vck), -1)
    for first in range(0, gatherer.points.count, block):
        end = min(first + block, gatherer.points.count)
        coeffs_nck = np.empty((end - first, *lit_vck.shape[1:]), np.float32)
        for start, stop in gatherer.tiles(first, end):
            direct_nk, rows = gatherer.hits(start, stop)
            got_nck = (rows @ flat_vq).reshape(stop - start, *lit_vck.shape[1:])
            coeffs_nck[start - first : stop - first] = got_nck + direct_nk[:, None, :]
        yield first, albedo_nc[first:end, :, None] * coeffs_nck


def check_bounces(bounces: int, threshold: float, way: str) -> None:
    """Raise InputError if these say no end."""
    if way not in WAYS:
        raise InputError(f"bounces must be by {' or '.join(WAYS)}, got {way!r}")
    if not 0 <= bounces <= MOST_BOUNCES:
        raise InputError(f"bounces must be 0 to {MOST_BOUNCES}, got {bounces}")
    if not 0.0 <= threshold < 1.0 or (way == "shoot" and not threshold > 0.0):
        raise InputError(f"threshold must be at least 0, above 0 where light is shot, and below 1, got {threshold}")
