"""Subspaces of a stack, a mesh's view or a picture of normals side by side."""

from __future__ import annotations

import os
import pathlib
import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack, split_lights
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.images import IMAGE_EXTENSIONS
from clrelight.jobs.inputs import StackLike, lend_stack, opened_on
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.variation.components import MESHES, read_normals, visible_vertices
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.passes import rows_within, stack_rows
from clrelight.sampling import make_pattern
from clrelight.surface import Surface
from clrelight.threads import on_one_thread
from clrelight.transfer.mesh_files import read_mesh
from clrelight.variation.comparing import LEAST_LIGHTS, Captured, Products, compare_spaces, lee_directions
from clrelight.variation.maps import NormalMap, SampleReader, map_normals

MADE_OF, TESTED = 162, 97
"""Lamps all around whose pictures subspaces are made of, and tested by, where only normals are known."""
_MOST_PIXELS, _BLOCK = 1 << 18, 1 << 13


def compare_subspaces(
    source: StackLike | Surface,
    *,
    holdout: int = 5,
    albedo: str | os.PathLike[str] | None = None,
    lights: str = "sphere",
    green: str = "up",
    up: str | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> list[Captured]:
    """Return how much of a view's pictures each subspace holds, at lamps that it was not made of.

    Parameters
    ----------
    source : path, LightStack or Surface
        A stack: its photographs, and its normals as `normals` finds them. A mesh (seen from +z, nothing in the way), or
        a picture of normals: what a convex matte surface shows under lamps.
    holdout : int
        Every how many-th light of a stack subspaces are tested by.
    albedo : path, optional
        A picture, beside one of normals.
    lights : str
        Where lamps of a mesh or of normals are: ``"sphere"``, or ``"hemisphere"`` in front.
    green, up, memory, progress, report
        As of `principal_components`.
    device : Device or str, optional
        Where a stack's normals are found.

    Raises
    ------
    InputError
        If there are too few lights, or they do not tell normals.
    """
    kept, budget = report_for(report), count_bytes(memory)
    since = time.perf_counter()
    if lights not in ("sphere", "hemisphere"):
        raise InputError(f"lights must be sphere or hemisphere, got {lights!r}")
    suffix = pathlib.Path(os.fsdecode(source)).suffix.lower() if isinstance(source, str | os.PathLike) else ""
    fixed = None
    if isinstance(source, Surface) or suffix in MESHES or suffix in IMAGE_EXTENSIONS:
        normals_p3, weights_p = _normals_of(source, suffix, albedo, green, up, kept)
        kind, count = "normals" if suffix in IMAGE_EXTENSIONS else "mesh", len(normals_p3)
        with stage(progress, "adding up"):
            products, fixed = _products_of_normals(normals_p3, weights_p, lights, kept)
    else:
        if albedo is not None:
            raise InputError("an albedo goes with a picture of normals; a stack's is found")
        with opened_on(device, kept) as opened, lend_stack(source, kept) as stack:  # type: ignore[arg-type]
            kind, count = "stack", stack.n_light
            products = _products_of_stack(stack, holdout, opened, budget, progress)
    since = kept.add("products", since)
    with on_one_thread():
        found = compare_spaces(products, fixed)
    kept.add("compare", since)
    kept.facts |= {
        "kind": kind,
        "count": count,
        "made_of": len(products.made_of),
        "tested": len(products.tested),
        "spaces": [
            {
                "name": each.name,
                "dimensions": each.dimensions,
                "energy": each.energy,
                "variance": each.variance,
                "lights": list(each.lights),
                "directions": products.directions_i3[list(each.lights)].tolist(),
            }
            for each in found
        ],
    }
    return found


def _normals_of(
    source: object, suffix: str, albedo: str | os.PathLike[str] | None, green: str, up: str | None, report: Report
) -> tuple[NDArray[np.floating], NDArray[np.float64]]:
    """Return unit normals and the weight of each one's squared radiance: squared albedo times the area in view."""
    if suffix in IMAGE_EXTENSIONS:
        from clrelight.jobs.variation.gallery import read_linear

        normals_p3, inside_hw = read_normals(source, green)  # type: ignore[arg-type]
        if albedo is None:
            return normals_p3, np.ones(len(normals_p3))
        albedo_hwc = read_linear(albedo, "linear")
        if albedo_hwc.shape[:2] != inside_hw.shape:
            raise InputError(f"{os.fsdecode(albedo)} has another size than the normals")
        return normals_p3, np.mean(albedo_hwc[inside_hw].astype(np.float64) ** 2, axis=1)
    if albedo is not None:
        raise InputError("an albedo goes with a picture of normals; a mesh has its own")
    surface = source if isinstance(source, Surface) else read_mesh(source, up=up)  # type: ignore[arg-type]
    report.note(*surface.notes)
    return visible_vertices(surface)


def _products_of_normals(
    normals_p3: NDArray[np.floating], weights_p: NDArray[np.float64], lights: str, report: Report
) -> tuple[Products, list[int]]:
    if len(normals_p3) > _MOST_PIXELS:
        step = -(-len(normals_p3) // _MOST_PIXELS)
        report.note(f"every {step}th of {len(normals_p3)} normals is taken")
        normals_p3, weights_p = normals_p3[::step], weights_p[::step]
    is_sphere = lights == "sphere"
    parts = [make_pattern("uniform", count, sphere=is_sphere) for count in (MADE_OF, TESTED)]
    directions_i3 = np.concatenate([*parts, lee_directions()])
    gram_vv = np.zeros((len(directions_i3) + 9,) * 2)
    for start in range(0, len(normals_p3), _BLOCK):
        part_p3 = np.asarray(normals_p3[start : start + _BLOCK], np.float64)
        shade_ip = np.maximum(directions_i3 @ part_p3.T, 0.0)
        rows_vp = np.concatenate([shade_ip, evaluate_basis(part_p3, 2).T])
        rows_vp *= np.sqrt(weights_p[start : start + _BLOCK])
        gram_vv += rows_vp @ rows_vp.T
    tested = np.arange(MADE_OF, MADE_OF + TESTED)
    fixed = list(range(MADE_OF + TESTED, len(directions_i3)))
    return Products(gram_vv, directions_i3, np.arange(MADE_OF), tested), fixed


def _check_holdout(n_light: int, holdout: int) -> None:
    """Refuse what leaves too few photographs before normals are looked for."""
    if n_light <= LEAST_LIGHTS:
        raise InputError(
            f"subspaces are made of at least {LEAST_LIGHTS} photographs and tested by others: {n_light} are too few"
        )
    sound = [each for each in range(2, n_light + 1) if n_light - n_light // each >= LEAST_LIGHTS]
    if holdout not in sound:
        raise InputError(
            f"subspaces are made of at least {LEAST_LIGHTS} photographs and tested by others: of {n_light}, holdout "
            f"must be {sound[0]} to {sound[-1]}, got {holdout}"
        )


def _products_of_stack(
    stack: LightStack, holdout: int, device: Device, budget: int, progress: Progress | None
) -> Products:
    _check_holdout(stack.n_light, holdout)
    made_of, tested = split_lights(stack.n_light, holdout)
    lit = LightStack(
        stack.images_ihwc, stack.directions_i3, stack.peak, stack.transfer, mask_hw=stack.mask_hw, name=stack.name
    )
    with stage(progress, "finding normals") as tell:
        found = map_normals(lit, "robust", device=device, memory_bytes=budget, progress=tell)
    gram_vv = np.zeros((stack.n_light + 9,) * 2)
    with stage(progress, "adding up") as tell:
        for rows_vp in _rows(stack, found, budget, tell):
            rows = rows_vp.astype(np.float64)
            gram_vv += rows @ rows.T
    return Products(gram_vv, stack.directions_i3, made_of, tested)


def _rows(stack: LightStack, found: NormalMap, budget: int, tell: object) -> Iterator[NDArray[np.float32]]:
    """Yield photographs and albedo times harmonics, (n_light + 9, P), of pixels inside the mask, tile by tile."""
    height, width, channel = stack.image_shape
    row = width * channel * (stack.n_light * (2 * stack.images_ihwc.dtype.itemsize + 4) + (stack.n_light + 9) * 12)
    step, reader = rows_within(row, budget), SampleReader(stack)
    with stack_rows(stack, step) as tiles:
        for first, end, tile_ihwc in tiles:
            inside_hw = np.any(found.normals_hw3[first:end] != 0.0, axis=2)
            if stack.mask_hw is not None:
                inside_hw &= stack.mask_hw[first:end]
            samples_cip = reader.linear(tile_ihwc[:, inside_hw])
            basis_kp = evaluate_basis(found.normals_hw3[first:end][inside_hw].astype(np.float64), 2).T
            albedo_pc = found.albedo_hwc[first:end][inside_hw]
            for samples_ip, albedo_p in zip(samples_cip, albedo_pc.T, strict=True):
                yield np.concatenate([samples_ip, (basis_kp * albedo_p).astype(np.float32)])
            tell(end, height)  # type: ignore[operator]
