"""Measure how near a fit comes to the photographs."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.holdout import distances_to, split_by_fit
from clrelight.jobs.inputs import FittedLike, StackLike, lend_coefficients, lend_stack, opened_on
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.metrics import domain_note, measure_errors, summarize_errors


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
    with (
        opened_on(device, kept) as opened,
        lend_stack(stack, kept) as source,
        lend_coefficients(fitted, opened, kept, progress) as coefficients,
    ):
        since = time.perf_counter()
        kept.note(*filter(None, [domain_note(coefficients, source)]))
        kept.psnr = measure_split(coefficients, source, opened, progress=progress)
        kept.add("measure", since)
    return kept.psnr


def measure_split(
    coefficients: CoefficientMap,
    stack: LightStack,
    device: Device,
    split: tuple[NDArray[np.intp], NDArray[np.intp]] | None = None,
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


def summarize_split(
    mse_i: NDArray[np.float64],
    fitted_i3: NDArray[np.float64],
    stack: LightStack,
    split: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> dict[str, float]:
    """Return what `measure_split` does, of each light's mean squared error; `fitted_i3` are the fit's lights."""
    fitted, held = split
    quality: dict[str, float] = {}
    for name, lights in (("fitted", fitted), ("holdout", held)):
        if len(lights):
            measured = summarize_errors(mse_i[lights])
            quality[f"mean_{name}"], quality[f"pooled_{name}"] = measured.psnr_mean, measured.psnr_pooled
            if measured.note:
                quality[f"identical_{name}"] = measured.n_identical
                quality[f"mean_others_{name}"] = measured.psnr_others
    if len(held):
        away_i = distances_to(fitted_i3, stack.directions_i3[held])
        quality["distance_median_holdout"] = float(np.median(away_i))
        quality["distance_largest_holdout"] = float(away_i.max())
    return quality
