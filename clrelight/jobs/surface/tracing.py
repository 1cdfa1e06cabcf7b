"""Transfer functions being made: along which rays, by whom, and how they come to a file."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.farm import Arrays, Chore, Farm, check_written, shared_path
from clrelight.jobs.report import Progress, Report, stage
from clrelight.jobs.surface.asked import Asked, read_asked
from clrelight.store import FitSink, create_fit
from clrelight.surface import Surface
from clrelight.tiles import row_tiles
from clrelight.transfer.gathering import Gatherer, Tally, points_at_once, points_of
from clrelight.transfer.notes import behind_note, probe
from clrelight.transfer.rays import RayScene
from clrelight.transfer.transport import Transport

TRANSFER_PART, TRANSFER_HITS = "transfer-part", "transfer-hits"
_PART_RAYS = 1 << 23
"""Directions of points that another process looks in: about a second of work."""


@dataclass(frozen=True)
class SharedTransfer:
    """Transfer of a mesh file, of which other processes make parts: see `clrelight.jobs.surface.transfer_chores`."""

    farm: Farm
    mesh: str
    options: dict[str, Any]
    reads: tuple[str, ...]

    @classmethod
    def of(
        cls, farm: Farm, mesh: str | os.PathLike[str] | Surface, out: str | os.PathLike[str] | None, asked: Asked
    ) -> SharedTransfer:
        """Return what makes parts; InputError where other processes cannot."""
        path = shared_path(mesh, "the mesh")
        check_written(out)
        if asked.kind == "interreflected" and asked.texels is not None:
            raise InputError("interreflected transfer at texels is made by one process: leave out --jobs and --engine")
        lights = () if asked.lights is None else (os.path.abspath(os.fsdecode(asked.lights)),)
        given = {**asdict(asked), **({"lights": lights[0]} if lights else {})}
        given = {name: list(each) if isinstance(each, tuple) else each for name, each in given.items()}
        return cls(farm, path, {n: v for n, v in given.items() if v is not None}, lights)

    def make(self, parts: Sequence[tuple[int, int]], block: int) -> Iterator[Arrays]:
        """Return the arrays of parts of the vertices."""
        given = [{**self.options, "part": list(part), "block": block} for part in parts]
        return self.farm.do([Chore(TRANSFER_PART, self.mesh, each, self.reads) for each in given], "tracing rays")

    def trace(self, groups: Sequence[list[tuple[int, int]]]) -> Iterator[Arrays]:
        """Return the arrays of hits of groups of parts of the vertices."""
        given = [{**self.options, "parts": [list(part) for part in group]} for group in groups]
        return self.farm.do([Chore(TRANSFER_HITS, self.mesh, each, self.reads) for each in given], "tracing rays")


@dataclass
class SharedHits:
    """Hits of rays that other processes trace: see `clrelight.transfer.bounces.Traced`."""

    shared: SharedTransfer
    samples: int
    n_vertex: int
    groups: list[list[tuple[int, int]]] = field(default_factory=list)
    places: list[tuple[int, int]] = field(default_factory=list)

    def hits(
        self, parts: Sequence[tuple[int, int]], tally: Tally
    ) -> Iterator[tuple[NDArray[np.float32], scipy.sparse.csr_array]]:
        """See `Traced`."""
        points = max(part[1] - part[0] for part in parts)
        together = max(_PART_RAYS // (points * self.samples), 1)
        self.groups = [list(parts[first:end]) for first, end in row_tiles((0, len(parts)), together)]
        self.places = [(at, number) for at, group in enumerate(self.groups) for number in range(len(group))]
        for group, found in zip(self.groups, self.shared.trace(self.groups), strict=True):
            rays, hits, behind = found["counts"].tolist()
            tally.rays, tally.hits, tally.behind = tally.rays + rays, tally.hits + hits, tally.behind + behind
            for number in range(len(group)):
                yield found[f"coeffs_vk{number}"], self._rows(found, number)

    def rows(self, number: int) -> scipy.sparse.csr_array:
        """See `Traced`; they are on the disk."""
        group, within = self.places[number]
        (found,) = self.shared.trace([self.groups[group]])
        return self._rows(found, within)

    def _rows(self, found: Arrays, number: int) -> scipy.sparse.csr_array:
        data, indices, indptr = (found[f"{name}{number}"] for name in ("data", "indices", "indptr"))
        return scipy.sparse.csr_array((data, indices, indptr), shape=(len(indptr) - 1, self.n_vertex))


@dataclass(frozen=True)
class Tracing:
    """Transfer that is asked for, of a surface: the body in the rays' way, or points of it."""

    surface: Surface
    body: Surface
    wanted: Transport
    config: dict[str, Any]
    report: Report
    progress: Progress | None

    def run(self, out: str | os.PathLike[str] | None, shared: SharedTransfer | None) -> CoefficientMap | Report:
        """Make it; write it where there is a file to write."""
        record, shape = self._record(), (*self.surface.map_shape, self._channels)
        scene, tally = self._scene(), Tally()
        if out is None:
            coeffs_khwc = np.empty((coefficient_count(self.wanted.degree), *shape), np.float32)
            flat_kvc = coeffs_khwc.reshape(len(coeffs_khwc), self.surface.n_vertex, shape[2])
            with ExitStack() as stack:
                for first, tile_kvc in self._tiles(scene, tally, self.surface.n_vertex, stack):
                    flat_kvc[:, first : first + tile_kvc.shape[1]] = tile_kvc
            self._tell(tally)
            return record.to_map(coeffs_khwc)
        with create_fit(out, record, shape) as sink, ExitStack() as stack:
            block = self._block(sink)
            if shared is None or self.wanted.kind == "interreflected":
                tiles = self._tiles(scene, tally, block, stack, shared)
            else:
                tiles = self._gather(shared, tally, block)
            self._write(sink, tiles)
            since = time.perf_counter()
        self.report.add("write", since)
        self._tell(tally)
        self.report.facts = {"file": os.fsdecode(out), **self.report.facts, "bytes_on_disk": os.stat(out).st_size}
        return self.report

    @property
    def _channels(self) -> int:
        return 1 if self.surface.albedo_vc is None else self.surface.albedo_vc.shape[1]

    def _record(self) -> FitRecord:
        samples = self.wanted.samples
        # Directions of the functions' own frames: of local ones, those of the rays are in others at each vertex.
        is_kept = samples is not None and self.surface.tangents_v3 is None
        directions_i3 = samples.directions_s3 if samples is not None and is_kept else np.array([[0.0, 0.0, 1.0]])
        return FitRecord(
            self.wanted.degree,
            "transfer",
            1.0,
            "linear",
            directions_i3,
            self.config,
            self.surface.name,
            self.surface,
        )

    def _scene(self) -> RayScene | None:
        samples, facts = self.wanted.samples, self.report.facts
        facts |= {"vertices": self.surface.n_vertex, "faces": len(self.surface.faces_f3), "degree": self.wanted.degree}
        facts |= self.config
        if self.wanted.kind == "unshadowed" or samples is None:
            return None
        since = time.perf_counter()
        with stage(self.progress, "preparing rays"):
            scene = RayScene(self.body)
            if self.wanted.kind == "shadowed":
                seen = probe(self.body, scene, samples)
                self.report.note(*behind_note(seen))
                facts["from_behind"] = seen.behind / max(seen.rays, 1)
        self.report.add("prepare", since)
        return scene

    def _block(self, sink: FitSink) -> int:
        """Return vertices that are written together: whole rows of chunks."""
        width, chunk = self.surface.map_shape[1], self.surface.map_shape[1] * sink.coeffs_khwc.chunks[1]
        vertex_bytes = 4 * coefficient_count(self.wanted.degree) * self._channels
        most = max(1, min(self.wanted.memory // 4 // vertex_bytes, self.surface.n_vertex))
        return chunk * max(1, most // chunk) if most >= chunk else width * max(1, most // width)

    def _tiles(
        self,
        scene: RayScene | None,
        tally: Tally,
        block: int,
        stack: ExitStack,
        shared: SharedTransfer | None = None,
    ) -> Iterator[tuple[int, NDArray[np.float32]]]:
        tell = stack.enter_context(stage(self.progress, "tracing rays"))
        told = stack.enter_context(stage(self.progress, "bounces")) if self.wanted.kind == "interreflected" else None
        elsewhere = None
        if shared is not None and self.wanted.samples is not None:
            elsewhere = SharedHits(shared, self.wanted.samples.count, self.surface.n_vertex)
        tiles = self.wanted.tiles(
            self.surface, scene, block=block, tally=tally, tell=tell, tell_bounces=told, elsewhere=elsewhere
        )
        since = time.perf_counter()
        for tile in tiles:
            self.report.add("trace", since)
            yield tile
            since = time.perf_counter()
        self.report.add("trace", since)

    def _gather(self, shared: SharedTransfer, tally: Tally, block: int) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """Yield what `_tiles` does, of parts that other processes make."""
        since, samples, count = time.perf_counter(), self.wanted.samples, self.surface.n_vertex
        together = 1 if samples is None else points_at_once(samples.count, self.wanted.degree, self.wanted.memory)
        together *= max(_PART_RAYS // (together * (1 if samples is None else samples.count)), 1)
        blocks = row_tiles((0, count), block)
        made = shared.make([part for each in blocks for part in row_tiles(each, together)], block)
        for first, end in blocks:
            parts_kvc = []
            for _ in row_tiles((first, end), together):
                found = next(made)
                tally.rays += int(found["rays"])
                parts_kvc.append(found["coeffs_kvc"])
            self.report.add("trace", since)
            yield first, np.concatenate(parts_kvc, axis=1)
            since = time.perf_counter()

    @functools.cached_property
    def bare_scene(self) -> RayScene | None:
        """What rays of shadowed transfer meet."""
        return RayScene(self.body) if self.wanted.kind == "shadowed" else None

    def some(self, part: tuple[int, int], block: int) -> tuple[NDArray[np.float32], int]:
        """Return the functions of some vertices, (n_coeff, n, channel), and how many rays were traced."""
        tally, scene = Tally(), self.bare_scene
        tiles = self.wanted.tiles(self.surface, scene, block=block, tally=tally, part=part)
        return np.concatenate([tile_kvc for _, tile_kvc in tiles], axis=1), tally.rays

    @functools.cached_property
    def gatherer(self) -> Gatherer:
        """What looks in the directions of interreflected transfer, as `interreflected` makes it."""
        wanted, scene = self.wanted, RayScene(self.body)
        if wanted.samples is None:
            raise TypeError("interreflected transfer needs samples")
        points = points_of(self.surface, scene)
        return Gatherer(points, wanted.samples, wanted.degree, scene, wanted.memory // 4, Tally())

    def hits(self, parts: Sequence[tuple[int, int]]) -> dict[str, NDArray]:
        """Return what `SharedHits` reads of parts of the vertices, and ``counts`` of rays, hits, and from behind."""
        found: dict[str, NDArray] = {}
        self.gatherer.tally = tally = Tally()
        for number, part in enumerate(parts):
            coeffs_vk, rows = self.gatherer.hits(*part)
            found[f"coeffs_vk{number}"] = coeffs_vk
            found |= {f"{name}{number}": getattr(rows, name) for name in ("data", "indices", "indptr")}
        return {**found, "counts": np.array([tally.rays, tally.hits, tally.behind])}

    def _write(self, sink: FitSink, tiles: Iterator[tuple[int, NDArray[np.float32]]]) -> None:
        width = self.surface.map_shape[1]
        for first, tile_kvc in tiles:
            since = time.perf_counter()
            rows_khwc = tile_kvc.reshape(tile_kvc.shape[0], -1, width, self._channels)
            sink.write_rows(first // width, np.ascontiguousarray(rows_khwc), None, None)
            self.report.add("write", since)

    def _tell(self, tally: Tally) -> None:
        facts, seconds = self.report.facts, self.report.seconds.get("trace", 0.0)
        facts["rays"] = tally.rays
        if tally.rays:
            facts["rays_per_second"] = tally.rays / max(seconds, 1e-9)
        if tally.energy is not None:
            facts["energy"] = tally.energy if self.wanted.way == "gather" else [tally.energy[0], tally.energy[-1]]
            facts["from_behind"] = tally.behind / max(tally.rays, 1)
            self.report.note(*behind_note(tally))


def prepare_transfer(
    mesh: str | os.PathLike[str] | Surface, asked: Asked, report: Report, progress: Progress | None = None
) -> Tracing:
    """Return transfer of a mesh, ready to be made."""
    return Tracing(*read_asked(mesh, asked, report, progress), report, progress)
