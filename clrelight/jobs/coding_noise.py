"""The coding noise that was predicted and the one measured, in decibels."""

from __future__ import annotations

import math
from typing import Any

from clrelight.bases import SH
from clrelight.codec.rate.noise import Noise, measure_image_error
from clrelight.codec.transforms.metric import MAX_METRIC_DEGREE
from clrelight.harmonics.index import degree_of
from clrelight.metrics import psnr_of


def predicted_psnr(noise: Noise | None) -> dict[str, float]:
    """Return ``coding_psnr_independent`` and ``coding_psnr_predicted``; NaN where the codec has no model."""
    independent, predicted = (
        (math.nan, math.nan) if noise is None else (noise.image_error_if_independent(), noise.image_error())
    )
    return {"coding_psnr_independent": float(psnr_of(independent)), "coding_psnr_predicted": float(psnr_of(predicted))}


def coding_psnr(noise: Noise | None, coeffs_khwc: Any, decoded_khwc: Any, basis: str = SH) -> dict[str, float]:
    """Return how far the coding noise lies below the peak, in dB: as predicted, and ``coding_psnr`` as measured.

    Both are arrays in memory, or what is read some rows at a time. Infinite where nothing is lost, NaN beyond the
    degrees whose hemisphere can be computed.
    """
    known = degree_of(coeffs_khwc.shape[0]) <= MAX_METRIC_DEGREE
    measured = measure_image_error(coeffs_khwc, decoded_khwc, basis) if known else math.nan
    return {**predicted_psnr(noise), "coding_psnr": float(psnr_of(measured))}
