"""Glossy operators of a mesh, and what they reflect under a light."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import overload

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.inputs import (
    FitLike,
    lend_fit,
    path_text,
    paths_among,
    whole,
)
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.surface.meshes import MeshLike, mesh_config, take_surface
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import write_fit
from clrelight.store.fits import create_fit
from clrelight.surface import Surface
from clrelight.threads import on_one_thread
from clrelight.transfer.brdfs import Brdf, Colour, parse_brdf
from clrelight.transfer.frames import with_frames
from clrelight.transfer.operator_plan import OperatorPlan, plan_operators
from clrelight.transfer.operators import channel_count, operator_map, operator_tiles
from clrelight.transfer.reflection import add_diffuse
from clrelight.transfer.vertex_order import reorder


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
    light_frame: str = ...,
    order: str = ...,
    add: FitLike | None = ...,
    colors: bool = ...,
    up: str | None = ...,
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
    light_frame: str = ...,
    order: str = ...,
    add: FitLike | None = ...,
    colors: bool = ...,
    up: str | None = ...,
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
    frame: str = "global",
    light_frame: str = "global",
    order: str = "file",
    add: FitLike | None = None,
    colors: bool = False,
    up: str | None = None,
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
        ``"global"``: views in the axes of the mesh; ``"local"``: in each vertex's frame.
    light_frame : str
        The same of the light; ``"local"`` needs local views. The light is then turned for each vertex when it is used,
        and operators differ only by what is hidden: codecs take far less for them.
    order : str
        Of the vertices: ``"file"``, ``"morton"``, ``"hilbert"``, ``"graph"``; as images ``"blocks"``, ``"sorted"``.
    add : path or CoefficientMap, optional
        Diffuse transfer of the same vertices in the same order, which is added.
    colors : bool
        Scale the matte part by the colours that the file has.
    up : str, optional
        The axis of the file that points up: ``"y"`` or ``"z"``; default: z, of GLB y.
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
    views = None if view_degree is None else whole(view_degree, "view degree")
    target = None if out is None else path_text(out, "a fit to write")
    with claimed([target], paths_among(mesh, add), kept), on_one_thread():
        since = time.perf_counter()
        with stage(progress, "reading the mesh"):
            read = with_frames(take_surface(mesh, colors=colors, up=up), frame)
            kept.note(*read.notes)
            since = kept.add("read", since)
        with stage(progress, "ordering vertices"):
            surface = reorder(read, order)[0]
            since = kept.add("order", since)
        with stage(progress, "planning"):
            plan = plan_operators(
                function,
                whole(degree, "degree"),
                view_degree=views,
                samples=whole(samples, "samples"),
                extension=extension,
                light_frame=light_frame,
            )
        plan.config.update({"frame": frame, **mesh_config(order, up)})
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
