"""Make the transfer functions of a surface: to a file, part by part, or to a map in memory."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.inputs import paths_among, read_directions, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.surface.meshes import mesh_config
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import FitSink, create_fit
from clrelight.surface import Surface
from clrelight.threads import on_one_thread
from clrelight.transfer.frames import with_frames
from clrelight.transfer.gathering import Tally
from clrelight.transfer.mesh_files import read_mesh
from clrelight.transfer.notes import behind_note, probe
from clrelight.transfer.rays import RayScene
from clrelight.transfer.samples import DEFAULT_COUNT, Samples, given_samples, make_samples
from clrelight.transfer.texels import texel_surface
from clrelight.transfer.transport import Transport
from clrelight.transfer.vertex_order import reorder

FROM_FILE = "file"
"""Albedo is what a file says of its vertices' colours."""


def transfer(
    mesh: str | os.PathLike[str] | Surface,
    *,
    out: str | os.PathLike[str] | None = None,
    kind: str = "shadowed",
    degree: int = 4,
    samples: int | None = None,
    lights: str | os.PathLike[str] | None = None,
    frame: str = "global",
    albedo: float | Sequence[float] | str | None = None,
    bounces: int = 3,
    way: str = "gather",
    threshold: float | None = None,
    up: str | None = None,
    texels: Sequence[int] | None = None,
    order: str = "file",
    seed: int = 0,
    memory: int | str = DEFAULT_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap | Report:
    """Make the transfer functions of all vertices: what they send on of the light from each direction.

    Parameters
    ----------
    mesh : path or Surface
        PLY, OBJ, STL, OFF or GLB: see `clrelight.transfer.mesh_files.read_mesh`.
    out : path, optional
        A fit file to write, part by part; without it the map is returned.
    kind : str
        ``"unshadowed"``, ``"shadowed"`` or ``"interreflected"``.
    degree : int
        Of the coefficients.
    samples : int, optional
        Stratified directions, a square; default: 1024, but none of unshadowed transfer, which is exact without.
    lights : path, optional
        Directions from a file instead, each weighted by its Voronoi cell.
    frame : str
        ``"global"``: functions in the axes of the positions; ``"local"``: in each vertex's own, z its normal.
    albedo : float, three numbers or "file", optional
        Of all vertices, from 0 to 1, or the colours that the file has; default: the surface's own, else 1.
    bounces : int
        Of interreflected transfer: at most, where light is gathered.
    way : str
        ``"gather"``, or ``"shoot"`` until `threshold` is left.
    threshold : float, optional
        Bounces end once this share of the direct light is left; default: 0 where light is gathered, else 0.001.
    up : str, optional
        The axis of the file that points up: ``"y"`` or ``"z"``; default: z, of GLB y.
    texels : two whole numbers, optional
        Rows and columns of a texture: functions at the middles of its texels instead of at vertices.
    order : str
        Of the vertices: ``"file"``, ``"morton"``, ``"hilbert"``, ``"graph"``; as images ``"blocks"``, ``"sorted"``.
    seed : int
        Of the stratified directions.
    memory : int or str
        Bytes of rays and what they meet; the mesh comes on top, and of interreflected transfer three maps.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    CoefficientMap
        (n_coeff, n_vertex, 1, channel), or a grid's rows and columns, with the surface; with `out` instead the report.

    Raises
    ------
    InputError
        If the mesh is none, what is asked for makes no sense, or `out` cannot be written.
    """
    kept, budget = report_for(report), count_bytes(memory)
    with claimed([out], paths_among(mesh, lights), kept), on_one_thread():
        given = _samples(kind, samples, lights, whole(seed, "seed"), kept)
        if texels is not None and order != "file":
            raise InputError("--order is of vertices: texels lie as they lie")
        share = (1e-3 if way == "shoot" else 0.0) if threshold is None else float(threshold)
        wanted = Transport(whole(degree, "degree"), kind, given, whole(bounces, "bounces"), share, way, budget)
        since = time.perf_counter()
        with stage(progress, "reading the mesh"):
            body = reorder(_surface(mesh, albedo, up, kept), order)[0]
            surface = with_frames(body if texels is None else _texels(body, texels, kept), frame)
        kept.add("read", since)
        config = {**_config(wanted, frame, samples, lights, seed), **mesh_config(order, up)}
        return _Transfer(surface, body, wanted, config, kept, progress).run(out)


def _samples(
    kind: str, count: int | None, lights: str | os.PathLike[str] | None, seed: int, report: Report
) -> Samples | None:
    if lights is not None:
        if count is not None:
            raise InputError("directions come from --lights or are --samples many: give one of the two")
        found = given_samples(read_directions(lights, report))
        if not found.is_whole:
            report.note(
                f"{found.count} directions do not cover the sphere: what comes from elsewhere is not in the functions"
            )
        return found
    if count is None and kind == "unshadowed":
        return None
    return make_samples(DEFAULT_COUNT if count is None else whole(count, "samples"), seed)


def _texels(body: Surface, texels: Sequence[int], report: Report) -> Surface:
    sides = [whole(each, "texels") for each in texels]
    if len(sides) != 2:
        raise InputError(f"texels must be two whole numbers, rows and columns, got {list(texels)}")
    surface = texel_surface(body, *sides)
    report.note(*surface.notes)
    return surface


def _surface(mesh: str | os.PathLike[str] | Surface, albedo: Any, up: str | None, report: Report) -> Surface:
    """Return the surface as it is asked for; its notes are told."""
    if isinstance(mesh, Surface):
        if albedo == FROM_FILE or up is not None:
            raise InputError("a surface in memory has no file: leave out --up, and --albedo file")
        surface = mesh
    elif isinstance(mesh, str | os.PathLike):
        surface = read_mesh(mesh, colors=isinstance(albedo, str) and albedo == FROM_FILE, up=up)
    else:
        raise InputError(f"expected the path of a mesh, or a Surface, got {type(mesh).__name__}")
    report.note(*surface.notes)
    if albedo is not None and not (isinstance(albedo, str) and albedo == FROM_FILE):
        surface = replace(surface, albedo_vc=_numbers(albedo, surface.n_vertex))
    return surface


def _numbers(albedo: Any, n_vertex: int) -> NDArray[np.float32]:
    try:
        values = np.atleast_1d(np.asarray(albedo, np.float32))
    except (TypeError, ValueError):
        values = np.empty(0, np.float32)
    if values.shape not in ((1,), (3,)):
        raise InputError(f"albedo must be one number, three, or {FROM_FILE!r}, got {albedo!r}")
    return np.tile(values, (n_vertex, 1))


def _config(
    wanted: Transport, frame: str, samples: int | None, lights: str | os.PathLike[str] | None, seed: int
) -> dict[str, Any]:
    config: dict[str, Any] = {"kind": wanted.kind, "frame": frame}
    if wanted.samples is not None:
        config["samples"] = wanted.samples.count
        config |= {"seed": seed} if lights is None else {"lights": os.path.basename(os.fsdecode(lights))}
    if wanted.kind == "interreflected":
        config |= {"way": wanted.way, "threshold": wanted.threshold}
        if wanted.way == "gather":
            config["bounces"] = wanted.bounces
    return config


@dataclass(frozen=True)
class _Transfer:
    """Transfer that is asked for, of a surface: the body in the rays' way, or points of it."""

    surface: Surface
    body: Surface
    wanted: Transport
    config: dict[str, Any]
    report: Report
    progress: Progress | None

    def run(self, out: str | os.PathLike[str] | None) -> CoefficientMap | Report:
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
            self._write(sink, self._tiles(scene, tally, self._block(sink), stack))
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
        self, scene: RayScene | None, tally: Tally, block: int, stack: ExitStack
    ) -> Iterator[tuple[int, NDArray[np.float32]]]:
        tell = stack.enter_context(stage(self.progress, "tracing rays"))
        told = stack.enter_context(stage(self.progress, "bounces")) if self.wanted.kind == "interreflected" else None
        tiles = self.wanted.tiles(self.surface, scene, block=block, tally=tally, tell=tell, tell_bounces=told)
        since = time.perf_counter()
        for tile in tiles:
            self.report.add("trace", since)
            yield tile
            since = time.perf_counter()
        self.report.add("trace", since)

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
