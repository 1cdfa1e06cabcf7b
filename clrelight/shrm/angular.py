"""Reflected light by integration over angles: the truth of reflection maps, and their peer in time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import theta_rule
from clrelight.brdf.radial import Phong
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.lighting.environment import Environment

_PAIRS_AT_ONCE = 1 << 22
_WIDTH_ANGLES = 256
_RUN = 2048
_POINTS_AT_ONCE = 2048


def lobe_angle(brdf: CentredBrdf, epsilon: float) -> float:
    """Return the angle ``theta_i`` within which a reflectance sends on ``1 - epsilon`` of what it does, in radians.

    ``acos(epsilon^(1 / (s + 1)))`` of a Phong lobe (frequency-space-environment-maps, appendix D); of others by sums
    over all views.
    """
    if not 0.0 <= epsilon < 1.0:
        raise InputError(f"epsilon must be at least 0 and below 1, got {epsilon!r}")
    if isinstance(brdf, Phong):
        return math.acos(epsilon ** (1.0 / (brdf.exponent + 1.0)))
    theta_i, weight_i = theta_rule(_WIDTH_ANGLES)
    theta_o, weight_o = theta_rule(_WIDTH_ANGLES // 8)
    phi_a = np.asarray((np.arange(_WIDTH_ANGLES // 8) + 0.5) * (8.0 * np.pi / _WIDTH_ANGLES), np.float64)
    values = brdf.evaluate(theta_i[:, None, None], theta_o[:, None], phi_a)
    sent_i = np.cumsum(np.einsum("ioac,o->i", values, weight_o) * weight_i)
    return float(theta_i[np.searchsorted(sent_i, (1.0 - epsilon) * sent_i[-1])]) if epsilon else math.pi


def integrate_directions(
    directions_t3: NDArray[np.float64],
    weighted_tc: NDArray[np.float64],
    brdf: CentredBrdf,
    central_n3: NDArray[np.float64],
    views_n3: NDArray[np.float64],
    *,
    epsilon: float = 0.0,
) -> NDArray[np.float64]:
    """Return ``sum_t w_t L_t rho(theta_i, theta_o, phi)``, (n, channel) float64.

    The reflection equation (frequency-space-environment-maps, eq. 2): O(W T) for each of n points, where W is the part
    of the T directions within `lobe_angle`.

    Parameters
    ----------
    directions_t3 : ndarray, shape (n_direction, 3)
        Unit vectors towards the light.
    weighted_tc : ndarray, shape (n_direction, channel)
        Radiance times solid angle.
    brdf : CentredBrdf
    central_n3, views_n3 : ndarray, shape (n, 3)
        The central direction and the view of each point, unit vectors; one view may stand for all.
    epsilon : float
        Part of the lobe that is left out, 0 for none.
    """
    central_n3, views_n3 = np.broadcast_arrays(central_n3, views_n3)
    edge = math.cos(lobe_angle(brdf, epsilon)) if epsilon else -2.0
    channels = max(weighted_tc.shape[1], brdf.channels)
    sums_nc = np.zeros((len(central_n3), channels))
    step = max(1, _PAIRS_AT_ONCE // max(len(directions_t3), 1))
    for first in range(0, len(central_n3), step):
        part = slice(first, first + step)
        cosine_nt = central_n3[part] @ directions_t3.T
        near_j, light_j = np.nonzero(cosine_nt >= edge)
        values_jc = _values(
            brdf, cosine_nt[near_j, light_j], central_n3[part], views_n3[part], directions_t3, near_j, light_j
        )
        reflected_jc = values_jc * weighted_tc[light_j]
        for c in range(channels):
            sums_nc[part, c] = np.bincount(near_j, reflected_jc[:, c], minlength=len(cosine_nt))
    return sums_nc


def _values(
    brdf: CentredBrdf,
    cosine_j: NDArray[np.float64],
    central_n3: NDArray[np.float64],
    views_n3: NDArray[np.float64],
    directions_t3: NDArray[np.float64],
    near_j: NDArray[np.intp],
    light_j: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Return the reflectance (j, channel) of pairs of points and lights, from cosines between their directions."""
    theta_i = np.arccos(np.clip(cosine_j, -1.0, 1.0))
    if brdf.is_radial:
        return brdf.evaluate(theta_i, np.zeros(1), np.zeros(1))
    view_n = np.clip(np.sum(central_n3 * views_n3, axis=1), -1.0, 1.0)
    theta_o = np.arccos(view_n)[near_j]
    if not brdf.has_azimuth:
        return brdf.evaluate(theta_i, theta_o, np.zeros(1))
    between_j = np.einsum("jx,jx->j", views_n3[near_j], directions_t3[light_j])
    across_j = np.maximum(np.sin(theta_i) * np.sin(theta_o), 1e-12)
    phi_j = np.arccos(np.clip((between_j - cosine_j * view_n[near_j]) / across_j, -1.0, 1.0))
    return brdf.evaluate(theta_i, theta_o, phi_j)


def integrate_on_device(
    device: Device,
    directions_t3: NDArray[np.float64],
    weighted_tc: NDArray[np.float64],
    brdf: CentredBrdf,
    central_n3: NDArray[np.float64],
    views_n3: NDArray[np.float64],
    *,
    epsilon: float = 0.0,
) -> NDArray[np.float32]:
    """Return what `integrate_directions` does, (n, channel) float32, of Phong's, microfacets' or fibres' lobes.

    See shrm/integrate.cl. InputError of another reflectance.
    """
    lobe, number, scale = _lobe_numbers(brdf)
    edge = math.cos(lobe_angle(brdf, epsilon)) if epsilon else -2.0
    central_n3, views_n3 = np.broadcast_arrays(central_n3, views_n3)
    channels, vector = weighted_tc.shape[1], device.info.lanes
    texel_tj = device.upload(np.concatenate([directions_t3, weighted_tc], axis=1).astype(np.float32))
    sums_nc = np.empty((len(central_n3), channels), np.float32)
    for first in range(0, len(central_n3), _POINTS_AT_ONCE):
        part = slice(first, first + _POINTS_AT_ONCE)
        count = len(central_n3[part])
        padded = -(-count // vector) * vector
        points_2dn = np.zeros((2, 3, padded), np.float32)
        points_2dn[0, :, :count], points_2dn[1, :, :count] = central_n3[part].T, views_n3[part].T
        out_cn = device.empty((channels, padded), np.float32)
        device.launch(
            "shrm/integrate.cl",
            "integrate_lobe_cn",
            (padded // vector,),
            out_cn,
            device.upload(points_2dn[0]),
            device.upload(points_2dn[1]),
            texel_tj,
            edge,
            number,
            scale,
            padded,
            texel_tj.shape[0],
            defines={"VECTOR": vector, "CHANNELS": channels, "RUN": _RUN, "LOBE": lobe},
        )
        sums_nc[part] = device.download(out_cn)[:, :count].T
    return sums_nc


def _lobe_numbers(brdf: CentredBrdf) -> tuple[int, float, float]:
    """Return the LOBE, number and scale of shrm/integrate.cl."""
    if isinstance(brdf, Phong):
        return 0, brdf.exponent, (brdf.exponent + 1.0) / (2.0 * math.pi)
    if isinstance(brdf, Microfacet):
        return 1, 1.0 / brdf.sigma, 1.0 / (4.0 * math.pi * brdf.sigma**2)
    if isinstance(brdf, KajiyaKay):
        return 2, brdf.exponent, 1.0
    raise InputError(f"the device integrates phong, microfacet and kajiya-kay, got {brdf.id}: take the host")


def weighted_texels(environment: Environment) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return directions (n, 3) of a map's lit texels, and their radiance times solid angle (n, channel), float64."""
    directions_t3, weights_t = environment.geometry()
    weighted_tc = weights_t[:, None] * environment.radiance_hwc.reshape(len(weights_t), -1)
    lit_t = (weights_t > 0.0) & weighted_tc.any(axis=1)
    return directions_t3[lit_t], weighted_tc[lit_t]
