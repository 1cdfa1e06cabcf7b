"""Transfer that is asked for: of which surface, in which directions, and what its file says of that."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, counted
from clrelight.jobs.inputs import read_directions, whole
from clrelight.jobs.report import Progress, Report, stage
from clrelight.jobs.surface.meshes import mesh_config
from clrelight.surface import Surface
from clrelight.transfer.frames import with_frames
from clrelight.transfer.mesh_files import read_mesh
from clrelight.transfer.samples import DEFAULT_COUNT, Samples, given_samples, make_samples
from clrelight.transfer.texels import texel_surface
from clrelight.transfer.transport import Transport
from clrelight.transfer.vertex_order import reorder

FROM_FILE = "file"
"""Albedo is what a file says of its vertices' colours."""


@dataclass(frozen=True)
class Asked:
    """What is asked for, as `clrelight.jobs.surface.transfer.transfer` takes it."""

    kind: str
    degree: int
    samples: int | None
    lights: str | os.PathLike[str] | None
    frame: str
    albedo: float | Sequence[float] | str | None
    bounces: int
    way: str
    threshold: float | None
    up: str | None
    texels: Sequence[int] | None
    order: str
    seed: int
    memory: int


def read_asked(
    mesh: str | os.PathLike[str] | Surface, asked: Asked, report: Report, progress: Progress | None
) -> tuple[Surface, Surface, Transport, dict[str, Any]]:
    """Return the points of a surface, the body in the rays' way, what is to be made, and what the file says of it."""
    samples = _samples(asked.kind, asked.samples, asked.lights, whole(asked.seed, "seed"), report)
    if asked.texels is not None and asked.order != "file":
        raise InputError("--order is of vertices: texels lie as they lie")
    share = (1e-3 if asked.way == "shoot" else 0.0) if asked.threshold is None else float(asked.threshold)
    degree, bounces = whole(asked.degree, "degree"), whole(asked.bounces, "bounces")
    wanted = Transport(degree, asked.kind, samples, bounces, share, asked.way, asked.memory)
    since = time.perf_counter()
    with stage(progress, "reading the mesh"):
        body = reorder(_surface(mesh, asked.albedo, asked.up, report), asked.order)[0]
        surface = with_frames(body if asked.texels is None else _texels(body, asked.texels, report), asked.frame)
    report.add("read", since)
    config = _config(wanted, asked.frame, asked.samples, asked.lights, asked.seed) | mesh_config(asked.order, asked.up)
    return surface, body, wanted, config


def _samples(
    kind: str, count: int | None, lights: str | os.PathLike[str] | None, seed: int, report: Report
) -> Samples | None:
    if lights is not None:
        if count is not None:
            raise InputError("directions come from --lights or are --samples many: give one of the two")
        found = given_samples(read_directions(lights, report))
        if not found.is_whole:
            report.note(
                f"{counted(found.count, 'direction does', 'directions do')} not cover the sphere: what comes "
                "from elsewhere is not in the functions"
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
