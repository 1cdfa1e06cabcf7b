"""Find the normals of a stack under its known lights, as maps in memory or as pictures."""

from __future__ import annotations

import os
import time

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.durable import replacing
from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.jobs.inputs import StackLike, lend_stack, opened_on, path_text, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.pictures import holds_floats
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.variation.heights import integrate_normals
from clrelight.variation.maps import NormalMap, map_normals

GREENS = ("up", "down")
_TOLD_FLOOR = 0.01
_HALF, _CODES = 32767.5, 65535

Path = str | os.PathLike[str]


def normals(
    source: StackLike,
    *,
    out: Path | None = None,
    method: str = "robust",
    green: str = "up",
    albedo: Path | None = None,
    confidence: Path | None = None,
    height: Path | None = None,
    ply: Path | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> NormalMap | Report:
    """Find the normal and the albedo of every pixel from its samples under known distant lights.

    Parameters
    ----------
    source : path or LightStack
        Its lights have one intensity, or the images were divided by theirs.
    out : path, optional
        A picture of the normals: floats as they are in ``.exr`` or ``.tif``; ``(n + 1) / 2`` in 16 bits in ``.png``.
        Without it the maps are returned.
    method : str
        ``"robust"``, or ``"least-squares"``: of all samples, as they are.
    green : str
        Which way the second channel of pictures grows: ``"up"`` as in OpenGL (y up), ``"down"`` as in DirectX.
    albedo, confidence, height : path, optional
        Pictures of albedo, of confidence from 0 to 1, and of the height towards the camera in pixels (floats only).
    ply : path, optional
        The height as a mesh.
    memory : int or str
        Bytes that samples may take on their way; the maps come on top.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    NormalMap
        With `out` instead the report.

    Raises
    ------
    InputError
        If the lights do not determine normals, samples are no radiance, or a file cannot be written.
    """
    kept, budget = report_for(report), count_bytes(memory)
    if green not in GREENS:
        raise InputError(f"green must be up or down, got {green!r}")
    beside = {"albedo": albedo, "confidence": confidence, "height": height, "ply": ply}
    if out is None and any(beside.values()):
        raise InputError("pictures beside the normals need a picture of the normals: give out")
    if height is not None and not holds_floats(path_text(height, "heights")):
        raise InputError(f"heights are floats, for .exr or .tif, got {os.fsdecode(height)}")
    if ply is not None and not path_text(ply, "a mesh").lower().endswith(".ply"):
        raise InputError(f"a mesh goes to a .ply, got {os.fsdecode(ply)}")
    with (
        claimed([out, *beside.values()], paths_among(source), kept),
        opened_on(device, kept) as opened,
        lend_stack(source, kept) as stack,
    ):
        with stage(progress, "finding normals") as tell:
            found = map_normals(stack, method, device=opened, memory_bytes=budget, progress=tell, add_time=kept.add)
        _tell(found, stack.n_light, method, kept)
        if out is None:
            return found
        since = time.perf_counter()
        heights_hw = None
        if height is not None or ply is not None:
            with stage(progress, "integrating"):
                heights_hw = integrate_normals(found.normals_hw3, stack.mask_hw)
            since = kept.add("integrate", since)
        with stage(progress, "writing"):
            _write(out, green, found, albedo, confidence)
            if heights_hw is not None and height is not None:
                write_image(height, heights_hw)
            if heights_hw is not None and ply is not None:
                _write_ply(ply, heights_hw, found)
        kept.add("write", since)
    kept.facts["files"] = [os.fsdecode(each) for each in (out, *beside.values()) if each is not None]
    return kept


def _tell(found: NormalMap, n_light: int, method: str, report: Report) -> None:
    seen_hw = found.normals_hw3.any(axis=2)
    report.facts |= {
        "method": method,
        "n_light": n_light,
        "condition": found.condition,
        "pixels": int(np.count_nonzero(seen_hw)),
        "confidence_median": float(np.median(found.confidence_hw[seen_hw])) if seen_hw.any() else 0.0,
        "floor": found.floor,
    }
    if found.floor > _TOLD_FLOOR:
        report.note(
            f"shadows hold {found.floor:.1%} of the albedo: light from elsewhere, taken off before normals are found"
        )


def _write(out: Path, green: str, found: NormalMap, albedo: Path | None, confidence: Path | None) -> None:
    write_image(out, encode_normals(found.normals_hw3, green, floats=holds_floats(os.fsdecode(out))))
    for name, values_hwc in ((albedo, found.albedo_hwc), (confidence, found.confidence_hw)):
        if name is not None:
            write_image(name, values_hwc if holds_floats(os.fsdecode(name)) else _codes(values_hwc))


def encode_normals(normals_hw3: NDArray[np.float32], green: str, *, floats: bool) -> NDArray:
    """Return what a picture of normals holds: vectors as they are, or 16-bit codes of ``(n + 1) / 2``."""
    shown_hw3 = normals_hw3 * np.array([1.0, 1.0 if green == "up" else -1.0, 1.0], np.float32)
    return shown_hw3 if floats else np.rint(_HALF * shown_hw3 + _HALF).astype(np.uint16)


def _codes(values_hwc: NDArray[np.float32]) -> NDArray[np.uint16]:
    return np.rint(_CODES * np.clip(values_hwc, 0.0, 1.0)).astype(np.uint16)


def _write_ply(path: Path, heights_hw: NDArray[np.float32], found: NormalMap) -> None:
    """Write the pixels that have a normal as vertices, and two triangles between every four of them."""
    inside_hw: NDArray[np.bool_] = np.any(found.normals_hw3 != 0.0, axis=2)
    row_v, column_v = np.nonzero(inside_hw)
    number_hw = np.cumsum(inside_hw.ravel(), dtype=np.int32).reshape(inside_hw.shape) - 1
    whole_hw = inside_hw[1:, 1:] & inside_hw[1:, :-1] & inside_hw[:-1, 1:] & inside_hw[:-1, :-1]
    corners = number_hw[:-1, :-1], number_hw[1:, :-1], number_hw[1:, 1:], number_hw[:-1, 1:]
    a_f, b_f, c_f, d_f = (each[whole_hw] for each in corners)
    faces_f3 = np.concatenate([np.stack([a_f, b_f, c_f], axis=1), np.stack([a_f, c_f, d_f], axis=1)])
    vertices_v = np.empty(len(row_v), [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")])
    vertices_v["x"], vertices_v["y"] = column_v, len(heights_hw) - 1 - row_v
    vertices_v["z"] = heights_hw[inside_hw]
    for axis, name in enumerate(("nx", "ny", "nz")):
        vertices_v[name] = found.normals_hw3[..., axis][inside_hw]
    rows_f = np.empty(len(faces_f3), [("count", "u1"), ("corners", "<i4", 3)])
    rows_f["count"], rows_f["corners"] = 3, faces_f3
    header = "\n".join(
        (
            f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices_v)}",
            *(f"property float {name}" for name in vertices_v.dtype.names or ()),
            f"element face {len(rows_f)}\nproperty list uchar int vertex_indices\nend_header\n",
        )
    )
    with replacing(os.fsdecode(path)) as part:
        part.write(header.encode())
        part.write(vertices_v.tobytes())
        part.write(rows_f.tobytes())
