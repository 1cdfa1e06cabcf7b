"""Photographs become smaller while they are read: each pixel is the mean radiance over its area."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import linear_to_srgb, srgb_to_linear
from clrelight.errors import InputError

_ROWS = 16
"""That are held as float64 at a time."""


class Edges:
    """Where pixels of the result begin along an axis of `size` pixels, as whole pixels and a part of one.

    Parameters
    ----------
    size : int
        Pixels before.
    count : int
        Pixels after, not more.
    factor : int, optional
        Pixels of each, but of the last where `count` of them are more than there are; by default all are of equal size.
    """

    def __init__(self, size: int, count: int, factor: int | None = None) -> None:
        self.size, self.count = size, count
        at = np.arange(count + 1, dtype=np.int64)
        self.whole, rest = np.divmod(at * size, count) if factor is None else (np.minimum(at * factor, size), 0 * at)
        self.part = rest / count
        self.lengths = np.diff(self.whole) + np.diff(self.part)

    def rows_of(self, number: int) -> tuple[int, int]:
        """Return the first row that a pixel of the result has a part of, and the row behind the last."""
        return int(self.whole[number]), int(self.whole[number + 1]) + int(self.part[number + 1] > 0.0)

    def share_of(self, number: int, first: int, end: int) -> NDArray[np.float64]:
        """Return how much of each row of a range lies in a pixel of the result."""
        row = np.arange(first, end)
        begin, stop = self.whole[number], self.whole[number + 1]
        share = np.ones(end - first)
        share[row == stop] = self.part[number + 1]
        share[row == begin] -= self.part[number]
        return share

    def sum_over(self, row_w: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sums (count, ...) of (size, ...) over each pixel of the result."""
        until = np.zeros((self.size + 1, *row_w.shape[1:]))
        np.cumsum(row_w, axis=0, out=until[1:])
        at = until[self.whole]
        if self.part.any():
            within = row_w[np.minimum(self.whole, self.size - 1)]
            at += within * self.part.reshape(-1, *[1] * (row_w.ndim - 1))
        return np.diff(at, axis=0)


@dataclass(frozen=True)
class Shrink:
    """From what size to what size."""

    rows: Edges
    columns: Edges

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the result."""
        return self.rows.count, self.columns.count

    def mask(self, mask_hw: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which pixels of the result count: those of whose area at least half does."""
        rows = ((row, mask_hw[row : row + 1, :, None]) for row in range(self.rows.size))
        kept_hw = np.zeros(self.shape, bool)
        for row, band_hwc in self.bands(rows, np.dtype(np.float64), "linear", 1.0):
            kept_hw[row : row + len(band_hwc)] = band_hwc[..., 0] >= 0.5 - 1e-9
        return kept_hw

    def bands(
        self, bands: Iterable[tuple[int, NDArray]], dtype: np.dtype, transfer: str, peak: float
    ) -> Iterator[tuple[int, NDArray]]:
        """Yield bands of the result, of a type, with the first row of each.

        Parameters
        ----------
        bands : iterable of (int, ndarray)
            The image from top to bottom: first row, and values (rows, width, channel) behind `transfer`, of which
            `peak` is white.
        """
        to_radiance = _to_radiance(transfer, peak)
        number, sum_wc = 0, None
        for first, band_hwc in bands:
            done = []
            while number < self.rows.count:
                begin, end = self.rows.rows_of(number)
                upper = min(end, first + len(band_hwc))
                for row in range(max(begin, first), upper, _ROWS):
                    stop = min(row + _ROWS, upper)
                    values_hwc = to_radiance(band_hwc[row - first : stop - first])
                    part_wc = np.einsum("h,hwc->wc", self.rows.share_of(number, row, stop), values_hwc)
                    sum_wc = part_wc if sum_wc is None else sum_wc + part_wc
                if upper < end or sum_wc is None:
                    break
                area_w = self.rows.lengths[number] * self.columns.lengths
                done.append(self.columns.sum_over(sum_wc) / area_w[:, None])
                number, sum_wc = number + 1, None
            if done:
                yield number - len(done), _from_radiance(np.stack(done), dtype, transfer, peak)


def plan_shrink(height: int, width: int, downscale: int | None, max_side: int | None) -> Shrink | None:
    """Return how images become smaller, None where they do not.

    Parameters
    ----------
    downscale : int, optional
        Width and height of the block of pixels that becomes one. Blocks at the right and lower edge hold what is left.
    max_side : int, optional
        Pixels of the longer side; the other is what is nearest to the same shape. Larger than it is: nothing is done.

    Raises
    ------
    InputError
        If both are given, or one is no number of pixels.
    """
    if downscale is not None and max_side is not None:
        raise InputError("give one of --downscale and --max-side")
    for name, value, least in (("--downscale", downscale, 2), ("--max-side", max_side, 1)):
        if value is not None and (not isinstance(value, int | np.integer) or value < least):
            raise InputError(f"{name} must be a whole number from {least} on, got {value!r}")
    if downscale is not None:
        high, wide = (Edges(size, math.ceil(size / downscale), downscale) for size in (height, width))
        return Shrink(high, wide)
    longer = max(height, width)
    if max_side is None or max_side >= longer:
        return None
    return Shrink(*(Edges(size, max((2 * size * max_side + longer) // (2 * longer), 1)) for size in (height, width)))


def shrink_mask(shrink: Shrink | None, mask_hw: NDArray[np.bool_] | None, path: object) -> NDArray[np.bool_] | None:
    """Return the mask of what becomes of the images; InputError where no pixel of it counts."""
    if shrink is None or mask_hw is None:
        return mask_hw
    small_hw = shrink.mask(mask_hw)
    if not small_hw.any():
        raise InputError(f"mask {path} leaves no pixel of the smaller images half covered")
    return small_hw


def shrink_notes(shrink: Shrink | None, height: int, width: int, max_side: int | None) -> Iterator[str]:
    """Yield what to say of the size of images."""
    if shrink is not None:
        yield f"images are averaged from {width}×{height} to {shrink.shape[1]}×{shrink.shape[0]} pixels, in radiance"
    elif max_side is not None:
        yield f"images have {width}×{height} pixels already, none on the longer side above {max_side}"


def _to_radiance(transfer: str, peak: float) -> Callable[[NDArray], NDArray[np.float64]]:
    """Return what turns values into radiance, float64, in any unit."""
    if transfer == "linear":
        return lambda values: values.astype(np.float64)
    tables: dict[str, NDArray[np.float64]] = {}

    def decode(values: NDArray) -> NDArray[np.float64]:
        if values.dtype.kind != "u":
            return srgb_to_linear(values.astype(np.float64) / peak)
        if values.dtype.name not in tables:
            tables[values.dtype.name] = srgb_to_linear(np.arange(np.iinfo(values.dtype).max + 1) / peak)
        return tables[values.dtype.name][values]

    return decode


def _from_radiance(radiance: NDArray[np.float64], dtype: np.dtype, transfer: str, peak: float) -> NDArray:
    """Return values of a type: integers are rounded."""
    values = radiance if transfer == "linear" else linear_to_srgb(radiance) * peak
    return (np.rint(values) if dtype.kind == "u" else values).astype(dtype)
