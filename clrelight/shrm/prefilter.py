"""From light and reflectance to reflection maps: one product per coefficient, then sums over degrees and orders."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.fft
from numpy.typing import DTypeLike, NDArray

from clrelight.brdf.coefficients import BrdfCoefficients
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count, coefficient_index
from clrelight.harmonics.latlong import longitude_azimuths
from clrelight.harmonics.rotation import rotation_blocks
from clrelight.harmonics.wigner import complex_coefficients, turn_functions
from clrelight.lighting.light import Light
from clrelight.matmul import multiply_columns
from clrelight.shrm.record import Shrm, grid_angles
from clrelight.shrm.zonal import with_azimuth

METHODS = ("fft", "product", "device")
"""How sums over orders m become columns: by FFT, or as a matrix product with waves, in float64 or on the device."""

_FFT_THREADS = 2

Expand = Callable[[NDArray[np.complexfloating], int], NDArray[np.floating]]


def build_shrm(
    light: Light,
    brdf: BrdfCoefficients,
    height: int,
    width: int | None = None,
    *,
    frame: str = "local",
    method: str = "fft",
    dtype: DTypeLike = np.float64,
    device: Device | None = None,
) -> Shrm:
    """Return the reflection map of a light and a reflectance (frequency-space-environment-maps, eq. 14 and appendix C).

    ``B_pq(alpha, beta) = sum_lm L_lm rho_lpq d^l_mq(alpha) e^(i m beta)``, without the Lambda_l of eq. 5: sums over
    degrees give ``B_mpq(alpha)`` in O(F^2 P^2 S), sums over orders the maps in O(F P^2 S^2), or O(log S P^2 S^2) by
    FFT. Global maps are turned while they are sums of orders, of which there are fewer than columns.

    Parameters
    ----------
    light : Light
        Of degree F at least; what lies beyond the reflectance's degree, and what it lacks, counts as 0.
    brdf : BrdfCoefficients
    height, width : int
        Rows and columns; width is twice the height by default. More than 2 F columns for ``"fft"``.
    frame : str
        ``"local"`` or ``"global"``, see `record.FRAMES`.
    method : str
        One of `METHODS`.
    dtype : float64 or float32
        Of the sum over orders and of the maps, by FFT or product.
    device : Device, optional
        Of ``"device"``, whose maps are float32.
    """
    width = 2 * height if width is None else width
    degree = min(light.degree, brdf.degree)
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise InputError(f"maps are float32 or float64, got {dtype!r}")
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if min(height, width) < 1:
        raise InputError(f"a reflection map has 1 row and column at least, got {height} and {width}")
    if method == "fft" and width <= 2 * degree:
        raise InputError(f"degree {degree} needs a map of more than {2 * degree} columns, got {width}")
    if light.channels != brdf.channels and 1 not in (light.channels, brdf.channels):
        raise InputError(f"the light has {light.channels} channels and the reflectance {brdf.channels}")
    spectrum_khmc = sum_degrees(light.coeffs_kc, brdf.cut(degree, brdf.order), height)
    spectrum_khmc = spectrum_khmc.astype(np.result_type(dtype, np.complex64), copy=False)
    if frame == "global":
        spectrum_khmc = _turn_rows(spectrum_khmc, brdf.order, grid_angles(height, width)[0])
    maps_khwc = _expansion(method, device)(spectrum_khmc, width)
    if frame == "global":
        _turn_columns(maps_khwc, brdf.order, longitude_azimuths(width))
    return Shrm(maps_khwc, frame, degree, brdf.centre, light.source, light.axes, dict(brdf.config))


def sum_degrees(light_kc: NDArray[np.float64], brdf: BrdfCoefficients, height: int) -> NDArray[np.complex128]:
    """Return A with ``map_k = Re sum_m A_km e^(i m beta)``, ((P + 1)**2, height, F + 1, channel) complex128.

    As the light is real, the orders m and -m add up to ``Re (L_lm e^(i m beta)) (d_mq + d_-mq)`` in the real part of
    ``B_pq``, and to ``Im (L_lm e^(i m beta)) (d_mq - d_-mq)`` in the imaginary one.
    """
    degree, order = brdf.degree, brdf.order
    channel = max(light_kc.shape[1], brdf.channels)
    spectrum_khmc = np.zeros((coefficient_count(order), height, degree + 1, channel), np.complex128)
    light_kc = light_kc[: coefficient_count(degree)]
    for q in range((min(order, degree) if brdf.has_azimuth else 0) + 1):
        plus = np.array([coefficient_index(p, q) for p in range(q, order + 1)])
        minus = np.array([coefficient_index(p, -q) for p in range(q, order + 1)])
        for m in range(degree + 1):
            sums_lh, differences_lh = _turn_pairs(height, degree, m, q)
            first = max(m, q)
            light_lc = complex_coefficients(light_kc, m)[first - m :]
            product_lpc = light_lc[:, None] * brdf.rho_lpqc[first:, q:, q]
            spectrum_khmc[plus, :, m] = (np.sqrt(2.0) if q else 1.0) * _sum_rows(sums_lh, product_lpc)
            if q:  # -Im z = Re (i z)
                spectrum_khmc[minus, :, m] = np.sqrt(2.0) * 1j * _sum_rows(differences_lh, product_lpc)
    return spectrum_khmc


def _sum_rows(turn_lh: NDArray[np.float64], product_lpc: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return ``sum_l turn product``, (p, height, channel), by one real product."""
    flat_lx = np.ascontiguousarray(product_lpc).reshape(len(product_lpc), -1).view(np.float64)
    sums_hx = np.ascontiguousarray(turn_lh.T @ flat_lx)
    return np.moveaxis(sums_hx.view(np.complex128).reshape(-1, *product_lpc.shape[1:]), 1, 0)


@functools.lru_cache(maxsize=8192)
def _turn_pairs(height: int, degree: int, m: int, q: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``d_mq + d_-mq`` and ``d_mq - d_-mq`` at the rows, l = max(m, q) .. degree; for m = 0 ``d_0q`` and 0."""
    alpha_h = np.pi * (np.arange(height) + 0.5) / height
    plus_lh = turn_functions(alpha_h, degree, m, q)
    if m == 0:
        return plus_lh, np.zeros_like(plus_lh)
    minus_lh = turn_functions(alpha_h, degree, -m, q)
    return plus_lh + minus_lh, plus_lh - minus_lh


def _expansion(method: str, device: Device | None) -> Expand:
    if method == "fft":
        return _expand_fft
    if method == "product":
        return lambda spectrum_khmc, width: expand_product(spectrum_khmc, width, np.matmul)
    if device is None:
        raise InputError("method device needs an open device")
    return lambda spectrum_khmc, width: expand_product(
        spectrum_khmc,
        width,
        lambda waves_wn, parts_nx: multiply_columns(device, waves_wn, parts_nx.astype(np.float32)),
    )


def _expand_fft(spectrum_khmc: NDArray[np.complexfloating], width: int) -> NDArray[np.floating]:
    n_order = spectrum_khmc.shape[2]
    phase_m = np.exp(-1j * np.arange(n_order) * longitude_azimuths(width)[0]) * (0.5 * width)
    phase_m[0] = width
    padded = np.zeros((*spectrum_khmc.shape[:2], width // 2 + 1, spectrum_khmc.shape[3]), spectrum_khmc.dtype)
    phase_m1 = phase_m[:, None].astype(spectrum_khmc.dtype)
    np.multiply(spectrum_khmc.conj(), phase_m1, out=padded[:, :, :n_order])  # azimuths fall from column to column
    return scipy.fft.irfft(padded, width, axis=2, workers=_FFT_THREADS)


def expand_product(
    spectrum_khmc: NDArray[np.complexfloating], width: int, multiply: Callable[[NDArray, NDArray], NDArray]
) -> NDArray[np.floating]:
    """Return maps (k, height, width, channel) of `sum_degrees` by a product of waves (width, 2 n) and sums (2 n, x)."""
    k, height, n_order, channel = spectrum_khmc.shape
    angle_wm = np.outer(longitude_azimuths(width), np.arange(n_order))
    waves_wn = np.concatenate([np.cos(angle_wm), -np.sin(angle_wm)], axis=1).astype(spectrum_khmc.real.dtype)
    parts_nkhc = np.moveaxis(np.concatenate([spectrum_khmc.real, spectrum_khmc.imag], axis=2), 2, 0)
    maps_wx = multiply(waves_wn, np.ascontiguousarray(parts_nkhc).reshape(2 * n_order, -1))
    return np.ascontiguousarray(np.moveaxis(maps_wx.reshape(width, k, height, channel), 0, 2))


def to_global(shrm: Shrm) -> Shrm:
    """Return the reflection map with views in the frame of the world (eq. 8), the same radiance.

    ``B(R^-1 V)`` has the coefficients of B turned by ``R = Rz(beta) Ry(alpha)``, so ``B_pq = sum_s B_ps d^p_sq(-alpha)
    e^(-i q beta)``.
    """
    if shrm.frame == "global":
        return shrm
    shrm = with_azimuth(shrm)
    alpha_h, beta_w = shrm.angles()
    maps_khwc = _turn_rows(shrm.maps_khwc, shrm.order, alpha_h)
    _turn_columns(maps_khwc, shrm.order, beta_w)
    return replace(shrm, maps_khwc=maps_khwc, frame="global")


def to_local(shrm: Shrm) -> Shrm:
    """Return the reflection map with views in the frame of each central direction: the inverse of `to_global`."""
    if shrm.frame != "global":
        return with_azimuth(shrm)
    alpha_h, beta_w = shrm.angles()
    maps_khwc = shrm.maps_khwc.copy()
    _turn_columns(maps_khwc, shrm.order, -beta_w)
    return replace(shrm, maps_khwc=_turn_rows(maps_khwc, shrm.order, -alpha_h), frame="local")


@functools.lru_cache(maxsize=4)
def _turns_about_y(order: int, angles: tuple[float, ...]) -> list[NDArray[np.float64]]:
    """Return for each degree the blocks (angle, 2 p + 1, 2 p + 1) that turn coefficients about y."""
    blocks = []
    for angle in angles:
        cosine, sine = np.cos(angle), np.sin(angle)
        blocks.append(rotation_blocks(np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]), order))
    return [np.stack([each[p] for each in blocks]) for p in range(order + 1)]


def _turn_rows(values_khxc: NDArray, order: int, alpha_h: NDArray[np.float64]) -> NDArray:
    """Return coefficients turned about y by the angle of their row; values may be complex sums of orders."""
    turned_khxc = np.empty_like(values_khxc)
    real = values_khxc.real.dtype
    for p, block_hij in enumerate(_turns_about_y(order, tuple(alpha_h.tolist()))):
        band = slice(p * p, (p + 1) ** 2)
        rows_hjx = np.ascontiguousarray(np.moveaxis(values_khxc[band], 0, 1)).reshape(len(alpha_h), 2 * p + 1, -1)
        turned_hix = np.matmul(block_hij.astype(real), rows_hjx.view(real)).view(values_khxc.dtype)
        turned_khxc[band] = np.moveaxis(turned_hix.reshape(len(alpha_h), 2 * p + 1, *values_khxc.shape[2:]), 0, 1)
    return turned_khxc


def _turn_columns(maps_khwc: NDArray[np.floating], order: int, beta_w: NDArray[np.float64]) -> None:
    """Turn coefficients about z by the angle of their column, in place."""
    for q in range(1, order + 1):
        cosine_w1, sine_w1 = (wave(q * beta_w)[:, None].astype(maps_khwc.dtype) for wave in (np.cos, np.sin))
        for p in range(q, order + 1):
            plus, minus = coefficient_index(p, q), coefficient_index(p, -q)
            before_hwc = maps_khwc[plus].copy()
            maps_khwc[plus] = cosine_w1 * before_hwc - sine_w1 * maps_khwc[minus]
            maps_khwc[minus] = sine_w1 * before_hwc + cosine_w1 * maps_khwc[minus]
