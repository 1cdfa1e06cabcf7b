"""Measure how near a fit comes to the photographs."""

from __future__ import annotations

import functools
import math
import time

import numpy as np

from clrelight.codec.views import Regions
from clrelight.dataset import CoefficientMap, FitRecord, LightStack
from clrelight.device import Device
from clrelight.holdout import split_by_fit
from clrelight.jobs.farm import Farm, shared_path
from clrelight.jobs.inputs import (
    FittedLike,
    Packed,
    StackLike,
    lend_fitted,
    lend_stack,
    opened_on,
)
from clrelight.jobs.measure_parts import MeasureWindows, measure_parts
from clrelight.jobs.packing_farm import measure_elsewhere
from clrelight.jobs.perceived import measure_perceived, relit_regions
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.shown import shown_of
from clrelight.jobs.split_quality import Split, summarize_split
from clrelight.memory import DEFAULT_MEMORY
from clrelight.metrics import check_view, domain_note, measure_errors
from clrelight.perception import check_perception


def measure(
    fitted: FittedLike,
    stack: StackLike,
    *,
    perceptual: bool = False,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    farm: Farm | None = None,
) -> dict[str, float]:
    """Return PSNRs of a fit against a stack, in decibel: of what it, or what encodes it, shows when it is relit.

    Parameters
    ----------
    fitted : path, URL, CoefficientMap or Encoded
        A fit, or what encodes one.
    stack : path or LightStack
    perceptual : bool
        Measure FLIP and colour differences as well, at a sample of the lights: see
        `clrelight.jobs.perceived.measure_perceived`. Needs the extra ``flip``.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).
    farm : Farm, optional
        Other processes that measure parts of what is large and encoded in units; both are files then.

    Returns
    -------
    dict of str to float
        ``mean_fitted``, the mean over the lights that the fit has seen, and ``pooled_fitted``, of their pooled error;
        ``mean_holdout`` and ``pooled_holdout`` of those that it has not, where there are any, with the angle in degrees
        from them to the nearest fitted one, ``distance_median_holdout`` and ``distance_largest_holdout``. With
        `perceptual` also ``flip_fitted``, ``flip_error_fitted``, ``colour_fitted``, ...

    Raises
    ------
    InputError
        If a file is not what it should be, or the two are not of one view.
    """
    kept = report_for(report)
    with opened_on(device, kept) as opened, lend_stack(stack, kept) as source:
        if perceptual:
            check_perception(source.image_shape[2])
        since = time.perf_counter()
        with lend_fitted(fitted, kept, any_basis=True) as held:
            since = kept.add("read", since)
            if isinstance(held, Packed) and 4 * math.prod(held.encoded.shape) > DEFAULT_MEMORY:
                regions = held.regions()
                if regions is not None:
                    elsewhere = None if farm is None else _elsewhere(farm, fitted, stack)
                    blank = held.record.to_map(np.broadcast_to(np.float32(0), held.encoded.shape))  # takes no memory
                    kept.psnr = measure_regions(regions, blank, source, opened, progress, elsewhere)
                    kept.note(*filter(None, [domain_note(blank, source)]))
                    if perceptual:
                        split = split_by_fit(source, blank)
                        kept.psnr |= measure_perceived(relit_regions(regions, opened), source, split, progress)
                    kept.add("measure", since)
                    return kept.psnr
            shown = shown_of(held, fitted, opened, kept, progress)
            since = time.perf_counter()
            kept.note(*filter(None, [domain_note(shown.coefficients, source)]))
            split = split_by_fit(source, shown.coefficients)
            kept.psnr = measure_split(shown.coefficients, source, opened, split, progress, behind=shown.curve)
            if perceptual:
                kept.psnr |= measure_perceived(shown.relit, source, split, progress)
            kept.add("measure", since)
    return kept.psnr


def _elsewhere(farm: Farm, fitted: FittedLike, stack: StackLike) -> MeasureWindows:
    stack_path, coded_path = shared_path(stack, "the stack"), shared_path(fitted, "what was packed")
    return functools.partial(measure_elsewhere, farm, stack_path, coded_path)


def measure_regions(
    regions: Regions,
    fitted: CoefficientMap,
    stack: LightStack,
    device: Device,
    progress: Progress | None = None,
    elsewhere: MeasureWindows | None = None,
) -> dict[str, float]:
    """Return PSNRs of an encoding as `measure_split` does, part by part; of its fit, no coefficient is read.

    InputError if the two are not of one view.
    """
    check_view(fitted, stack)
    record, split = FitRecord.of(fitted), split_by_fit(stack, fitted)
    return measure_parts(regions, record, stack, split, device, sampled=False, progress=progress, elsewhere=elsewhere)


def measure_split(
    coefficients: CoefficientMap,
    stack: LightStack,
    device: Device,
    split: Split | None = None,
    progress: Progress | None = None,
    *,
    behind: str = "linear",
) -> dict[str, float]:
    """Return PSNRs at the fitted lights and, apart, at those held out; by default all that were not fitted.

    Of the latter with how far they lie from the former. Where some images are identical but not all, their number and
    the mean over the others are there too. `behind` is that of `clrelight.metrics.measure_errors`.
    """
    fitted, held = split_by_fit(stack, coefficients) if split is None else split
    with stage(progress, "measuring") as tell:
        mse_i = measure_errors(coefficients, stack, behind=behind, device=device, progress=tell)
    return summarize_split(mse_i, coefficients.directions_i3, stack, (fitted, held))
