"""Lamps by a matte object in the photographs: of known normals, or along with them."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.images import read_image
from clrelight.jobs.inputs import path_text
from clrelight.jobs.report import Progress, Report, stage
from clrelight.jobs.variation.components import read_normals
from clrelight.jobs.variation.light_frames import Frames
from clrelight.masks import read_mask
from clrelight.variation.factoring import lights_from_surface
from clrelight.variation.shading import are_sums_of_three, lights_from_normals, shade_explains

_PIXELS, _SURFACE_PIXELS = 8_000, 20_000
"""That are enough: three unknowns a lamp; and slopes of a surface, which blocks of pixels smooth away."""
_UNEVEN = 0.15
"""Of intensities found, beyond which lamps were not equal or the surface not matte."""


def lights_of_object(
    frames: Frames,
    normals: str | os.PathLike[str] | None,
    albedo: str | os.PathLike[str] | None,
    mask: str | os.PathLike[str] | None,
    green: str,
    budget: int,
    progress: Progress | None,
    report: Report,
) -> tuple[NDArray[np.float64], list[dict]]:
    """Return unit vectors to the lamps, 0 where too little is lit, and what is told of each.

    Raises
    ------
    InputError
        If pictures do not fit the photographs, or the object does not tell lights.
    """
    since = time.perf_counter()
    inside_hw, normals_hw3 = _read_object(frames, normals, mask, green, report)
    y_p, x_p = np.nonzero(inside_hw)
    left, top = int(x_p.min()), int(y_p.min())
    window = left, top, int(x_p.max()) + 1 - left, int(y_p.max()) + 1 - top
    few = int(np.sqrt(len(y_p) / (_SURFACE_PIXELS if normals_hw3 is None else _PIXELS)))
    tight = int(np.ceil(np.sqrt(3.0 * len(frames.names) * window[2] * window[3] * 4 / budget)))
    factor = max(1, few, tight)
    with stage(progress, "reading images") as tell:
        samples_ihw = frames.take(window, factor, None, tell)
    since = report.add("read", since)
    used_hw = _shrunk(inside_hw, window, factor)[:, :, 0] > 0.99
    with stage(progress, "finding lights"):
        if normals_hw3 is None:
            _check_lit(are_sums_of_three(samples_ihw[:, used_hw]))
            lights_i3, residual_i = _with_surface(samples_ihw, used_hw, report)
        else:
            mean_hw3 = _shrunk(normals_hw3, window, factor)
            length_hw = np.linalg.norm(mean_hw3, axis=2)
            # Blocks across an edge of the surface have no normal of their own.
            used_hw &= length_hw > 0.97
            if not used_hw.any():
                raise InputError(f"no block of {factor}×{factor} pixels has one normal: give more --memory")
            albedo_p = None
            if albedo is not None:
                values_hwc = read_image(path_text(albedo, "an albedo"))
                _check_size(albedo, values_hwc.shape[:2], frames)
                albedo_p = _shrunk(values_hwc.astype(np.float32).mean(axis=2), window, factor)[:, :, 0][used_hw]
            unit_p3 = mean_hw3[used_hw] / length_hw[used_hw][:, None]
            samples_ip = samples_ihw[:, used_hw]
            shaded = lights_from_normals(samples_ip, unit_p3, albedo_p)
            lights_i3, residual_i = shaded.lights_i3, shaded.residual_i
            is_lit = are_sums_of_three(samples_ip)
            if not is_lit and albedo_p is not None:
                is_lit = shade_explains(samples_ip, unit_p3, lights_i3, albedo_p)
            _check_lit(is_lit)
    report.add("solve", since)
    length_i = np.linalg.norm(lights_i3, axis=1)
    mean = float(length_i[length_i > 0.0].mean()) if length_i.any() else 1.0
    rows = [
        {"confidence": max(0.0, 1.0 - float(residual)), "residual": float(residual), "intensity": float(length / mean)}
        for residual, length in zip(residual_i, length_i, strict=True)
    ]
    return np.where(length_i[:, None] > 0.0, lights_i3 / np.maximum(length_i, 1e-12)[:, None], 0.0), rows


def _check_lit(is_lit: bool | None) -> None:
    if is_lit is False:
        raise InputError(
            "the photographs do not differ as those of one matte object under lamps do, which are nearly sums of three "
            "pictures: they look like noise, or show different things, or one that is flat"
        )


def _read_object(
    frames: Frames,
    normals: str | os.PathLike[str] | None,
    mask: str | os.PathLike[str] | None,
    green: str,
    report: Report,
) -> tuple[NDArray[np.bool_], NDArray[np.float32] | None]:
    """Return where the object is, and its normals where they are known."""
    height, width = frames.shape_hw
    inside_hw = np.ones((height, width), bool) if frames.stack.mask_hw is None else frames.stack.mask_hw
    if mask is not None:
        inside_hw, notes = read_mask(Path(path_text(mask, "a mask")), (height, width))
        report.note(*notes)
    normals_hw3 = None
    if normals is not None:
        normals_p3, known_hw = read_normals(normals, green)
        _check_size(normals, known_hw.shape, frames)
        normals_hw3 = np.zeros((height, width, 3), np.float32)
        normals_hw3[known_hw] = normals_p3
        inside_hw = inside_hw & known_hw
    if not inside_hw.any():
        raise InputError("no pixel of the photographs is inside the mask and has a normal")
    return inside_hw, normals_hw3


def _with_surface(
    samples_ihw: NDArray[np.float32], used_hw: NDArray[np.bool_], report: Report
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    found = lights_from_surface(samples_ihw, used_hw)
    report.facts["uneven"] = found.uneven
    report.note(
        "lamps and surface were found together: right where lamps are equally bright, the object is matte and bulges "
        "towards the camera; else all lights are off by one bas-relief"
    )
    if found.uneven > _UNEVEN:
        report.note(f"the lamps come out uneven by {found.uneven:.0%}: do not trust them")
    return found.lights_i3, found.residual_i


def _check_size(path: str | os.PathLike[str], shape_hw: tuple[int, ...], frames: Frames) -> None:
    if tuple(shape_hw) != tuple(frames.shape_hw):
        (h, w), (height, width) = shape_hw, frames.shape_hw
        raise InputError(f"{os.fsdecode(path)} is {w}×{h}, the photographs are {width}×{height}")


def _shrunk(values: NDArray, window: tuple[int, int, int, int], factor: int) -> NDArray[np.float64]:
    """Return means of blocks of a part of a map, (height, width, channel)."""
    x, y, width, height = window
    part_hwc = values[y : y + height, x : x + width].reshape(height, width, -1).astype(np.float32)
    rows, columns = np.arange(0, height, factor), np.arange(0, width, factor)
    sums_hwc = np.add.reduceat(np.add.reduceat(part_hwc, rows, axis=0), columns, axis=1)
    counts = np.minimum(factor, height - rows)[:, None] * np.minimum(factor, width - columns)
    return sums_hwc / counts[:, :, None]
