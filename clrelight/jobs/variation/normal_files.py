"""Pictures of normals, albedo and confidence, and meshes of heights."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from clrelight.durable import replacing
from clrelight.images import write_image
from clrelight.jobs.pictures import holds_floats
from clrelight.variation.maps import NormalMap

_HALF, _CODES = 32767.5, 65535

Path = str | os.PathLike[str]


def write_maps(out: Path, green: str, found: NormalMap, albedo: Path | None, confidence: Path | None) -> None:
    """Write a picture of normals, and of albedo and confidence where they are wanted."""
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


def write_ply(path: Path, heights_hw: NDArray[np.float32], found: NormalMap) -> None:
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
