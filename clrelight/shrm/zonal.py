"""Reflection maps without azimuths: P + 1 coefficients, not (P + 1)^2 (frequency-space-environment-maps, section 7).

They are all that a reflectance in ``theta_i`` and ``theta_o`` alone has, such as Kajiya and Kay's, or Kautz and
McCool's approximation of any other. None turns about its central direction: they may be looked up between texels
anywhere.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.brdf.coefficients import BrdfCoefficients
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count, degrees_of_coefficients
from clrelight.harmonics.latlong import synthesize_latlong
from clrelight.lighting.light import Light
from clrelight.shrm.record import Shrm, grid_angles


def zonal_indices(order: int) -> NDArray[np.intp]:
    """Return where the coefficients of q = 0 are among all, (P + 1,)."""
    p = np.arange(order + 1)
    return p * (p + 1)


def build_zonal(
    light: Light, brdf: BrdfCoefficients, height: int, width: int | None = None, *, dtype: DTypeLike = np.float64
) -> Shrm:
    """Return the zonal reflection map of a light and a reflectance, whose coefficients of q > 0 do not count.

    ``B_p0(alpha, beta) = sum_lm sqrt(4 pi / (2 l + 1)) L_lm rho_lp0 Y_lm(alpha, beta)``, as ``d^l_m0(alpha) e^(i m
    beta)`` is a harmonic: each p is the light, convolved.

    Parameters
    ----------
    light : Light
    brdf : BrdfCoefficients
    height, width : int
        Width is twice the height by default; more than 2 F.
    dtype : float64 or float32
        Of the maps.
    """
    width = 2 * height if width is None else width
    degree = min(light.degree, brdf.degree)
    if min(height, width) < 1:
        raise InputError(f"a reflection map has 1 row and column at least, got {height} and {width}")
    if light.channels != brdf.channels and 1 not in (light.channels, brdf.channels):
        raise InputError(f"the light has {light.channels} channels and the reflectance {brdf.channels}")
    degree_k = degrees_of_coefficients(degree)
    scaled_kc = np.sqrt(4.0 * np.pi / (2.0 * degree_k + 1.0))[:, None] * light.coeffs_kc[: coefficient_count(degree)]
    product_kpc = scaled_kc[:, None] * brdf.rho_lpqc[: degree + 1, :, 0][degree_k]
    map_hwx = synthesize_latlong(product_kpc.reshape(len(product_kpc), -1), height, width)
    maps_phwc = np.moveaxis(map_hwx.reshape(height, width, *product_kpc.shape[1:]), 2, 0).astype(dtype, order="C")
    return Shrm(maps_phwc, "zonal", degree, brdf.centre, light.source, light.axes, dict(brdf.config))


def to_zonal(shrm: Shrm) -> Shrm:
    """Return the coefficients of q = 0 of a local reflection map: those of others are left out."""
    if shrm.frame == "zonal":
        return shrm
    if shrm.frame != "local":
        raise InputError("coefficients of q = 0 stand for views without azimuth in local reflection maps alone")
    return replace(shrm, maps_khwc=shrm.maps_khwc[zonal_indices(shrm.order)], frame="zonal")


def with_azimuth(shrm: Shrm) -> Shrm:
    """Return a zonal reflection map as a local one, whose coefficients of q > 0 are 0; others as they are."""
    if shrm.frame != "zonal":
        return shrm
    maps_khwc = np.zeros((coefficient_count(shrm.order), *shrm.maps_khwc.shape[1:]), shrm.maps_khwc.dtype)
    maps_khwc[zonal_indices(shrm.order)] = shrm.maps_khwc
    return replace(shrm, maps_khwc=maps_khwc, frame="local")


def zonal_view(shrm: Shrm, view_3: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return the map (height, width, channel) of a distant view of a zonal map: O(P) a texel.

    ``B(alpha, beta) = sum_p B_p0(alpha, beta) f_p0(theta_o)``, where theta_o is the view's angle from each direction.
    """
    alpha_h, beta_w = grid_angles(*shrm.maps_khwc.shape[1:3])
    x, y, z = np.asarray(view_3, np.float64)
    along_w = np.cos(beta_w) * x + np.sin(beta_w) * y
    cosine_hw = np.sin(alpha_h)[:, None] * along_w + np.cos(alpha_h)[:, None] * z
    weight_phw = zonal_weights(cosine_hw, shrm.order).astype(shrm.maps_khwc.dtype)
    total_hwc = weight_phw[0][..., None] * shrm.maps_khwc[0]
    for weight_hw, map_hwc in zip(weight_phw[1:], shrm.maps_khwc[1:], strict=True):
        total_hwc += weight_hw[..., None] * map_hwc
    return total_hwc


def zonal_weights(cosine_x: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """Return ``f_p0(theta) = sqrt((2 p + 1) / 4 pi) P_p(cos theta)`` of p = 0 .. P, (P + 1, ...), of cosines (...)."""
    values_px = np.ones((order + 1, *np.shape(cosine_x)))
    if order:
        values_px[1] = cosine_x
    for p in range(2, order + 1):  # Bonnet's recurrence
        values_px[p] = ((2 * p - 1) * cosine_x * values_px[p - 1] - (p - 1) * values_px[p - 2]) / p
    scale_p = np.sqrt((2.0 * np.arange(order + 1) + 1.0) / (4.0 * np.pi))
    return values_px * scale_p.reshape(-1, *(1 for _ in np.shape(cosine_x)))
