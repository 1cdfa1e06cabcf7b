"""Samples far from the peak, brought by powers of two to where the squares of float32 kernels stay normal numbers.

A bound is a sum of squares: radiance above 1e19 or below 1e-19 of the peak overflows or vanishes in it. Scaling a
column (pixel and channel) by 2^-s changes no rounding error, lambda and rank are the same, and coefficients come back
by 2^s. Columns within the range are left alone, and so is a tile that has no others, as photographs have none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import srgb_to_linear
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit.plan import FitPlan
from clrelight.matmul import SampleCurve

_PLAIN_PEAKS = 2.0**-20, 2.0**20
"""Peaks that may stand in the kernels' matrices; of others only the mantissa does."""
_MOST = 2.0**40
"""Radiance that the kernels square without overflow, whatever the singular values."""
_LEAST_CURVATURE = 1e-29
"""Least E_c / lambda^2 that a column may have: sums of the search for lambda are of this size."""
_LIGHTEST = 1e-6
"""Weights below this part of the mean are not allowed for."""
_LARGEST_EXPONENT = 126
"""Of a factor that is a normal float32, and so is its reciprocal."""
_TOO_LARGE = (
    "coefficients, or images of them, exceed float32, for samples are some 1e37 times the peak: "
    "give the stack a peak near its brightest sample"
)
_BLOCK = 1 << 13
"""Columns whose maxima stay in the cache while all lights pass."""


@dataclass(frozen=True)
class ScaledTile:
    """Samples that the kernels can take.

    Attributes
    ----------
    samples_ihwc : ndarray, shape (n_light, rows, width, channel)
    curve : SampleCurve
        How the kernels read them.
    exponent_hwc : ndarray, shape (rows, width, channel), int, or None
        Coefficients of the samples are 2 to minus this times those of the stack. None: they are the same.
    """

    samples_ihwc: NDArray
    curve: SampleCurve
    exponent_hwc: NDArray[np.intc] | None

    def restore(self, coeffs_khwc: NDArray[np.float32]) -> None:
        """Turn the samples' coefficients into the stack's, in place; InputError as of `check_images`."""
        if self.exponent_hwc is None:
            return
        with np.errstate(over="ignore", under="ignore"):
            np.ldexp(coeffs_khwc, self.exponent_hwc, out=coeffs_khwc)
        check_images(coeffs_khwc)


class TileScaling:
    """What brings the tiles of one fit into range.

    Parameters
    ----------
    stack : LightStack
    plan : FitPlan
        The range depends on its singular values and its bound.
    dtype : dtype
        What the kernels compute in; of float64 everything is in range.
    curve : SampleCurve, optional
        How integer samples are read that are not read as radiance (`FitMethod.curve_of`).

    Attributes
    ----------
    curve : SampleCurve
        That of nearly all tiles: the stack's, its peak's exponent taken out where it is extreme.
    """

    def __init__(self, stack: LightStack, plan: FitPlan, dtype: np.dtype, curve: SampleCurve | None = None) -> None:
        self._stack = stack
        wide = dtype == np.float64
        self._least, self._exponent = (0.0, 0) if wide else _range(plan)
        self._most = math.inf if wide else _MOST
        plain = wide or curve is not None or _PLAIN_PEAKS[0] <= stack.peak <= _PLAIN_PEAKS[1]
        mantissa, exponent = math.frexp(stack.peak)
        # An sRGB curve is not linear in the peak: samples of an extreme one are decoded here.
        self._decodes_all = stack.transfer == "srgb" and not plain
        shifts = stack.transfer == "linear" and not plain
        self._peak_exponent = exponent if shifts else 0
        self.curve = curve or SampleCurve(mantissa if shifts else stack.peak, stack.transfer)

    def load(self, first: int, end: int, out_ihwc: NDArray | None = None) -> ScaledTile:
        """Return rows first..end of a stack as `LightStack.read_rows` does, in range; the same errors."""
        return self.scale(self._stack.load_rows(first, end, out_ihwc), first)

    def scale(self, tile_ihwc: NDArray, first: int, left: int = 0) -> ScaledTile:
        """Return samples that were read from row `first` and column `left` on, C-contiguous, in range; as `load`."""
        columns_ip = tile_ihwc.reshape(len(tile_ihwc), -1)
        shape_hwc = tile_ihwc.shape[1:]
        is_float = tile_ihwc.dtype.kind == "f"
        if is_float or self._decodes_all:
            peak_p = column_peaks(columns_ip)
            if is_float and not np.isfinite(peak_p).all():
                self._stack.check_tile(tile_ihwc, first, left)
                peak_p = np.abs(columns_ip).max(axis=0)  # no more than a sign of zero
            exponent_p = self._find_exponents(peak_p)
            if exponent_p is not None:
                owned = tile_ihwc.dtype == np.float32 and not _shares_memory(tile_ihwc, self._stack.images_ihwc)
                scaled_ip = columns_ip if owned else np.empty(columns_ip.shape, np.float32)
                curve = self._scale(columns_ip, exponent_p, scaled_ip)
                undone_p = exponent_p - self._peak_exponent
                return ScaledTile(scaled_ip.reshape(tile_ihwc.shape), curve, undone_p.reshape(shape_hwc))
        if self._peak_exponent:
            return ScaledTile(tile_ihwc, self.curve, np.full(shape_hwc, -self._peak_exponent, np.intc))
        return ScaledTile(tile_ihwc, self.curve, None)

    def _find_exponents(self, peak_p: NDArray) -> NDArray[np.intc] | None:
        """Return each column's exponent s, 0 where it is in range; None where all are."""
        # As the kernels have it: the exponent of an extreme peak is not theirs.
        radiance_p = peak_p.astype(np.float64) / self.curve.peak
        if self._stack.transfer == "srgb":
            radiance_p = srgb_to_linear(radiance_p)
        outside_p = (radiance_p > 0.0) & ((radiance_p < self._least) | (radiance_p > self._most))
        if not (outside_p.any() or self._decodes_all):
            return None
        # In the units of what is scaled: samples of a linear stack, radiance of others.
        value_p = peak_p.astype(np.float64) if self._stack.transfer == "linear" else radiance_p
        _, power_p = np.frexp(value_p)
        wanted = self._exponent + (math.frexp(self.curve.peak)[1] if self._stack.transfer == "linear" else 0)
        limit = _LARGEST_EXPONENT
        return np.where(outside_p, np.clip(power_p - wanted, -limit, limit), 0).astype(np.intc)

    def _scale(self, columns_ip: NDArray, exponent_p: NDArray[np.intc], out_ip: NDArray[np.float32]) -> SampleCurve:
        """Fill `out_ip` with scaled samples, or with scaled radiance where the curve is not linear."""
        if self._stack.transfer == "linear":
            factor_p = np.ldexp(np.float32(1.0), -exponent_p)
            for row_p, out_p in zip(columns_ip, out_ip, strict=True):
                np.multiply(row_p, factor_p, out=out_p)
            return self.curve
        for row_p, out_p in zip(columns_ip, out_ip, strict=True):
            out_p[...] = np.ldexp(srgb_to_linear(row_p / np.float64(self._stack.peak)), -exponent_p)
        return SampleCurve()


def check_images(coeffs_kx: NDArray) -> None:
    """Raise InputError where float32 cannot hold coefficients (n_coeff, ...), or an image of them.

    An image is at most a pixel's norm times that of the functions at a light, which is below the root of their number.
    """
    count, most = len(coeffs_kx), float(np.finfo(np.float32).max)
    largest = float(max(coeffs_kx.max(), -coeffs_kx.min()))  # no array of magnitudes: tiles are counted to the byte
    if most / count < largest <= most:  # else no norm is near, or one is beyond
        square_x = np.einsum("k...,k...->...", coeffs_kx, coeffs_kx, dtype=np.float64)
        largest = math.sqrt(count * float(square_x.max()))
    if not largest <= most:  # so is what is no number
        raise InputError(_TOO_LARGE)


def round_coefficients(values_kp: NDArray, out_kp: NDArray[np.float32]) -> None:
    """Fill `out_kp` with the values rounded to float32; InputError as of `check_images`."""
    check_images(values_kp)
    with np.errstate(under="ignore"):
        out_kp[...] = values_kp


def column_peaks(columns_ip: NDArray) -> NDArray:
    """Return the largest sample of each column; not finite where one is negative (or minus zero), NaN or infinite."""
    if columns_ip.dtype.kind != "f":
        return columns_ip.max(axis=0)
    # Bits order as the numbers do, see `clrelight.dataset.is_radiance`: whatever is no radiance is above infinity.
    bits_ip = columns_ip.view(columns_ip.dtype.str.replace("f", "u"))
    bits_p = np.empty(bits_ip.shape[1], bits_ip.dtype)
    for start in range(0, len(bits_p), _BLOCK):
        block = slice(start, start + _BLOCK)
        np.max(bits_ip[:, block], axis=0, out=bits_p[block])
    infinity = np.asarray(np.inf, columns_ip.dtype).view(bits_p.dtype)
    return np.minimum(bits_p, infinity).view(columns_ip.dtype)


def _range(plan: FitPlan) -> tuple[float, int]:
    """Return the least radiance of a column's brightest sample, and the exponent that others are scaled to."""
    counted = plan.energy_i > 0.0
    energy_i = plan.energy_i[counted]
    # A bound on lambda as in `clrelight.fit.cls_columns`, with a norm that costs no decomposition.
    ratio = float(np.sqrt(np.sum(plan.analysis_ri[:, counted] ** 2 / energy_i)))
    largest_lambda = max(float(plan.singular_r.max()) * ratio, 1.0)
    lightest = max(float(energy_i.min()), _LIGHTEST * float(energy_i.mean()))
    least = min(largest_lambda * math.sqrt(_LEAST_CURVATURE / lightest), _MOST / 4.0)
    return least, max(0, math.frexp(least)[1] + 1)


def _shares_memory(tile_ihwc: NDArray, images_ihwc: object) -> bool:
    return isinstance(images_ihwc, np.ndarray) and np.may_share_memory(tile_ihwc, images_ihwc)
