"""How a view varies with light: components of a stack, a mesh or normals; the light behind a picture."""

from __future__ import annotations

import os
import pathlib
import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.images import IMAGE_EXTENSIONS, read_image
from clrelight.jobs.inputs import StackLike, lend_stack, path_text, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.variation.component_pictures import (
    check_folder,
    pictures_of_mesh,
    pictures_of_normals,
    pictures_of_stack,
    write_pictures,
)
from clrelight.jobs.written import count_bytes
from clrelight.lighting.light import Light
from clrelight.memory import DEFAULT_MEMORY
from clrelight.passes import rows_within, stack_rows
from clrelight.store import write_light
from clrelight.surface import Surface
from clrelight.transfer.mesh_files import read_mesh
from clrelight.transfer.meshes import vertex_areas
from clrelight.variation.inverse import find_light
from clrelight.variation.maps import SampleReader
from clrelight.variation.subspaces import DEGREE, Subspace, analytic_subspace, empirical_subspace

MESHES = (".glb", ".obj", ".off", ".ply", ".stl")
_LEAST_LENGTH = 0.5
"""Of a vector in a picture of normals; shorter ones stand for no normal."""
_TOLD = (1, 3, 5, 9)

Path = str | os.PathLike[str]


def principal_components(
    source: StackLike | Surface,
    *,
    centred: bool = True,
    degree: int = DEGREE,
    green: str = "up",
    up: str | None = None,
    pictures: Path | None = None,
    memory: int | str = DEFAULT_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Subspace:
    """Return the principal components of a view under all light, from its normals or from photographs.

    Parameters
    ----------
    source : path, LightStack or Surface
        A stack: components of its photographs. A mesh (seen from +z, nothing in the way), or a picture of normals:
        those of a convex matte surface under all distant lights.
    centred : bool
        Whether the mean picture is taken off.
    degree : int
        Of the harmonics (mesh, normals).
    green : str
        Which way the second channel of a picture of normals grows.
    up : str, optional
        The axis of a mesh's file that points up: ``"y"`` or ``"z"``; default: z, of GLB y.
    pictures : path, optional
        A new folder for pictures of the components, and of the harmonics (mesh, normals): grey is 0.
    memory : int or str
        Bytes that a stack's samples may take on their way.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).
    """
    kept, budget = report_for(report), count_bytes(memory)
    since, shown = time.perf_counter(), {}
    if pictures is not None:
        check_folder(path_text(pictures, "a folder of pictures"))
    suffix = pathlib.Path(os.fsdecode(source)).suffix.lower() if isinstance(source, str | os.PathLike) else ""
    if isinstance(source, Surface) or suffix in MESHES:
        surface = source if isinstance(source, Surface) else read_mesh(source, up=up)  # type: ignore[arg-type]
        kept.note(*surface.notes)
        normals_v3, weights_v = visible_vertices(surface)
        found = analytic_subspace(normals_v3, weights_v, degree=whole(degree, "degree"), centred=centred)
        kind, count = "mesh", len(normals_v3)
        if pictures is not None:
            shown = pictures_of_mesh(found, surface, degree)
    elif suffix in IMAGE_EXTENSIONS:
        normals_p3, inside_hw = read_normals(source, green)  # type: ignore[arg-type]
        found = analytic_subspace(normals_p3, degree=whole(degree, "degree"), centred=centred)
        kind, count = "normals", len(normals_p3)
        if pictures is not None:
            normals_hw3 = np.zeros((*inside_hw.shape, 3), np.float32)
            normals_hw3[inside_hw] = normals_p3
            shown = pictures_of_normals(found, normals_hw3, degree)
    else:
        with lend_stack(source, kept) as stack, stage(progress, "adding up") as tell:  # type: ignore[arg-type]
            found = empirical_subspace(_blocks(stack, budget, tell), centred=centred)
            kind, count = "stack", stack.n_light
            if pictures is not None:
                shown = pictures_of_stack(found, stack, centred, budget, tell)
    since = kept.add("components", since)
    if pictures is not None:
        kept.facts |= {"folder": os.fsdecode(pictures), "files": write_pictures(pictures, shown)}
        kept.add("pictures", since)
    kept.facts |= {
        "kind": kind,
        "count": count,
        "centred": centred,
        "variance": [float(each) for each in found.variance_r[:9]],
        "cumulative": {str(each): found.cumulative(each) for each in _TOLD},
    }
    return found


def visible_vertices(surface: Surface) -> tuple[NDArray[np.floating], NDArray[np.float64]]:
    """Return normals of the vertices that face +z, and the areas that they show, times their squared albedo.

    InputError if none does.
    """
    weights_v = vertex_areas(surface) * np.maximum(surface.normals_v3[:, 2], 0.0)
    if surface.albedo_vc is not None:
        weights_v *= np.mean(surface.albedo_vc.astype(np.float64) ** 2, axis=1)
    seen_v = weights_v > 0.0
    if not seen_v.any():
        raise InputError("no vertex of the mesh faces +z: which axis points up? (--up)")
    return surface.normals_v3[seen_v], weights_v[seen_v]


def _blocks(stack: LightStack, budget: int, tell: object) -> Iterator[NDArray[np.float32]]:
    """Yield linear samples of the pixels inside the mask, (n_light, P), tile by tile."""
    height, width, channel = stack.image_shape
    row = width * channel * stack.n_light * (2 * stack.images_ihwc.dtype.itemsize + 12)
    step, reader = rows_within(row, budget), SampleReader(stack)
    with stack_rows(stack, step) as tiles:
        for first, end, tile_ihwc in tiles:
            columns_ipc = tile_ihwc.reshape(stack.n_light, -1, channel)
            if stack.mask_hw is not None:
                columns_ipc = columns_ipc[:, stack.mask_hw[first:end].ravel()]
            yield from reader.linear(columns_ipc)
            tell(end, height)  # type: ignore[operator]


def read_normals(path: Path, green: str = "up") -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the unit normals of a picture, (P, 3), and where they are, (height, width).

    Floats hold them as they are, integers ``(n + 1) / 2``; vectors shorter than half a unit stand for none.

    Raises
    ------
    InputError
        If it is no picture of three channels, or holds no normal.
    """
    if green not in ("up", "down"):
        raise InputError(f"green must be up or down, got {green!r}")
    name = path_text(path, "normals")
    image_hwc = read_image(name)
    if image_hwc.shape[2] != 3:
        raise InputError(f"{name}: normals have three channels, got {image_hwc.shape[2]}")
    vectors_hw3 = image_hwc.astype(np.float32)
    if image_hwc.dtype.kind == "u":
        vectors_hw3 = vectors_hw3 * np.float32(2.0 / np.iinfo(image_hwc.dtype).max) - np.float32(1.0)
    if green == "down":
        vectors_hw3[..., 1] *= -1.0
    length_hw = np.sqrt(np.einsum("hwa,hwa->hw", vectors_hw3, vectors_hw3))
    inside_hw = np.isfinite(length_hw) & (length_hw > _LEAST_LENGTH)
    if not inside_hw.any():
        raise InputError(f"{name}: no pixel holds a normal")
    return vectors_hw3[inside_hw] / length_hw[inside_hw][:, None], inside_hw


def inverse_lighting(
    image: Path,
    normals: Path,
    *,
    out: Path | None = None,
    albedo: Path | None = None,
    degree: int | None = None,
    ridge: float = 0.0,
    green: str = "up",
    progress: Progress | None = None,
    report: Report | None = None,
) -> Light | Report:
    """Find the light under which a convex matte view of known normals was seen.

    Parameters
    ----------
    image, normals, albedo : path
        Linear radiance, normals and albedo of one size, as `normals` writes the latter two; 16-bit and 8-bit pictures
        are taken as linear, their largest code as 1. Without albedo it is 1 everywhere.
    out : path, optional
        A light file; without it the light is returned.
    degree, ridge
        As of `clrelight.variation.inverse.find_light`.
    green : str
        Which way the second channel of `normals` grows.
    progress, report
        As of `principal_components`.

    Raises
    ------
    InputError
        If the pictures do not fit each other, or the normals do not tell light of that degree.
    """
    kept, since = report_for(report), time.perf_counter()
    with claimed([out], paths_among(image, normals, albedo), kept), stage(progress, "finding the light"):
        normals_p3, inside_hw = read_normals(normals, green)
        radiance_pc = _values(image, inside_hw)
        albedo_pc = None if albedo is None else _values(albedo, inside_hw)
        since = kept.add("read", since)
        found = find_light(
            radiance_pc,
            normals_p3,
            albedo_pc,
            degree=None if degree is None else whole(degree, "degree"),
            ridge=float(ridge),
        )
        reached = len(found.condition_l) - 1
        kept.facts |= {
            "degree": reached,
            "pixels": len(normals_p3),
            "condition": [float(each) for each in found.condition_l],
            "unseen": list(found.unseen),
            "residual": found.residual,
            "coefficients": found.coeffs_kc.tolist(),
        }
        if degree is None and reached < DEGREE:
            kept.note(f"the normals that are seen tell light of degree {reached} only")
        if found.unseen:
            kept.note(f"light of degree {', '.join(map(str, found.unseen))} leaves no trace: it is 0 here")
        light = Light(
            found.coeffs_kc, os.path.basename(os.fsdecode(image)), config={"made": "inverse", "ridge": float(ridge)}
        )
        since = kept.add("solve", since)
        if out is None:
            return light
        write_light(out, light)
        kept.add("write", since)
    kept.facts["file"] = os.fsdecode(out)
    return kept


def _values(path: Path, inside_hw: NDArray[np.bool_]) -> NDArray[np.float64]:
    name = path_text(path, "a picture")
    image_hwc = read_image(name)
    if image_hwc.shape[:2] != inside_hw.shape:
        (h, w), (height, width) = image_hwc.shape[:2], inside_hw.shape
        raise InputError(f"{name} is {w}×{h}, the normals are {width}×{height}")
    values_pc = image_hwc[inside_hw].astype(np.float64)
    if not np.isfinite(values_pc).all():
        raise InputError(f"{name} holds values that are not finite")
    return values_pc / np.iinfo(image_hwc.dtype).max if image_hwc.dtype.kind == "u" else values_pc
