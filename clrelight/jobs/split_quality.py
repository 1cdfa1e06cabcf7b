"""Errors of lights as PSNRs, of those that a fit has seen and of those that it has not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.holdout import distances_to
from clrelight.metrics import summarize_errors

Split = tuple[NDArray[np.intp], NDArray[np.intp]]
"""The lights that were fitted, and those held out."""


def summarize_split(
    mse_i: NDArray[np.float64],
    fitted_i3: NDArray[np.float64],
    stack: LightStack,
    split: Split,
) -> dict[str, float]:
    """Return PSNRs at the fitted lights and, apart, at those held out, of each light's mean squared error.

    Of the latter with how far they lie from the former, `fitted_i3`. Where some images are identical but not all, their
    number and the mean over the others are there too.
    """
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
