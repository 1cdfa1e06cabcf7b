"""Make the transfer functions of a surface: to a file, part by part, or to a map in memory."""

from __future__ import annotations

import os
from collections.abc import Sequence

from clrelight.dataset import CoefficientMap
from clrelight.jobs.farm import Farm
from clrelight.jobs.inputs import paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for
from clrelight.jobs.surface.asked import Asked
from clrelight.jobs.surface.tracing import SharedTransfer, prepare_transfer
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.surface import Surface
from clrelight.threads import on_one_thread


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
    farm: Farm | None = None,
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
    farm : Farm, optional
        Other processes that trace the rays of some vertices each (not of interreflected transfer at texels); `mesh` is
        a file then, and `out` is given.

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
    how = Asked(kind, degree, samples, lights, frame, albedo, bounces, way, threshold, up, texels, order, seed, budget)
    with claimed([out], paths_among(mesh, lights), kept), on_one_thread():
        shared = None if farm is None else SharedTransfer.of(farm, mesh, out, how)
        return prepare_transfer(mesh, how, kept, progress).run(out, shared)
