"""Measure how near a fit comes to the photographs."""

from __future__ import annotations

import math
import time

import numpy as np

from clrelight.codec import decode_regions
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.holdout import split_by_fit
from clrelight.jobs.inputs import (
    FittedLike,
    StackLike,
    is_encoded,
    lend_coefficients,
    lend_stack,
    opened_on,
    take_encoded,
)
from clrelight.jobs.measure_parts import measure_parts
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.split_quality import Split, summarize_split
from clrelight.memory import DEFAULT_MEMORY
from clrelight.metrics import check_view, domain_note, measure_errors


def measure(
    fitted: FittedLike,
    stack: StackLike,
    *,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> dict[str, float]:
    """Return PSNRs of a fit against a stack, in decibel.

    Parameters
    ----------
    fitted : path, CoefficientMap or Encoded
        A fit, or what encodes one.
    stack : path or LightStack
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    dict of str to float
        ``mean_fitted``, the mean over the lights that the fit has seen, and ``pooled_fitted``, of their pooled error;
        ``mean_holdout`` and ``pooled_holdout`` of those that it has not, where there are any, with the angle in degrees
        from them to the nearest fitted one, ``distance_median_holdout`` and ``distance_largest_holdout``.

    Raises
    ------
    InputError
        If a file is not what it should be, or the two are not of one view.
    """
    kept = report_for(report)
    with opened_on(device, kept) as opened, lend_stack(stack, kept) as source:
        if is_encoded(fitted):
            since = time.perf_counter()
            encoded, record = take_encoded(fitted)  # type: ignore[arg-type]
            regions = decode_regions(encoded)
            if regions is not None and 4 * math.prod(encoded.shape) > DEFAULT_MEMORY:  # part by part
                blank = record.to_map(np.broadcast_to(np.float32(0), encoded.shape))  # takes no memory
                check_view(blank, source)
                kept.note(*filter(None, [domain_note(blank, source)]))
                since = kept.add("read", since)
                split = split_by_fit(source, blank)
                kept.psnr = measure_parts(regions, record, source, split, opened, sampled=False, progress=progress)
                kept.add("measure", since)
                return kept.psnr
            fitted = encoded  # it is read already
            kept.add("read", since)
        with lend_coefficients(fitted, opened, kept, progress) as coefficients:
            since = time.perf_counter()
            kept.note(*filter(None, [domain_note(coefficients, source)]))
            kept.psnr = measure_split(coefficients, source, opened, progress=progress)
            kept.add("measure", since)
    return kept.psnr


def measure_split(
    coefficients: CoefficientMap,
    stack: LightStack,
    device: Device,
    split: Split | None = None,
    progress: Progress | None = None,
) -> dict[str, float]:
    """Return PSNRs at the fitted lights and, apart, at those held out; by default all that were not fitted.

    Of the latter with how far they lie from the former. Where some images are identical but not all, their number and
    the mean over the others are there too.
    """
    fitted, held = split_by_fit(stack, coefficients) if split is None else split
    with stage(progress, "measuring") as tell:
        mse_i = measure_errors(coefficients, stack, device=device, progress=tell)
    return summarize_split(mse_i, coefficients.directions_i3, stack, (fitted, held))
