"""Peak signal-to-noise ratio of relit images against a stack's own photographs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.basis import evaluate_basis
from clrelight.dataset import CoefficientMap, LightStack, read_rows_into
from clrelight.device import Device, DeviceArray, open_device
from clrelight.errors import InputError
from clrelight.matmul import apply_operator, pack_operator, sample_defines
from clrelight.streaming import Buffer, reading_ahead

_CPU_SEGMENT = 512
_GPU_SEGMENT, _GPU_GROUP = 4096, 256
_TILE_BYTES = 1 << 24
"""Coefficients and relit images of one tile of rows."""


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


def psnr_of(mean_squared_error: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``-10 log10(mse)`` for errors in units of the peak; inf for 0."""
    with np.errstate(divide="ignore"):
        return -10.0 * np.log10(np.asarray(mean_squared_error, dtype=np.float64))


def summarize_errors(mse_i: NDArray[np.float64]) -> Quality:
    """Return the quality of images whose mean squared errors, in units of the peak, are `mse_i`."""
    psnr_i = psnr_of(mse_i)
    return Quality(float(np.mean(psnr_i)), float(psnr_of(float(np.mean(mse_i)))), psnr_i)


def measure_errors(
    coefficients: CoefficientMap,
    stack: LightStack,
    *,
    device: Device | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.float64]:
    """Return each light's mean squared error between the relit and the given image, float64, in units of the peak.

    Values are clipped to [0, peak] and compared in the stack's own transfer; pixels outside the mask do not count.

    Raises
    ------
    InputError
        If the coefficients are not of this view, or no pixel counts.
    """
    device = device or open_device()
    if coefficients.image_shape != stack.image_shape:
        raise InputError(
            f"the coefficients are of images {coefficients.image_shape} but the stack has {stack.image_shape} "
            "(height, width, channel)"
        )
    height, width, channel = stack.image_shape
    mask_hw = np.ones((height, width), bool) if stack.mask_hw is None else stack.mask_hw
    count = int(mask_hw.sum()) * channel
    if count == 0:
        raise InputError("the mask leaves no pixel to measure")
    basis = pack_operator(device, evaluate_basis(stack.directions_i3, coefficients.degree))
    total_i = np.zeros(stack.n_light)
    step = max(1, _TILE_BYTES // (4 * (stack.n_light + coefficients.n_coeff) * width * channel))
    tiles = [(first, min(first + step, height)) for first in range(0, height, step)]
    coeffs_of, samples_of = (itertools.cycle([Buffer(), Buffer()]) for _ in range(2))
    relit = Buffer()

    def read(rows: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray]:
        tile_shape = (rows[1] - rows[0], width, channel)
        coeffs_khwc = next(coeffs_of).lend((coefficients.n_coeff, *tile_shape), np.float32)
        samples_ihwc = next(samples_of).lend((stack.n_light, *tile_shape), stack.images_ihwc.dtype)
        return read_rows_into(coefficients.coeffs_khwc, *rows, coeffs_khwc), stack.read_rows(*rows, samples_ihwc)

    with reading_ahead(read, tiles) as pieces:
        for (first, end), (coeffs_khwc, samples_ihwc) in zip(tiles, pieces, strict=True):
            weight_p = np.repeat(mask_hw[first:end].ravel(), channel).astype(np.float32)
            shape_ip = (stack.n_light, len(weight_p))
            relit_ip = device.empty(
                shape_ip, np.float32, relit.lend(shape_ip, np.float32) if device.shares_memory else None
            )
            apply_operator(device, basis, device.upload(coeffs_khwc.reshape(-1, len(weight_p))), relit_ip)
            source_ip = device.upload(samples_ihwc.reshape(shape_ip))
            error_it = sum_errors(device, relit_ip, source_ip, device.upload(weight_p), stack.peak, stack.transfer)
            total_i += device.download(error_it).sum(axis=1, dtype=np.float64)
            if progress is not None:
                progress(end, height)
    return total_i / count


def sum_errors(
    device: Device,
    relit_ip: DeviceArray,
    source_ip: DeviceArray,
    weight_p: DeviceArray,
    peak: float,
    transfer: str,
) -> DeviceArray:
    """Queue the sums of squared errors, in units of the peak, of each light and segment of columns."""
    n_light, columns = relit_ip.shape
    on_gpu = device.style == "gpu"
    segment = _GPU_SEGMENT if on_gpu else _CPU_SEGMENT
    error_it = device.empty((n_light, -(-columns // segment)), np.float32)
    device.launch(
        "gpu/metrics/squared_error.cl" if on_gpu else "metrics/squared_error.cl",
        "sum_squared_error_mt",
        (math.prod(error_it.shape) * _GPU_GROUP,) if on_gpu else error_it.shape,
        error_it,
        relit_ip,
        source_ip,
        weight_p,
        1.0 / peak,
        *error_it.shape,
        columns,
        defines={
            **sample_defines(source_ip.dtype),
            "SEGMENT": segment,
            "ENCODE": int(transfer == "srgb"),
            **({"GROUP": _GPU_GROUP} if on_gpu else {}),
        },
        local_size=(_GPU_GROUP,) if on_gpu else None,
    )
    return error_it
