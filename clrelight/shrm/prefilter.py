"""From light and reflectance to reflection maps: one product per coefficient, then sums over degrees and orders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.brdf.coefficients import BrdfCoefficients
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_index
from clrelight.lighting.light import Light
from clrelight.shrm.expansion import METHODS, expand_orders
from clrelight.shrm.record import Shrm, grid_angles
from clrelight.shrm.spectrum import sum_degrees, turn_orders, turn_rows
from clrelight.shrm.zonal import with_azimuth


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
        One of `expansion.METHODS`.
    dtype : float64 or float32
        Of the sums over degrees and orders, and of the maps by FFT or product.
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
    sums_hkmc = sum_degrees(light.coeffs_kc, brdf.cut(degree, brdf.order), height, dtype)
    if frame == "global":
        sums_hkmc = turn_orders(turn_rows(sums_hkmc, brdf.order, grid_angles(height, width)[0]), brdf.order)
    maps_khwc = expand_orders(sums_hkmc, width, method, device)
    return Shrm(maps_khwc, frame, degree, brdf.centre, light.source, light.axes, dict(brdf.config))


def to_global(shrm: Shrm) -> Shrm:
    """Return the reflection map with views in the frame of the world, the same radiance.

    By frequency-space-environment-maps, eq. 8.

    ``B(R^-1 V)`` has the coefficients of B turned by ``R = Rz(beta) Ry(alpha)``, so ``B_pq = sum_s B_ps d^p_sq(-alpha)
    e^(-i q beta)``.
    """
    if shrm.frame == "global":
        return shrm
    shrm = with_azimuth(shrm)
    alpha_h, beta_w = shrm.angles()
    maps_khwc = _turn_map_rows(shrm.maps_khwc, shrm.order, alpha_h)
    _turn_columns(maps_khwc, shrm.order, beta_w)
    return replace(shrm, maps_khwc=maps_khwc, frame="global")


def to_local(shrm: Shrm) -> Shrm:
    """Return the reflection map with views in the frame of each central direction: the inverse of `to_global`."""
    if shrm.frame != "global":
        return with_azimuth(shrm)
    alpha_h, beta_w = shrm.angles()
    maps_khwc = shrm.maps_khwc.copy()
    _turn_columns(maps_khwc, shrm.order, -beta_w)
    return replace(shrm, maps_khwc=_turn_map_rows(maps_khwc, shrm.order, -alpha_h), frame="local")


def _turn_map_rows(maps_khwc: NDArray[np.floating], order: int, alpha_h: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return maps whose coefficients are turned about y by the angle of their row."""
    turned_hkwc = turn_rows(np.moveaxis(maps_khwc, 0, 1), order, alpha_h)
    return np.ascontiguousarray(np.moveaxis(turned_hkwc, 0, 1))


def _turn_columns(maps_khwc: NDArray[np.floating], order: int, beta_w: NDArray[np.float64]) -> None:
    """Turn coefficients about z by the angle of their column, in place."""
    for q in range(1, order + 1):
        cosine_w1, sine_w1 = (wave(q * beta_w)[:, None].astype(maps_khwc.dtype) for wave in (np.cos, np.sin))
        for p in range(q, order + 1):
            plus, minus = coefficient_index(p, q), coefficient_index(p, -q)
            before_hwc = maps_khwc[plus].copy()
            maps_khwc[plus] = cosine_w1 * before_hwc - sine_w1 * maps_khwc[minus]
            maps_khwc[minus] = sine_w1 * before_hwc + cosine_w1 * maps_khwc[minus]
