"""Glossy operators of a mesh, and what they reflect under a light."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.inputs import (
    FitLike,
    FittedLike,
    Path,
    lend_coefficients,
    lend_fit,
    opened_on,
    path_text,
    paths_among,
    whole,
)
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.lighting.light import Light
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import open_fit, read_light, write_fit
from clrelight.store.fits import create_fit
from clrelight.surface import Surface
from clrelight.transfer.brdfs import Brdf, Colour, frames_of, parse_brdf
from clrelight.transfer.mesh_files import read_mesh
from clrelight.transfer.operators import OperatorPlan, channel_count, operator_map, operator_tiles, plan_operators
from clrelight.transfer.reflection import add_diffuse, reflect_map
from clrelight.transfer.reflection import reflect as reflect_towards
from clrelight.transfer.vertex_order import reorder

MeshLike = Path | Surface
FRAMES = ("common", "local")
"""Axes of views: those of the mesh, or each vertex's own."""


@overload
def transfer_operators(
    mesh: MeshLike,
    brdf: str | Brdf = ...,
    degree: int = ...,
    *,
    out: None = None,
    diffuse: Colour | None = ...,
    specular: Colour | None = ...,
    view_degree: int | None = ...,
    samples: int = ...,
    extension: str = ...,
    shadowed: bool = ...,
    frame: str = ...,
    order: str = ...,
    add: FitLike | None = ...,
    memory: int | str = ...,
    progress: Progress | None = ...,
    report: Report | None = ...,
) -> CoefficientMap: ...


@overload
def transfer_operators(
    mesh: MeshLike,
    brdf: str | Brdf = ...,
    degree: int = ...,
    *,
    out: str | os.PathLike[str],
    diffuse: Colour | None = ...,
    specular: Colour | None = ...,
    view_degree: int | None = ...,
    samples: int = ...,
    extension: str = ...,
    shadowed: bool = ...,
    frame: str = ...,
    order: str = ...,
    add: FitLike | None = ...,
    memory: int | str = ...,
    progress: Progress | None = ...,
    report: Report | None = ...,
) -> Report: ...


def transfer_operators(
    mesh: MeshLike,
    brdf: str | Brdf = "phong:20",
    degree: int = 4,
    *,
    out: str | os.PathLike[str] | None = None,
    diffuse: Colour | None = None,
    specular: Colour | None = None,
    view_degree: int | None = None,
    samples: int = 1024,
    extension: str = "smooth",
    shadowed: bool = True,
    frame: str = "common",
    order: str = "file",
    add: FitLike | None = None,
    memory: int | str = DEFAULT_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap | Report:
    """Make the operators from light to reflected radiance of every vertex of a mesh.

    Parameters
    ----------
    mesh : path or Surface
        A mesh file, or a stack or fit of a surface.
    brdf : str or Brdf
        ``"diffuse"``, ``"phong:EXPONENT"``, ``"blinn:EXPONENT"``, ``"ggx:ROUGHNESS"``.
    degree : int
        Of the light.
    out : path, optional
        A fit file to write, tile by tile; without it the map is returned.
    diffuse, specular : float or sequence of 1 or 3 floats, optional
        In place of the BRDF's own.
    view_degree : int, optional
        Of what is reflected, over directions to the eye; default: the light's.
    samples : int
        Rays of each vertex.
    extension : str
        ``"smooth"``, ``"least-squares"``, ``"mirror"`` or ``"zero"``: what becomes of views below the horizon.
    shadowed : bool
        Whether the mesh takes light from itself.
    frame : str
        ``"common"``: views in the axes of the mesh; ``"local"``: in each vertex's frame.
    order : str
        Of the vertices: ``"file"``, ``"morton"``, ``"hilbert"``, ``"graph"`` or ``"blocks"``, an image.
    add : path or CoefficientMap, optional
        Diffuse transfer of the same vertices in the same order, which is added.
    memory : int or str
        Bytes that a tile may take, such as ``"1GiB"``.
    progress, report
        As of other verbs.

    Returns
    -------
    CoefficientMap
        Of `clrelight.transfer.operators.transfer_operators`; with `out` instead the report.

    Raises
    ------
    InputError
        If the mesh, the BRDF or a number is none, or a row of vertices takes more than `memory`.
    """
    kept, budget = report_for(report), count_bytes(memory)
    function = brdf if isinstance(brdf, Brdf) else parse_brdf(str(brdf), diffuse, specular)
    if frame not in FRAMES:
        raise InputError(f"views are in the {' or '.join(FRAMES)} frame, got {frame!r}")
    views = None if view_degree is None else whole(view_degree, "view degree")
    target = None if out is None else path_text(out, "a fit to write")
    with claimed([target], paths_among(mesh, add), kept):
        since = time.perf_counter()
        surface = reorder(_framed(take_surface(mesh), frame), order)[0]
        kept.note(*surface.notes)
        with stage(progress, "planning"):
            plan = plan_operators(
                function,
                whole(degree, "degree"),
                view_degree=views,
                samples=whole(samples, "samples"),
                extension=extension,
            )
        plan.config["order"] = order
        since = kept.add("plan", since)
        job = _Job(surface, plan, shadowed, budget, kept, progress)
        if target is None or add is not None:
            made = job.to_map()
            if add is not None:
                with lend_fit(add) as vectors:
                    made = add_diffuse(made, vectors)
            if target is None:
                return made
            write_fit(target, made)
        else:
            job.to_file(target)
        kept.facts = {"file": target, **kept.facts, "bytes_on_disk": os.stat(target).st_size}
    return kept


def reflect(
    operators: FittedLike,
    light: Light | str | os.PathLike[str],
    *,
    view: ArrayLike | None = None,
    out: str | os.PathLike[str] | None = None,
    mesh: MeshLike | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap | NDArray[np.float32] | Report:
    """Return what a glossy surface reflects under a light: towards an eye, or over all directions.

    Parameters
    ----------
    operators : path, CoefficientMap or Encoded
        Of `transfer_operators`, or encoded.
    light : Light or path
        In the axes of the mesh.
    view : array_like, shape (3,) or (n_vertex, 3), optional
        Directions from the surface to the eye, of any length. Radiance is returned, (height, width, channel) float32.
        Without it a map of coefficients over directions to the eye.
    out : path, optional
        A fit file to write the map to; a view is not for files.
    mesh : path or Surface, optional
        The surface of operators that are encoded, in the same order.
    device : Device or str, optional
        For decoding.
    progress, report
        As of other verbs.
    """
    kept = report_for(report)
    target = None if out is None else path_text(out, "a fit to write")
    if target is not None and view is not None:
        raise InputError("a file holds radiance over all directions: give no view beside it")
    lit = light if isinstance(light, Light) else read_light(light)
    inputs = paths_among(operators, light, mesh)
    with (
        claimed([target], inputs, kept),
        opened_on(device, kept) as opened,
        lend_coefficients(operators, opened, kept, progress) as lent,
    ):
        held = lent if mesh is None else replace(lent, surface=take_surface(mesh))
        since = time.perf_counter()
        with stage(progress, "reflecting"):
            if view is not None:
                towards = np.asarray(view, np.float64)
                length = np.linalg.norm(towards, axis=-1, keepdims=True)
                if not np.all(length > 0.0):
                    raise InputError("a view has no length, or is not finite")
                return reflect_towards(held, lit.coeffs_kc, towards / length)
            made = reflect_map(held, lit.coeffs_kc)
        since = kept.add("reflect", since)
        if target is None:
            return made
        write_fit(target, made)
        kept.add("write", since)
    kept.facts = {"file": target, "degree": made.degree, "shape": list(made.coeffs_khwc.shape), **kept.facts}
    return kept


def take_surface(mesh: MeshLike) -> Surface:
    """Return the surface of a mesh file, or of a fit of ours; InputError where there is none."""
    if isinstance(mesh, Surface):
        return mesh
    name = path_text(mesh, "a mesh")
    if not name.lower().endswith((".h5", ".hdf5")):
        return read_mesh(name)
    with open_fit(name) as fitted:
        if fitted.surface is None:
            raise InputError(f"{name} holds a fit of no surface: give a mesh")
        return fitted.surface


def _framed(surface: Surface, frame: str) -> Surface:
    """Return the surface with the frames that are asked for: its own tangents where it has some."""
    if frame == "common":
        return replace(surface, tangents_v3=None)
    if surface.tangents_v3 is not None:
        return surface
    return replace(surface, tangents_v3=frames_of(surface.normals_v3)[:, 0])


class _Job:
    """Operators of one surface, to be made."""

    def __init__(
        self,
        surface: Surface,
        plan: OperatorPlan,
        shadowed: bool,
        memory: int,
        report: Report,
        progress: Progress | None,
    ) -> None:
        self._surface, self._plan, self._report, self._progress = surface, plan, report, progress
        self._tiles = operator_tiles(surface, plan, shadowed=shadowed, memory=memory)
        self._n_entry = coefficient_count(plan.light_degree) * coefficient_count(plan.view_degree)
        self._channel = channel_count(surface, plan)
        report.facts |= {
            "n_vertex": surface.n_vertex,
            "n_face": len(surface.faces_f3),
            "rays": surface.n_vertex * len(plan.lights_s3) if shadowed else 0,
            "shape": [self._n_entry, *surface.map_shape, self._channel],
            "config": dict(plan.config),
        }

    def to_map(self) -> CoefficientMap:
        """Return all of them."""
        made_dvc = np.empty((self._n_entry, self._surface.n_vertex, self._channel), np.float32)
        self._fill(lambda first, end, tile_dvc: made_dvc.__setitem__((slice(None), slice(first, end)), tile_dvc))
        return operator_map(made_dvc.reshape(self._report.facts["shape"]), self._surface, self._plan)

    def to_file(self, target: str) -> None:
        """Write them tile by tile."""
        height, width = self._surface.map_shape
        blank = np.broadcast_to(np.float32(0), (self._n_entry, height, width, self._channel))
        record = FitRecord.of(operator_map(blank, self._surface, self._plan))
        with create_fit(target, record, (height, width, self._channel)) as sink:

            def write(first: int, end: int, tile_dvc: NDArray[np.float32]) -> None:
                rows_dhwc = tile_dvc.reshape(self._n_entry, -1, width, self._channel)
                sink.write_rows(first // width, rows_dhwc, None, None)

            self._fill(write)

    def _fill(self, put: Callable[[int, int, NDArray[np.float32]], object]) -> None:
        count = self._surface.n_vertex
        with stage(self._progress, "tracing") as tell:
            since = time.perf_counter()
            for first, end, tile_dvc in self._tiles:
                since = self._report.add("trace", since)
                put(first, end, tile_dvc)
                since = self._report.add("write", since)
                tell(end, count)
