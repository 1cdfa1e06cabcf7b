"""Measure an encoding that is decoded part by part: at all pixels, or at some that lie all over the image."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.views import Region, Regions
from clrelight.dataset import FitRecord, LightStack
from clrelight.device import Device
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.bands import Bands, bands_of
from clrelight.jobs.region import list_tiles
from clrelight.jobs.report import Progress, stage
from clrelight.jobs.split_quality import Split, summarize_split
from clrelight.memory import TILE_BYTES
from clrelight.metrics import measure_errors
from clrelight.streaming import reading_ahead

Sums = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Of windows: squared errors at each light, and how many pixels count."""
MeasureWindows = Callable[[Sequence[Region]], Sums]
SAMPLED_FROM = 1 << 20
"""Pixels from which an image is measured at a sample where nothing else is said."""
_WINDOW, _WINDOWS, _FEW = 256, 30, 8


def measure_parts(
    regions: Regions,
    record: FitRecord,
    stack: LightStack,
    split: Split,
    device: Device,
    *,
    sampled: bool,
    progress: Progress | None = None,
    elsewhere: MeasureWindows | None = None,
) -> dict[str, float]:
    """Return PSNRs as `clrelight.jobs.measure.measure_split` does.

    Parameters
    ----------
    regions : Regions
        What decodes parts of the encoding.
    record : FitRecord
        Of the fit that is encoded.
    stack : LightStack
    split : pair of ndarray
        The lights of the stack that were fitted, and those held out.
    device : Device
    sampled : bool
        Measure at windows all over the image; ``sampled`` is then their part of its pixels, and ``error_fitted`` and
        ``error_holdout`` are standard errors of the pooled PSNR in decibel, as the windows differ.
    progress : callable, optional
        Told how many parts are measured.
    elsewhere : callable, optional
        Returns what `measure_windows` would, from other processes.
    """
    height, width, channel = stack.image_shape
    pixel_bytes = 4 * coefficient_count(record.degree) * channel
    windows = sample_windows(stack) if sampled else list_tiles(height, width, pixel_bytes, TILE_BYTES)
    if elsewhere is not None:
        sums_wi, counts_w = elsewhere(windows)
    else:
        with stage(progress, "measuring") as tell:
            sums_wi, counts_w = measure_windows(regions, record, stack, windows, device, tell)
    quality = summarize_split(sums_wi.sum(axis=0) / counts_w.sum(), record.directions_i3, stack, split)
    if sampled:
        counted = height * width if stack.mask_hw is None else int(stack.mask_hw.sum())
        quality["sampled"] = float(counts_w.sum() / counted)
        for name, lights in zip(("fitted", "holdout"), split, strict=True):
            if len(lights):
                quality[f"error_{name}"] = _standard_error(sums_wi[:, lights].mean(axis=1), counts_w)
    return quality


def measure_windows(
    regions: Regions,
    record: FitRecord,
    stack: LightStack,
    windows: Sequence[Region],
    device: Device,
    tell: Callable[[int, int], object] = lambda done, total: None,
) -> Sums:
    """Return each window's squared errors at each light, (n_window, n_light), and the pixels of it that count."""
    sums_wi, counts_w = np.zeros((len(windows), stack.n_light)), np.zeros(len(windows))
    with (
        bands_of(stack) as bands,
        reading_ahead(lambda window: _part_of(stack, window, bands), windows) as parts,
    ):
        for number, (window, part) in enumerate(zip(windows, parts, strict=True)):
            if part is not None:
                fitted = replace(record, surface=None).to_map(regions.shown(window, device))
                counts_w[number] = part.mask_hw.sum() if part.mask_hw is not None else window.n_pixel
                sums_wi[number] = measure_errors(fitted, part, behind=regions.curve, device=device) * counts_w[number]
            tell(number + 1, len(windows))
    return sums_wi, counts_w


def _part_of(stack: LightStack, window: Region, bands: Bands) -> LightStack | None:
    """Return a window of the photographs; None where none of its pixels counts."""
    rows, columns = (window.top, window.bottom), (window.left, window.right)
    mask_hw = None if stack.mask_hw is None else stack.mask_hw[slice(*rows), slice(*columns)]
    if mask_hw is not None and not mask_hw.any():
        return None
    return replace(stack, images_ihwc=bands.part(rows, columns), mask_hw=mask_hw, surface=None)


def _standard_error(sum_w: NDArray[np.float64], count_w: NDArray[np.float64]) -> float:
    """Return the standard error in decibel of -10 log10 (sum / count), of windows that differ."""
    used = count_w > 0
    n, mean = int(used.sum()), float(sum_w.sum() / count_w.sum())
    if n < 2 or mean <= 0.0:
        return 0.0
    residual_w = sum_w[used] - mean * count_w[used]
    deviation = math.sqrt(float((residual_w**2).sum()) * n / (n - 1)) / float(count_w.sum())
    return 10.0 / math.log(10.0) * deviation / mean


def sample_windows(stack: LightStack, most: int | None = None) -> list[Region]:
    """Return windows of at most so many pixels, but one, all over the image, or all over what a mask leaves of it.

    They are in rows and columns, each anywhere in its cell; always the same ones.
    """
    height, width, _ = stack.image_shape
    most = _WINDOWS * _WINDOW**2 if most is None else most
    if height * width <= most:
        return [Region(0, 0, height, width)]
    side = _WINDOW if most >= _FEW * _WINDOW**2 else _WINDOW // 2
    high, wide = min(side, height), min(side, width)
    count = max(most // (high * wide), 1)
    if stack.mask_hw is not None:
        return _masked_windows(stack.mask_hw, high, wide, count)
    across = max(min(round(math.sqrt(count * width / height)), width // wide, count), 1)
    down = max(min(count // across, height // high), 1)
    rng, regions = np.random.default_rng(0), []
    for row in range(down):
        # Windows of a row of cells lie in the same rows of the images, which are read once.
        top = int(rng.integers(row * height // down, (row + 1) * height // down - high + 1))
        for column in range(across):
            left = int(rng.integers(column * width // across, (column + 1) * width // across - wide + 1))
            regions.append(Region(top, left, top + high, left + wide))
    return regions


def _masked_windows(mask_hw: NDArray[np.bool_], high: int, wide: int, count: int) -> list[Region]:
    """Return windows that hold pixels that count, at even distances among all that do."""
    height, width = mask_hw.shape
    found = []
    for row in range(0, height, high):
        for column in range(0, width, wide):
            top, left = min(row, height - high), min(column, width - wide)  # those at the edge reach into others
            part = Region(top, left, top + high, left + wide)
            if mask_hw[part.top : part.bottom, part.left : part.right].any():
                found.append(part)
    chosen = np.unique(np.linspace(0, len(found) - 1, min(count, len(found))).round().astype(int))
    return [found[at] for at in chosen]
