"""Intensities of lights from the photographs alone, where directions are known: photometric stereo with unknown gains.

A matte sample is ``b_i = g_i l_i . m``, so that ``d_i b_i = l_i . m`` with ``d = 1 / g``: what of ``d b`` no normal
explains, ``Q diag(b) d`` with ``Q = W - W L (L^T W L)^-1 L^T W``, is least for the eigenvector of the smallest
eigenvalue of ``sum_p diag(b) Q diag(b)``. Weights W leave out shadows and gloss, and follow from the normals in turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.variation.normals import DARK, SHADOW

LEAST_LIGHTS = 5
_SCALES = (1.0, 0.6, 0.4, 0.3, 0.2, 0.15, 0.1, 0.08, 0.06, 0.05, 0.04, 0.03, 0.03, 0.03)
_GREATER = 100.0
"""Two gains apart by more than this factor are no gains of lamps: photographs do not follow the law."""
_TINY = 1e-12


@dataclass(frozen=True)
class LightGains:
    """What lights are in proportion to each other.

    Attributes
    ----------
    gains_i : ndarray, shape (n_light,), float64
        Of mean 1.
    spread : float
        Standard deviation of a gain, as a share of it, from the residuals of pixels.
    """

    gains_i: NDArray[np.float64]
    spread: float


def estimate_gains(samples_cip: NDArray[np.float32], lights: NDArray[np.floating], most: float = np.inf) -> LightGains:
    """Return the intensities of lights by which pixels are matte best.

    Parameters
    ----------
    samples_cip : ndarray, shape (channel, n_light, P), float32
        Linear radiance of some pixels; of near lights times the squared distance.
    lights : ndarray, shape (n_light, 3) or (n_light, P, 3)
        Unit vectors to the lights.
    most : float
        Samples from here on are clipped.

    Raises
    ------
    InputError
        If there are fewer than five lights, no pixels to tell from, or gains are not those of lamps.
    """
    grey_ip = samples_cip.mean(axis=0, dtype=np.float64)
    count_light = len(grey_ip)
    if count_light < LEAST_LIGHTS:
        raise InputError(f"gains need at least {LEAST_LIGHTS} lights, got {count_light}")
    usable_p = np.quantile(grey_ip, 0.7, axis=0) > _TINY
    grey_ip, clipped_ip = grey_ip[:, usable_p], np.any(samples_cip >= most, axis=0)[:, usable_p]
    if grey_ip.shape[1] < 3 * count_light:
        raise InputError(f"gains need at least {3 * count_light} pixels that are not black, got {grey_ip.shape[1]}")
    each_ip3 = np.broadcast_to(lights[:, None], (*grey_ip.shape, 3)) if lights.ndim == 2 else lights[:, usable_p]
    lights_ip3: NDArray[np.float64] = np.array(each_ip3, np.float64)
    grey_ip = grey_ip / np.quantile(grey_ip, 0.7, axis=0)
    weight_ip = ((grey_ip > SHADOW) & ~clipped_ip).astype(np.float64)
    inverse_i = np.ones(count_light)
    for scale in _SCALES:
        scaled_p3, sound_p = _normals(grey_ip * inverse_i[:, None], lights_ip3, weight_ip)
        model_ip = np.einsum("ipa,pa->ip", lights_ip3, scaled_p3)
        length_p = np.maximum(np.linalg.norm(scaled_p3, axis=1), _TINY)
        off_ip = (grey_ip * inverse_i[:, None] - model_ip) / length_p
        lit_ip = (model_ip > DARK * length_p) & (grey_ip * inverse_i[:, None] > SHADOW * length_p) & ~clipped_ip
        weight_ip = lit_ip * sound_p / (1.0 + (off_ip / scale) ** 2) / length_p**2
        inverse_i = _eigenvector(grey_ip, lights_ip3, weight_ip)
    gains_i = 1.0 / inverse_i
    gains_i /= gains_i.mean()
    if not gains_i.max() <= _GREATER * gains_i.min():
        raise InputError(
            f"the gains of lights {int(gains_i.argmin())} and {int(gains_i.argmax())} would be {gains_i.min():.3g} and "
            f"{gains_i.max():.3g}: these photographs do not tell gains; give them in a file"
        )
    share_ip = np.where(lit_ip, off_ip / np.maximum(model_ip / length_p, DARK), np.nan)
    spread_i = 1.2 * np.nanmedian(np.abs(share_ip), axis=1) / np.sqrt(np.maximum(lit_ip.sum(axis=1), 1))
    return LightGains(gains_i, float(np.nanmax(spread_i)))


def _normals(
    grey_ip: NDArray[np.float64], lights_ip3: NDArray[np.float64], weight_ip: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return weighted least squares of each pixel, (P, 3), and where they are determined."""
    energy_p33 = np.einsum("ipa,ipb,ip->pab", lights_ip3, lights_ip3, weight_ip, optimize=True)
    trace_p = np.maximum(np.trace(energy_p33, axis1=1, axis2=2), _TINY)
    energy_p33 /= trace_p[:, None, None]
    sound_p = np.linalg.det(energy_p33) > 1e-5
    energy_p33 = np.where(sound_p[:, None, None], energy_p33, np.eye(3))
    right_p3 = np.einsum("ipa,ip->pa", lights_ip3, weight_ip * grey_ip, optimize=True) / trace_p[:, None]
    return np.linalg.solve(energy_p33, right_p3[..., None])[..., 0], sound_p


def _eigenvector(
    grey_ip: NDArray[np.float64], lights_ip3: NDArray[np.float64], weight_ip: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the inverse gains of mean 1 for which what no normal explains is least."""
    energy_p33 = np.einsum("ipa,ipb,ip->pab", lights_ip3, lights_ip3, weight_ip, optimize=True)
    trace_p = np.trace(energy_p33, axis1=1, axis2=2)
    used_p = (trace_p > _TINY) & (np.linalg.det(energy_p33 / np.maximum(trace_p, _TINY)[:, None, None]) > 1e-5)
    if not used_p.any():
        raise InputError("no pixel has enough lights that are neither shadow nor clipped: gains cannot be told")
    seen_ip3 = lights_ip3[:, used_p] * (weight_ip * grey_ip)[:, used_p, None]
    inverse_p33 = np.linalg.inv(energy_p33[used_p])
    # sum_p diag(b) (W - W L (L^T W L)^-1 L^T W) diag(b), over sum_p diag(b) W diag(b): a gain of 0 is no solution.
    own_i = np.sum(weight_ip[:, used_p] * grey_ip[:, used_p] ** 2, axis=1)
    half_ip3 = np.einsum("ipa,pab->ipb", seen_ip3, np.linalg.cholesky(inverse_p33), optimize=True)
    flat = half_ip3.reshape(len(grey_ip), -1)
    if not (own_i > 0.0).all():
        raise InputError(f"light {int(own_i.argmin())} lights no pixel that could tell its gain")
    root_i = 1.0 / np.sqrt(own_i)
    left_ii = np.eye(len(grey_ip)) - root_i[:, None] * (flat @ flat.T) * root_i
    vector_i = np.linalg.eigh(left_ii)[1][:, 0] * root_i
    vector_i = vector_i * np.sign(vector_i.sum())
    return np.maximum(vector_i, 1e-3 * np.abs(vector_i).max()) / np.abs(vector_i).mean()
