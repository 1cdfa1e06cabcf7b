"""The pictures that all others of a view are sums of, from a few photographs under known lights."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.device import Device
from clrelight.errors import InputError, counted
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.fit import fit
from clrelight.jobs.inputs import StackLike, lend_fit, lend_stack, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.variation.component_pictures import check_folder, pictures_of_map, write_pictures
from clrelight.jobs.variation.normals import normals
from clrelight.memory import DEFAULT_MEMORY, TILE_BYTES
from clrelight.store import create_fit
from clrelight.tiles import row_tiles
from clrelight.variation.inverse import MOST_CONDITION, told_degree
from clrelight.variation.maps import NormalMap
from clrelight.variation.normals import LEAST_LIGHTS
from clrelight.variation.subspaces import DEGREE, half_cosine_factors

WAYS = ("lights", "normals")
METHOD = "normals"
"""Of a map that was made of normals; one by lights is a fit by `uls`."""

Path = str | os.PathLike[str]


def basis_images(
    source: StackLike,
    *,
    out: Path | None = None,
    by: str = "lights",
    degree: int | None = None,
    pictures: Path | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap | Report:
    """Return, or write, the nine pictures (of degree 2) that pictures under any distant light are sums of.

    ``image = sum_k Y_k(d) picture_k`` under a lamp at d (illumination-variation, section 0.4.3): a map for `relight`.

    Parameters
    ----------
    source : path or LightStack
        A few photographs under known lights.
    out : path, optional
        A fit file to write; without it the map is returned.
    by : str
        ``"lights"``: least squares over the photographs, nine and more, shadows that parts cast among what they hold.
        ``"normals"``: albedo times the half-cosine's harmonics of the normals, which three photographs tell (Basri and
        Jacobs): no photograph has to tell nine apart, and no cast shadow is in them.
    degree : int, optional
        0, 1 or 2; default: 2, or by lights the largest below whose condition is at most 100, and a note.
    pictures : path, optional
        A new folder for pictures of them: grey is 0.
    memory : int or str
        Bytes that samples may take on their way; a map that is returned, and normals, come on top.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Raises
    ------
    InputError
        If the lights do not tell pictures of a degree that is asked for, or normals; or a file cannot be written.
    """
    kept = report_for(report)
    if by not in WAYS:
        raise InputError(f"by must be lights or normals, got {by!r}")
    wanted = DEGREE if degree is None else whole(degree, "degree")
    if not 0 <= wanted <= DEGREE:
        raise InputError(f"degree must be within 0 and {DEGREE}, got {wanted}: a matte surface shows hardly more")
    if pictures is not None:
        check_folder(os.fsdecode(pictures))
        if out is not None and os.path.realpath(pictures) == os.path.realpath(out):
            raise InputError(f"cannot write {os.fsdecode(out)} twice: the map and the pictures have that name")
    more: dict[str, Any] = {"memory": memory, "device": device, "progress": progress, "report": kept}
    with lend_stack(source, kept) as stack:
        record = FitRecord(wanted, METHOD, stack.peak, stack.transfer, stack.directions_i3, {}, stack.name)
    if by == "lights":
        chosen, condition_l, note = _told(record.directions_i3, degree)
        record = replace(record, degree=chosen)
        made = fit(source, "uls", chosen, out=out, **more)
        if note is not None:
            kept.note(note)
    else:
        made, condition = _by_normals(source, record, out, more)
        condition_l = [condition]
    if pictures is not None:
        with lend_fit(made if out is None else out) as held:  # type: ignore[arg-type]
            shown = pictures_of_map(held)
        kept.facts |= {"folder": os.fsdecode(pictures), "files": write_pictures(pictures, shown)}
    kept.facts |= {
        "by": by,
        "degree": record.degree,
        "count": coefficient_count(record.degree),
        "condition": condition_l,
    }
    return made


def _told(directions_i3: NDArray[np.float64], degree: int | None) -> tuple[int, list[float], str | None]:
    """Return the degree that the lights tell, its condition, and a note where it is not 2; InputError where it is 0."""
    chosen, condition_l = told_degree(directions_i3, degree)
    if degree is not None or chosen == DEGREE:
        return chosen, condition_l.tolist(), None
    count = len(directions_i3)
    text = (
        f"{counted(count, 'light does', 'lights do')} not tell {coefficient_count(DEGREE)} pictures apart: the "
        f"condition is {condition_l[DEGREE]:.3g}, at most {MOST_CONDITION:g}"
    )
    tells_normals = count >= LEAST_LIGHTS and np.linalg.cond(directions_i3) <= MOST_CONDITION
    more = "; --by normals makes nine of a convex matte view" if tells_normals else ""
    if chosen == 0:
        raise InputError(f"{text}, and not {coefficient_count(1)} either{more}")
    return chosen, condition_l.tolist(), f"{text}: these are {coefficient_count(chosen)}{more}"


def _by_normals(source: StackLike, record: FitRecord, out: Path | None, more: Mapping[str, Any]) -> tuple[Any, float]:
    """Return, or write, albedo times the half-cosine's harmonics of the normals; and the lights' condition."""
    kept = more["report"]
    with claimed([out], paths_among(source), kept):
        found = cast(NormalMap, normals(source, **more))
        record = replace(record, config={"made": "normals", "normals": found.method})
        factor_k, (height, width) = half_cosine_factors(record.degree), found.normals_hw3.shape[:2]
        shape = (height, width, found.albedo_hwc.shape[2])

        def rows_of(first: int, end: int) -> NDArray[np.float32]:
            normals_p3 = found.normals_hw3[first:end].reshape(-1, 3).astype(np.float64)
            basis_pk = evaluate_basis(normals_p3, record.degree) * factor_k
            basis_pk[~np.any(normals_p3, axis=1)] = 0.0
            albedo_p1c = found.albedo_hwc[first:end].reshape(-1, 1, shape[2])
            rows_pkc = (basis_pk[:, :, None] * albedo_p1c).astype(np.float32)
            return np.ascontiguousarray(rows_pkc.transpose(1, 0, 2)).reshape(-1, end - first, *shape[1:])

        if out is None:
            return record.to_map(rows_of(0, height)), found.condition
        since = time.perf_counter()
        with create_fit(out, record, shape) as sink, stage(more["progress"], "writing") as tell:
            rows = sink.coeffs_khwc.chunks[1]
            step = max(TILE_BYTES // (64 * len(factor_k) * width * shape[2] * rows), 1) * rows
            for first, end in row_tiles((0, height), step):
                sink.write_rows(first, rows_of(first, end), None, None)
                tell(end, height)
        kept.add("write", since)
    kept.facts = {"file": os.fsdecode(out), **kept.facts}
    return kept, found.condition
