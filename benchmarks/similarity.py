"""How alike a relit image and a photograph are: squared error, and structural similarity."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from clrelight.metrics import summarize_errors

_SIGMA, _RADIUS = 1.5, 5
_C1, _C2 = 0.01**2, 0.03**2


@dataclass(frozen=True)
class Score:
    """Figures over some lights: PSNR as `clrelight.metrics.Quality` has them, SSIM the mean over lights."""

    psnr_mean: float
    psnr_pooled: float
    ssim: float | None
    psnr_i: tuple[float, ...]


def score_images(
    pairs: Iterable[tuple[NDArray, NDArray]], mask_hw: NDArray[np.bool_], *, with_ssim: bool = True
) -> Score:
    """Compare pairs of relit and given images (height, width, channel), in units of the peak, both clipped."""
    errors, similarities = [], []
    for relit_hwc, given_hwc in pairs:
        shown, given = np.clip(relit_hwc, 0.0, 1.0), np.clip(given_hwc, 0.0, 1.0)
        errors.append(np.square((shown - given)[mask_hw], dtype=np.float64).mean())
        if with_ssim:
            similarities.append(similarity(shown, given, mask_hw))
    quality = summarize_errors(np.array(errors))
    ssim = float(np.mean(similarities)) if with_ssim else None
    return Score(quality.psnr_mean, quality.psnr_pooled, ssim, tuple(map(float, quality.psnr_i)))


def similarity(a_hwc: NDArray, b_hwc: NDArray, mask_hw: NDArray[np.bool_]) -> float:
    """Return the SSIM of two images in units of the peak (Wang et al. 2004, eq. 13), the mean over pixels and channels.

    Moments under a Gaussian of sigma 1.5 in windows of 11 × 11 pixels; windows that leave the picture do not count
    where there are others.
    """

    def blur(image_hwc: NDArray) -> NDArray:
        return gaussian_filter(image_hwc, (_SIGMA, _SIGMA, 0), radius=(_RADIUS, _RADIUS, 0))

    a, b = a_hwc.astype(np.float64), b_hwc.astype(np.float64)
    mean_a, mean_b = blur(a), blur(b)
    variance_a, variance_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    covariance = blur(a * b) - mean_a * mean_b
    alike = (2 * mean_a * mean_b + _C1) / (mean_a**2 + mean_b**2 + _C1)
    alike *= (2 * covariance + _C2) / (variance_a + variance_b + _C2)
    inner = np.zeros_like(mask_hw)
    inner[_RADIUS:-_RADIUS, _RADIUS:-_RADIUS] = mask_hw[_RADIUS:-_RADIUS, _RADIUS:-_RADIUS]
    return float(alike[inner if inner.any() else mask_hw].mean())
