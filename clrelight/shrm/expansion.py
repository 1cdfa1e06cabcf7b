"""From sums over orders m to maps: by FFT, as a product with waves, or on the device."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.latlong import fold_of, folded_waves, longitude_azimuths

METHODS = ("fft", "product", "device")
"""How sums over orders m become columns: by FFT, or as a matrix product with waves, in float64 or on the device."""

_FFT_THREADS = 2


def expand_orders(
    sums_hkmc: NDArray[np.complexfloating], width: int, method: str = "fft", device: Device | None = None
) -> NDArray[np.floating]:
    """Return maps (k, height, width, channel), ``Re sum_m A_m e^(i m beta)`` at the azimuths of columns.

    Parameters
    ----------
    sums_hkmc : ndarray, shape (height, k, order m, channel), complex
    width : int
    method : str
        One of `METHODS`; the device's maps are float32, the others' have the sums' precision.
    device : Device, optional
        Of ``"device"``.
    """
    if method == "fft":
        return _expand_fft(sums_hkmc, width)
    if method == "product":
        return expand_product(sums_hkmc, width, np.matmul)
    if device is None:
        raise InputError("method device needs an open device")
    return _expand_on_device(sums_hkmc, width, device)


def _expand_fft(sums_hkmc: NDArray[np.complexfloating], width: int) -> NDArray[np.floating]:
    height, count, n_order, channel = sums_hkmc.shape
    phase_m = np.exp(-1j * np.arange(n_order) * longitude_azimuths(width)[0]) * width
    phase_m[np.arange(n_order) % width * 2 % width > 0] *= 0.5
    sums_khmc = sums_hkmc.transpose(1, 0, 2, 3).conj() * phase_m[:, None].astype(sums_hkmc.dtype)
    half = width // 2 + 1
    padded_khmc = np.zeros((count, height, half, channel), sums_hkmc.dtype)
    held = min(half, n_order)
    padded_khmc[:, :, :held] = sums_khmc[:, :, :held]  # azimuths fall from column to column
    for m in range(held, n_order):  # waves too fine for the columns look like coarser ones
        like = m % width
        if like < half:
            padded_khmc[:, :, like] += sums_khmc[:, :, m]
        else:
            padded_khmc[:, :, width - like] += sums_khmc[:, :, m].conj()
    return scipy.fft.irfft(padded_khmc, width, axis=2, workers=_FFT_THREADS, overwrite_x=True)


def expand_product(
    sums_hkmc: NDArray[np.complexfloating], width: int, multiply: Callable[[NDArray, NDArray], NDArray]
) -> NDArray[np.floating]:
    """Return what `expand_orders` does by a product of waves (width, 2 n) and sums (2 n, x)."""
    height, k, n_order, channel = sums_hkmc.shape
    angle_wm = np.outer(longitude_azimuths(width), np.arange(n_order))
    waves_wn = np.concatenate([np.cos(angle_wm), -np.sin(angle_wm)], axis=1).astype(sums_hkmc.real.dtype)
    parts_nkhc = np.concatenate([sums_hkmc.real, sums_hkmc.imag], axis=2).transpose(2, 1, 0, 3)
    maps_wx = multiply(waves_wn, np.ascontiguousarray(parts_nkhc).reshape(2 * n_order, -1))
    return np.ascontiguousarray(np.moveaxis(maps_wx.reshape(width, k, height, channel), 0, 2))


def _expand_on_device(sums_hkmc: NDArray[np.complexfloating], width: int, device: Device) -> NDArray[np.float32]:
    """Return maps by shrm/expand.cl, float32."""
    height, count, n_order, channel = sums_hkmc.shape
    sums_hkmx = np.ascontiguousarray(sums_hkmc, np.complex64).view(np.float32)
    fold, lanes = fold_of(width), device.info.lanes
    waves_mjx = folded_waves(width, n_order, lanes)
    maps_khwc = device.empty((count, height, width, channel), np.float32)
    device.launch(
        "shrm/expand.cl",
        "expand_orders_khwc",
        (height, count),
        maps_khwc,
        device.upload(sums_hkmx),
        device.upload(waves_mjx),
        count,
        height,
        width,
        n_order,
        waves_mjx.shape[2],
        defines={"VECTOR": lanes, "FOLD": fold, "CHANNELS": channel},
    )
    return device.download(maps_khwc)
