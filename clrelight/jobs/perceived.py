"""How different relit images look from the photographs, at a sample of lights."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.views import Region, Regions
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.jobs.bands import bands_of
from clrelight.jobs.measure_parts import sample_windows
from clrelight.jobs.report import Progress, stage
from clrelight.jobs.split_quality import Split
from clrelight.matmul import multiply_columns
from clrelight.memory import PIECE_BYTES
from clrelight.perception import colour_difference, display_of, flip_of
from clrelight.tiles import row_tiles

MOST_LIGHTS = 8
"""Of those fitted, and of those held out."""
_FIGURES = ("flip", "colour")
_MOST_PIXELS = 1 << 18

Relit = Callable[[NDArray[np.float64], Region], NDArray[np.float32]]
"""Linear radiance (n_light, height, width, channel) of a part of the image under some lights."""


def relit_regions(regions: Regions, device: Device) -> Relit:
    """Return what relights parts of an encoding."""
    return lambda directions_i3, region: regions.relight_region(directions_i3, region, device)


def relit_map(coefficients: CoefficientMap, device: Device) -> Relit:
    """Return what relights parts of coefficients, of which a tile of rows is held."""
    _, width, channel = coefficients.image_shape
    row_bytes = 4 * coefficients.n_coeff * width * channel

    def relight(directions_i3: NDArray[np.float64], region: Region) -> NDArray[np.float32]:
        factor_ik = coefficients.functions_at(directions_i3)
        relit_ihwc = np.empty((len(factor_ik), *region.shape, channel), np.float32)
        for first, end in row_tiles((region.top, region.bottom), max(1, PIECE_BYTES // row_bytes)):
            rows_khwc = np.empty((coefficients.n_coeff, end - first, width, channel), np.float32)
            part_khwc = np.ascontiguousarray(
                coefficients.read_rows(first, end, rows_khwc)[:, :, region.left : region.right]
            )
            relit_ip = multiply_columns(device, factor_ik, part_khwc.reshape(coefficients.n_coeff, -1))
            relit_ihwc[:, first - region.top : end - region.top] = relit_ip.reshape(-1, *part_khwc.shape[1:])
        return relit_ihwc

    return relight


def measure_perceived(
    relit: Relit, stack: LightStack, split: Split, progress: Progress | None = None
) -> dict[str, float]:
    """Return mean FLIP and CIEDE2000 of relit images from the photographs, of a few lights fitted and a few held out.

    Both are shown as sRGB, 1.0 (the stack's peak) as white. Pixels outside the mask do not count, and are black.
    Large images are looked at in windows.

    Parameters
    ----------
    relit : callable
        See `Relit`.
    stack : LightStack
    split : pair of ndarray
        The lights of the stack that were fitted, and those held out.
    progress : callable, optional
        Told how many windows are done.

    Returns
    -------
    dict of str to float
        ``flip_fitted``, ``colour_fitted``, their standard errors ``flip_error_fitted`` and ``colour_error_fitted``,
        and ``perceived_fitted``, the number of lights; ``..._holdout`` alike where there are any. An error is 0 where
        all lights and pixels were looked at.
    """
    chosen = [_spread(lights) for lights in split]
    part, windows = stack.select(np.concatenate(chosen)), sample_windows(stack, _MOST_PIXELS)
    sums_fwi, counts_w = np.zeros((len(_FIGURES), len(windows), part.n_light)), np.zeros(len(windows))
    with stage(progress, "comparing as an eye does") as tell, bands_of(part) as bands:
        for number, window in enumerate(windows):
            rows, columns = (window.top, window.bottom), (window.left, window.right)
            mask_hw = None if stack.mask_hw is None else stack.mask_hw[slice(*rows), slice(*columns)]
            samples_ihwc = bands.part(rows, columns)
            if samples_ihwc.dtype.kind == "f":
                part.check_tile(samples_ihwc, window.top, window.left)
            relit_ihwc = relit(part.directions_i3, window)
            counts_w[number] = math.prod(window.shape) if mask_hw is None else mask_hw.sum()
            for light, (samples_hwc, relit_hwc) in enumerate(zip(samples_ihwc, relit_ihwc, strict=True)):
                seen = display_of(samples_hwc / stack.peak, stack.transfer), display_of(relit_hwc, "linear")
                sums_fwi[:, number, light] = _sum_differences(*seen, mask_hw)
            tell(number + 1, len(windows))
    counted = math.prod(stack.image_shape[:2]) if stack.mask_hw is None else int(stack.mask_hw.sum())
    figures: dict[str, float] = {}
    ends = np.cumsum([len(lights) for lights in chosen])
    for name, of_all, lights, end in zip(("fitted", "holdout"), split, chosen, ends, strict=True):
        if len(lights):
            for figure, sums_wi in zip(_FIGURES, sums_fwi[:, :, end - len(lights) : end], strict=True):
                mean, error = _estimate(sums_wi, counts_w, len(of_all), counted)
                figures[f"{figure}_{name}"], figures[f"{figure}_error_{name}"] = mean, error
            figures[f"perceived_{name}"] = len(lights)
    return figures


def _spread(lights: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return at most `MOST_LIGHTS` at even distances."""
    count = min(len(lights), MOST_LIGHTS)
    return lights[np.linspace(0, len(lights) - 1, count).round().astype(int)] if count else lights


def _sum_differences(
    photograph_hwc: NDArray[np.float32], relit_hwc: NDArray[np.float32], mask_hw: NDArray[np.bool_] | None
) -> tuple[float, float]:
    """Return the sums over pixels that count of FLIP and CIEDE2000."""
    if mask_hw is not None:
        photograph_hwc, relit_hwc = photograph_hwc * mask_hw[..., None], relit_hwc * mask_hw[..., None]
    flip_hw = flip_of(photograph_hwc, relit_hwc)
    counted = np.s_[:] if mask_hw is None else mask_hw
    colour = colour_difference(photograph_hwc[counted], relit_hwc[counted])
    return float(flip_hw[counted].sum(dtype=np.float64)), float(colour.sum())


def _estimate(
    sums_wi: NDArray[np.float64], counts_w: NDArray[np.float64], n_light: int, n_pixel: int
) -> tuple[float, float]:
    """Return the mean over all pixels and lights, and its standard error, of some windows and some of the lights."""
    n_window, n_seen = int((counts_w > 0).sum()), sums_wi.shape[1]
    seen = counts_w.sum()
    mean_i = sums_wi.sum(axis=0) / seen
    mean, square = float(mean_i.mean()), 0.0
    if n_seen > 1:
        square += float(mean_i.var(ddof=1)) / n_seen * (1.0 - n_seen / n_light)
    if n_window > 1 and seen < n_pixel:
        residual_w = sums_wi.mean(axis=1) - mean * counts_w
        square += float((residual_w**2).sum()) * n_window / (n_window - 1) / seen**2 * (1.0 - seen / n_pixel)
    return mean, math.sqrt(square)
