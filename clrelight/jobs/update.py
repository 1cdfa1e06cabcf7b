"""Add photographs to a fit whose own are no longer there: to a file, piece by piece, or to a map in memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import srgb_to_linear
from clrelight.dataset import CoefficientMap, FitRecord, LightStack
from clrelight.device import Device
from clrelight.errors import InputError, counted
from clrelight.fit.recursive import Update, plan_update
from clrelight.jobs.inputs import FitLike, StackLike, lend_fit, lend_stack, opened_on, paths_among
from clrelight.jobs.measure import measure_split
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import create_fit
from clrelight.tiles import row_tiles


def update_fit(
    fitted: FitLike,
    source: StackLike,
    *,
    out: str | os.PathLike[str] | None = None,
    measure: bool | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap | Report:
    """Add the photographs of a stack to a fit by recursive least squares; see `clrelight.fit.recursive`.

    The result is the fit of all photographs, old and new, but for the rounding of the old coefficients; lambda of a
    spline stays the old one's.

    Parameters
    ----------
    fitted : path or CoefficientMap
        A fit by ``uls``, ``sloan`` or ``spline`` with uniform weights.
    source : path or LightStack
        New photographs of the same pixels, under lights that the fit has not; of the same peak and transfer curve.
    out : path, optional
        A fit file to write; without it the map is returned.
    measure : bool, optional
        Whether to measure PSNR at the new lights; default: where `out` or `report` is given.
    memory, device, progress, report
        As of `clrelight.fit`; a device is needed to measure alone.

    Raises
    ------
    InputError
        If the fit cannot be updated, the stack is of other pixels or another unit, or `out` cannot be written.
    """
    kept, budget = report_for(report), count_bytes(memory)
    with (
        claimed([out], paths_among(fitted, source), kept),
        opened_on(device, kept) as opened,
        lend_fit(fitted) as old,
        lend_stack(source, kept) as stack,
    ):
        _check_same_view(old, stack)
        update = plan_update(FitRecord.of(old), stack.directions_i3)
        record = replace(FitRecord.of(old), directions_i3=update.directions_j3, config=_config(old))
        _tell(kept, record, update, old, stack)
        with ExitStack() as files:
            if out is None:
                coeffs_khwc = np.empty((old.n_coeff, *old.image_shape), np.float32)
                step = 1
            else:
                sink = files.enter_context(create_fit(out, record, old.image_shape))
                step = sink.coeffs_khwc.chunks[1]
            with stage(progress, "updating") as tell:
                doubtful = 0
                for first, tile_khwc, lit in _tiles(old, stack, update, budget, step):
                    doubtful += lit
                    if out is None:
                        coeffs_khwc[:, first : first + tile_khwc.shape[1]] = tile_khwc
                    else:
                        sink.write_rows(first, tile_khwc, None, None)
                    tell(first + tile_khwc.shape[1], old.image_shape[0])
            if doubtful:
                kept.note(
                    f"{counted(doubtful, 'pixel is', 'pixels are')} 0 in the fit and not in the new photographs: right "
                    "where the old ones were black, wrong where a mask left them out: then give the new photographs "
                    "that mask"
                )
            made = record.to_map(coeffs_khwc if out is None else sink.coeffs_khwc)
            if (out is not None or report is not None) if measure is None else measure:
                every = np.arange(stack.n_light)
                kept.psnr = measure_split(made, stack, opened, (every, every[:0]), progress=progress)
        if out is None:
            return made
        kept.facts = {"file": os.fsdecode(out), **kept.facts, "bytes_on_disk": os.stat(out).st_size}
        return kept


def _check_same_view(old: CoefficientMap, stack: LightStack) -> None:
    if old.image_shape != stack.image_shape:
        shapes = (" × ".join(map(str, shape)) for shape in (stack.image_shape, old.image_shape))
        raise InputError("the new photographs are {}, the fit is {}: expected the same pixels".format(*shapes))
    if (old.peak, old.transfer) != (stack.peak, stack.transfer):
        raise InputError(
            f"the new photographs have peak {stack.peak:g} and transfer {stack.transfer}, the fit peak {old.peak:g} "
            f"and {old.transfer}: coefficients are in units of the peak, so they must be the same"
        )
    if (old.surface is None) != (stack.surface is None) or (
        old.surface is not None
        and stack.surface is not None
        and not np.array_equal(old.surface.vertices_v3, stack.surface.vertices_v3)
    ):
        raise InputError("the fit and the new photographs are not of one surface")


def _config(old: CoefficientMap) -> dict[str, object]:
    """Return the options of the fit without what said which of its photographs were fitted: there are others now."""
    return {name: value for name, value in old.config.items() if name not in ("holdout", "holdout_by", "lights")}


def _tell(report: Report, record: FitRecord, update: Update, old: CoefficientMap, stack: LightStack) -> None:
    report.facts |= {
        "method": record.method,
        "degree": record.degree,
        "n_coeff": old.n_coeff,
        "n_light": len(update.directions_j3),
        "n_new": stack.n_light,
        "config": dict(record.config),
        "dtype": "float32",
        "condition": update.condition,
    }
    if record.method == "spline":
        report.note("spline: lambda stays that of the old photographs; the fit of all might find another")
    if np.dtype(old.coeffs_khwc.dtype) == np.float16:
        report.note("the old coefficients are float16: what is added to them is no more exact than they are")


def _tiles(
    old: CoefficientMap, stack: LightStack, update: Update, budget: int, step: int
) -> Iterator[tuple[int, NDArray[np.float32], int]]:
    """Yield updated rows from top to bottom, as many at a time as the budget has room for.

    With their first one, and the number of pixels that are 0 in the fit, as what a mask leaves out is, and not in the
    photographs. InputError where the photographs' mask leaves out a pixel that the fit has.
    """
    height, width, channel = old.image_shape
    n_coeff, n_light = old.n_coeff, stack.n_light
    # Coefficients twice as float32 and three times as float64; samples as they are, as float64, and less the fit's.
    column = n_coeff * (2 * 4 + 3 * 8) + n_light * (np.dtype(stack.images_ihwc.dtype).itemsize + 3 * 8)
    rows = budget // (column * width * channel)
    if rows < 1:
        raise InputError(
            f"one row of this update takes {column * width * channel} bytes, more than the budget {budget}"
        )
    rows = max(rows - rows % step, 1) if rows >= step else rows
    for first, end in row_tiles((0, height), rows):
        held_khwc = old.read_rows(first, end, np.empty((n_coeff, end - first, width, channel), np.float32))
        samples_ip = stack.read_rows(first, end).reshape(n_light, -1) / np.float64(stack.peak)
        radiance_ip = srgb_to_linear(samples_ip) if stack.transfer == "srgb" else samples_ip
        made_kp = update.apply(held_khwc.reshape(n_coeff, -1).astype(np.float64), radiance_ip)
        made_khwc = made_kp.astype(np.float32).reshape(held_khwc.shape)
        held_hw, lit_hw = held_khwc.any(axis=(0, 3)), samples_ip.reshape(n_light, *held_khwc.shape[1:]).any(axis=(0, 3))
        if stack.mask_hw is not None:
            outside_hw = ~stack.mask_hw[first:end]
            lost_n2 = np.argwhere(outside_hw & held_hw)
            if len(lost_n2):
                raise InputError(
                    f"the mask of the new photographs leaves out the pixel at row {first + lost_n2[0, 0]}, column "
                    f"{lost_n2[0, 1]}, which the fit has: expected the same pixels"
                )
            made_khwc[:, outside_hw] = 0.0
            lit_hw &= ~outside_hw
        yield first, made_khwc, int(np.count_nonzero(lit_hw & ~held_hw))
