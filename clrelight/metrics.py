"""Peak signal-to-noise ratio of relit images against a stack's own photographs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device, open_device
from clrelight.errors import InputError, counted
from clrelight.matmul import PackedOperator, apply_operator, pack_operator, sample_defines, tile_defines
from clrelight.memory import PIECE_BYTES
from clrelight.opencl.arguments import DeviceArray
from clrelight.streaming import Buffer, reading_ahead
from clrelight.tiles import row_tiles

_SEGMENT, _GROUP = 4096, 256
"""Columns that a GPU's group sums, and its work-items."""
_IN_PLACE = 16
"""Times as much is taken at a time of arrays that are in memory: nothing is copied."""


@dataclass(frozen=True)
class Quality:
    """PSNR over a set of lights, in decibel.

    Attributes
    ----------
    psnr_mean : float
        Mean over the lights of each image's PSNR (what the papers print); inf where one is identical.
    psnr_pooled : float
        PSNR of the mean squared error over all lights.
    psnr_i : ndarray, shape (n_light,), float64
        Of each image.
    """

    psnr_mean: float
    psnr_pooled: float
    psnr_i: NDArray[np.float64]

    @property
    def n_identical(self) -> int:
        """Number of images without any error, such as black ones: a single one makes the mean infinite."""
        return int(np.isinf(self.psnr_i).sum())

    @property
    def psnr_others(self) -> float:
        """The mean over the images that are not identical; inf where all are."""
        others_i = self.psnr_i[np.isfinite(self.psnr_i)]
        return float(np.mean(others_i)) if len(others_i) else math.inf

    @property
    def note(self) -> str:
        """What to say of an infinite mean that is no sign of identical images; empty where there is none."""
        if self.n_identical in (0, len(self.psnr_i)):
            return ""
        identical = f"{self.n_identical} of {counted(len(self.psnr_i), 'image is', 'images are')} identical"
        return f"{identical}, {self.psnr_others:.2f} dB mean over the others"


def psnr_of(mean_squared_error: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``-10 log10(mse)`` for errors in units of the peak; inf for 0."""
    with np.errstate(divide="ignore"):
        return -10.0 * np.log10(np.asarray(mean_squared_error, dtype=np.float64))


def summarize_errors(mse_i: NDArray[np.float64]) -> Quality:
    """Return the quality of images whose mean squared errors, in units of the peak, are `mse_i`."""
    psnr_i = psnr_of(mse_i)
    return Quality(float(np.mean(psnr_i)), float(psnr_of(float(np.mean(mse_i)))), psnr_i)


def domain_note(coefficients: CoefficientMap, stack: LightStack) -> str:
    """Return what to say of a measurement against a stack of another curve or peak than the fitted one's; else nothing.

    Coefficients are of linear radiance in units of the peak whatever the curve, so that there is always a right way.
    """
    if (coefficients.transfer, coefficients.peak) == (stack.transfer, stack.peak):
        return ""
    return (
        f"the fit is of a {coefficients.transfer} stack with peak {coefficients.peak:g}, this one is {stack.transfer} "
        f"with peak {stack.peak:g}: what is relit was converted to that, 1.0 to its peak"
    )


def check_view(coefficients: CoefficientMap, stack: LightStack) -> None:
    """Raise InputError if coefficients are of images of another shape than the stack's."""
    if coefficients.image_shape != stack.image_shape:
        raise InputError(
            f"the coefficients are of images {coefficients.image_shape} but the stack has {stack.image_shape} "
            "(height, width, channel)"
        )


def measure_errors(
    coefficients: CoefficientMap,
    stack: LightStack,
    *,
    behind: str = "linear",
    device: Device | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.float64]:
    """Return each light's mean squared error between the relit and the given image, float64, in units of the peak.

    Values are clipped to [0, peak] and compared in the stack's own transfer, to which relit radiance is converted
    whatever was fitted (`domain_note` says so); pixels outside the mask do not count. `behind` is the curve that values
    of the coefficients are behind, where they are no radiance: see `clrelight.codec.viewing.decode_shown`.

    Raises
    ------
    InputError
        If the coefficients are not of this view, or no pixel counts.
    """
    total_i, count = np.zeros(stack.n_light), count_values(stack)
    for sum_i in errors_of_rows(coefficients, stack, behind=behind, device=device, progress=progress):
        total_i += sum_i
    return total_i / count


def count_values(stack: LightStack) -> int:
    """Return how many values of each image count; InputError where none does."""
    height, width, channel = stack.image_shape
    count = (height * width if stack.mask_hw is None else int(stack.mask_hw.sum())) * channel
    if count == 0:
        raise InputError("the mask leaves no pixel to measure")
    return count


def rows_from_files(stack: LightStack, n_coeff: int, dtype: DTypeLike) -> int:
    """Return how many rows `errors_of_rows` takes at a time where coefficients and images are not arrays in memory."""
    _, width, channel = stack.image_shape
    column_bytes = 4 * stack.n_light + np.dtype(dtype).itemsize * n_coeff
    return max(1, PIECE_BYTES // (column_bytes * width * channel))


def errors_of_rows(
    coefficients: CoefficientMap,
    stack: LightStack,
    *,
    behind: str = "linear",
    device: Device | None = None,
    progress: Callable[[int, int], None] | None = None,
    rows: tuple[int, int] | None = None,
) -> Iterator[NDArray[np.float64]]:
    """Yield each light's sum of squared errors over some rows after others; else as `measure_errors`.

    With `rows`, coefficients are of rows first..end alone, and where first is a multiple of `rows_from_files`, sums
    are those of the whole from files, bit for bit.
    """
    device = device or open_device()
    height, width, channel = stack.image_shape
    top, bottom = rows or (0, height)
    if rows is None:
        check_view(coefficients, stack)
    mask_hw = np.ones((height, width), bool) if stack.mask_hw is None else stack.mask_hw
    basis = pack_operator(device, coefficients.functions_at(stack.directions_i3))
    dtype = np.dtype(coefficients.coeffs_khwc.dtype)
    whole = _arrays_in_place(device, coefficients, stack) if rows is None else None
    step = rows_from_files(stack, coefficients.n_coeff, dtype)
    if whole is not None:
        column_bytes = 4 * stack.n_light + dtype.itemsize * coefficients.n_coeff
        step = max(1, PIECE_BYTES * _IN_PLACE // (column_bytes * width * channel))
    tiles = row_tiles((top, bottom), step)
    coeffs_of, samples_of = (itertools.cycle([Buffer(), Buffer()]) for _ in range(2))
    sum_tile = SumOfErrors(device, basis, stack.peak, stack.transfer, behind)

    def weigh(rows: slice) -> NDArray[np.float32]:
        return np.repeat(mask_hw[rows].astype(np.float32).ravel(), channel)

    every_p = None if whole is None else weigh(slice(0, height))

    def read(part: tuple[int, int]) -> tuple[NDArray, NDArray]:
        if whole is not None:
            stack.check_rows(*part)
            return whole
        tile_shape = (part[1] - part[0], width, channel)
        coeffs_khwc = next(coeffs_of).lend((coefficients.n_coeff, *tile_shape), dtype)
        samples_ihwc = next(samples_of).lend((stack.n_light, *tile_shape), stack.images_ihwc.dtype)
        coefficients.read_rows(part[0] - top, part[1] - top, coeffs_khwc)
        return coeffs_khwc, stack.read_rows(*part, samples_ihwc)

    with reading_ahead(read, tiles) as pieces:
        for (first, end), (coeffs_khwc, samples_ihwc) in zip(tiles, pieces, strict=True):
            held = slice(0, height) if whole is not None else slice(first, end)
            columns = slice((first - held.start) * width * channel, (end - held.start) * width * channel)
            yield sum_tile(coeffs_khwc, samples_ihwc, weigh(held) if every_p is None else every_p, columns)
            if progress is not None:
                progress(end, height)


def _arrays_in_place(device: Device, coefficients: CoefficientMap, stack: LightStack) -> tuple[NDArray, NDArray] | None:
    """Return coefficients and images where kernels can read them as they lie in memory, a tile at a time."""
    arrays = coefficients.coeffs_khwc, stack.images_ihwc
    in_place = all(isinstance(array, np.ndarray) and array.flags.c_contiguous for array in arrays)
    return arrays if device.shares_memory and in_place else None


class SumOfErrors:
    """Sums each light's squared errors over some columns, in units of the peak, float64.

    Parameters
    ----------
    device : Device
    basis : PackedOperator, shape (n_light, n_coeff)
    peak : float
        Of the samples.
    transfer : str
        Curve of the samples: what is relit goes through it.
    behind : str
        Curve that what is relit is behind already.
    """

    def __init__(
        self, device: Device, basis: PackedOperator, peak: float, transfer: str, behind: str = "linear"
    ) -> None:
        self._device, self._basis, self._peak = device, basis, peak
        self._encode = int(transfer == "srgb") - int(behind == "srgb")

    def __call__(
        self, coeffs_khwc: NDArray, samples_ihwc: NDArray, weight_p: NDArray[np.float32], columns: slice
    ) -> NDArray[np.float64]:
        """Return the sums of coefficients and samples in host memory, (n_light,)."""
        device = self._device
        coeffs_kp = device.upload(coeffs_khwc.reshape(len(coeffs_khwc), -1))
        source_ip = device.upload(samples_ihwc.reshape(len(samples_ihwc), -1))
        return self.between(coeffs_kp, source_ip, weight_p, columns)

    def between(
        self, coeffs_kp: DeviceArray, source_ip: DeviceArray, weight_p: NDArray[np.float32], columns: slice
    ) -> NDArray[np.float64]:
        """Return the sums of coefficients and samples that are on the device, (n_light,)."""
        device, weights = self._device, self._device.upload(weight_p)
        if self._basis.heights_b is None:
            relit_ip = device.empty(source_ip.shape, np.float32)
            apply_operator(device, self._basis, coeffs_kp, relit_ip)
            error_it = sum_errors(device, relit_ip, source_ip, weights, self._peak, self._encode)
        else:
            tile = tile_defines(device)
            count = -(-(columns.stop - columns.start) // int(str(tile["TILE"])))
            error_it = device.empty((source_ip.shape[0], count), np.float32)
            device.launch(
                "metrics/relit_error.cl",
                "sum_relit_error_mn",
                (count,),
                error_it,
                coeffs_kp,
                source_ip,
                weights,
                self._basis.packed_o,
                self._basis.heights_b,
                1.0 / self._peak,
                *(columns.start, columns.stop),
                *(*error_it.shape, *coeffs_kp.shape, self._basis.heights_b.shape[0]),
                defines={
                    **tile,
                    **sample_defines(source_ip.dtype),
                    "COEFF_HALF": int(coeffs_kp.dtype == np.float16),
                    "ENCODE": self._encode,
                },
            )
        return device.download(error_it).sum(axis=1, dtype=np.float64)


def sum_errors(
    device: Device, relit_ip: DeviceArray, source_ip: DeviceArray, weight_p: DeviceArray, peak: float, encode: int = 0
) -> DeviceArray:
    """Queue a GPU's sums of squared errors, in units of the peak, of each light and segment of columns.

    `encode` is ``ENCODE`` of the kernel.
    """
    n_light, columns = relit_ip.shape
    error_it = device.empty((n_light, -(-columns // _SEGMENT)), np.float32)
    device.launch(
        "metrics/squared_error.cl",
        "sum_squared_error_mt",
        (math.prod(error_it.shape) * _GROUP,),
        error_it,
        relit_ip,
        source_ip,
        weight_p,
        1.0 / peak,
        *error_it.shape,
        columns,
        defines={
            **sample_defines(source_ip.dtype),
            "SEGMENT": _SEGMENT,
            "ENCODE": encode,
            "GROUP": _GROUP,
        },
        local_size=(_GROUP,),
    )
    return error_it
