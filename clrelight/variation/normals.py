"""Normals and albedo from samples under known distant lights: calibrated photometric stereo, pixel by pixel.

illumination-variation, eq. 1-2: where nothing shines and nothing is in shadow, a sample is ``rho l . n``, so that the
scaled normal ``rho n`` is the least-squares solution of ``L (rho n) = b`` (Woodham 1980). What breaks that law is kept
out in the quick method: lights behind the surface and in its shadow, clipped samples, and gloss, which only ever adds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

METHODS = ("auto", "robust", "quick", "least-squares")
"""Of stacks: `clrelight.variation.maps.map_normals` says what each is."""
MOST_CONDITION = 100.0
"""Of the lights' directions: beyond, the samples' noise alone turns normals by more than they tell."""
LEAST_LIGHTS = 3

DARK = 0.1
"""Cosine of the angle to the light below which a sample is left out: little light, and most shadows of neighbours."""
SHADOW = 0.1
"""Share of the albedo below which a sample is in shadow."""
_BRIGHTEST = 0.3
"""Share of the samples, the brightest of each pixel, that may be gloss."""
SCALES = (0.3, 0.15, 0.08, 0.05, 0.03, 0.03)
"""Residual, as a share of the albedo, at which a weight has halved, step by step: wide first, for a poor start."""
LOST = 0.5
"""Residual, as a share of the albedo, beyond which it no longer matters to the confidence how large it is."""
_LEAST_KEPT = 6
"""Samples that a pixel keeps of its brightest, whatever their share."""
_BEHIND, _LEAST_SHADOWED, _MOST_FLOOR = -0.1, 50, 0.3
"""Cosine of a light that is behind a surface for sure; pixels that tell what shadows hold; the most that they may."""
LEAST_DETERMINANT = 1e-6
"""Of a pixel's equations of trace 1: below, its samples left do not tell a normal."""
_FLOOR = 1e-12


@dataclass(frozen=True)
class PixelNormals:
    """What was found at some pixels.

    Attributes
    ----------
    normals_p3 : ndarray, shape (P, 3), float32
        Unit vectors, x right, y up, z towards the camera; 0 where a pixel is black or has too few samples.
    albedo_pc : ndarray, shape (P, channel), float32
        Radiance under a light along the normal, in units of the peak.
    confidence_p : ndarray, shape (P,), float32
        From 0 to 1: 1 where all samples follow the law, shadows behind the surface among them; 0 where all are off by
        half the albedo or more.
    """

    normals_p3: NDArray[np.float32]
    albedo_pc: NDArray[np.float32]
    confidence_p: NDArray[np.float32]


def light_condition(directions_i3: NDArray[np.float64]) -> float:
    """Return the condition number of the lights' directions; inf where they lie in a plane with the surface.

    Raises
    ------
    InputError
        If there are fewer than three, or the number is above `MOST_CONDITION`.
    """
    if len(directions_i3) < LEAST_LIGHTS:
        raise InputError(f"normals need at least {LEAST_LIGHTS} lights, got {len(directions_i3)}")
    singular_r = np.linalg.svd(directions_i3, compute_uv=False)
    condition = float(singular_r[0] / singular_r[-1]) if singular_r[-1] > _FLOOR else float("inf")
    if not condition <= MOST_CONDITION:
        raise InputError(
            f"the lights lie nearly in one plane: the condition of their directions is {condition:.3g}, "
            f"normals need at most {MOST_CONDITION:g}"
        )
    return condition


def find_normals(
    samples_cip: NDArray[np.float32],
    directions_i3: NDArray[np.float64],
    method: str = "quick",
    clipped_ip: NDArray[np.bool_] | None = None,
    floor: float = 0.0,
) -> PixelNormals:
    """Return normals and albedo of pixels from their linear samples.

    Parameters
    ----------
    samples_cip : ndarray, shape (channel, n_light, P), float32
        Linear radiance in units of the peak. All channels share a pixel's normal: it is found from their mean.
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors to the lights, of equal intensity; `light_condition` accepts them.
    method : str
        ``"quick"`` or ``"least-squares"``.
    clipped_ip : ndarray, shape (n_light, P), bool, optional
        Samples at the end of their range, which are left out (quick).
    floor : float
        What shadows hold of light from elsewhere, as a share of the albedo: see `shadow_floor` (quick).
    """
    lights_i3 = directions_i3.astype(np.float32)
    grey_ip = samples_cip[0] if len(samples_cip) == 1 else samples_cip.mean(axis=0, dtype=np.float32)
    offset_p = np.zeros(grey_ip.shape[1], np.float32)
    if method == "least-squares":
        weight_ip = np.ones_like(grey_ip)
        scaled_p3 = grey_ip.T @ np.linalg.pinv(directions_i3).astype(np.float32).T
    else:
        scaled_p3, weight_ip, offset_p = _solve_robust(grey_ip, lights_i3, clipped_ip, floor)
    length_p = _lengths(scaled_p3.T)
    is_found_p = length_p > _FLOOR
    normals_p3 = np.where(is_found_p[:, None], scaled_p3 / np.maximum(length_p, _FLOOR)[:, None], np.float32(0.0))
    shade_ip = np.maximum(lights_i3 @ normals_p3.T, np.float32(0.0))
    residual_ip = np.abs(grey_ip - offset_p - shade_ip * length_p)
    residual_ip /= np.maximum(length_p, np.float32(_FLOOR))
    confidence_p = np.float32(1.0) - np.minimum(residual_ip, np.float32(LOST)).mean(axis=0) / np.float32(LOST)
    weight_ip *= shade_ip
    whole_p = np.multiply(weight_ip, shade_ip, out=shade_ip).sum(axis=0)
    above_p = offset_p * weight_ip.sum(axis=0)
    albedo_cp = np.stack([(weight_ip * each_ip).sum(axis=0) - above_p for each_ip in samples_cip])
    albedo_cp /= np.maximum(whole_p, np.float32(_FLOOR))
    np.maximum(albedo_cp, np.float32(0.0), out=albedo_cp)
    return PixelNormals(
        normals_p3, np.ascontiguousarray(albedo_cp.T), np.where(is_found_p, confidence_p, np.float32(0.0))
    )


def shadow_floor(samples_cip: NDArray[np.float32], directions_i3: NDArray[np.float64]) -> float:
    """Return what shadows hold, as a share of the albedo: the median over pixels that some light is behind.

    Light that other parts or the room send on is there whatever the lamp does, as in `Koenderink and van Doorn`'s
    fourth term; only a shadow shows how much. 0 where fewer than `_LEAST_SHADOWED` pixels have one.

    Parameters
    ----------
    samples_cip : ndarray, shape (channel, n_light, P), float32
        Some pixels of a stack.
    directions_i3 : ndarray, shape (n_light, 3), float64
    """
    found = find_normals(samples_cip, directions_i3)
    behind_ip = directions_i3.astype(np.float32) @ found.normals_p3.T < _BEHIND
    shadowed_p = behind_ip.any(axis=0) & (found.albedo_pc.mean(axis=1) > _FLOOR)
    if np.count_nonzero(shadowed_p) < _LEAST_SHADOWED:
        return 0.0
    behind_ip, grey_ip = behind_ip[:, shadowed_p], samples_cip.mean(axis=0)[:, shadowed_p]
    floor_p = np.where(behind_ip, grey_ip, np.float32(np.inf)).min(axis=0) / found.albedo_pc[shadowed_p].mean(axis=1)
    return min(float(np.median(floor_p)), _MOST_FLOOR)


def _solve_robust(
    grey_ip: NDArray[np.float32],
    lights_i3: NDArray[np.float32],
    clipped_ip: NDArray[np.bool_] | None,
    floor: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return scaled normals (P, 3), the samples' last weights and what shadows hold (P,).

    Iteratively reweighted least squares. A weight is Cauchy's, and his squared above the law, where gloss lies.
    """
    bright_p, dim_p, least_p = _limits(grey_ip)
    usable_ip = grey_ip <= bright_p
    if clipped_ip is not None:
        usable_ip &= ~clipped_ip
    products_i6 = _products(lights_i3)
    weight_ip = (usable_ip & (grey_ip >= dim_p)).astype(np.float32)
    plain_3p = np.linalg.pinv(lights_i3.astype(np.float64)).astype(np.float32) @ grey_ip
    scaled_3p = _solve(weight_ip, weight_ip * grey_ip, lights_i3, products_i6, plain_3p)
    offset_p = np.minimum(least_p, np.float32(floor) * _lengths(scaled_3p))
    lit_ip = np.where(usable_ip, grey_ip - offset_p, np.float32(-1.0))
    shade_ip, above_ip, kept_ip, bright_ip = (np.empty_like(each) for each in (lit_ip, lit_ip, usable_ip, usable_ip))
    product_ip = np.empty_like(lit_ip)
    for scale in SCALES:
        length_p = _lengths(scaled_3p)
        np.matmul(lights_i3, scaled_3p, out=shade_ip)
        np.greater(shade_ip, np.float32(DARK) * length_p, out=kept_ip)
        np.greater(lit_ip, np.float32(SHADOW) * length_p, out=bright_ip)
        np.logical_and(kept_ip, bright_ip, out=kept_ip)
        np.subtract(lit_ip, shade_ip, out=shade_ip)
        shade_ip *= np.float32(1.0) / np.maximum(np.float32(scale) * length_p, np.float32(_FLOOR))
        np.maximum(shade_ip, np.float32(0.0), out=above_ip)
        for each_ip in (shade_ip, above_ip):
            np.multiply(each_ip, each_ip, out=each_ip)
            each_ip += np.float32(1.0)
        shade_ip *= above_ip
        np.divide(kept_ip, shade_ip, out=weight_ip, dtype=np.float32)
        np.multiply(weight_ip, lit_ip, out=product_ip)
        scaled_3p = _solve(weight_ip, product_ip, lights_i3, products_i6, scaled_3p)
    return np.ascontiguousarray(scaled_3p.T), weight_ip, offset_p


def _lengths(scaled_3p: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.sqrt(np.einsum("ap,ap->p", scaled_3p, scaled_3p))


def order_limits(n_light: int) -> tuple[int, int]:
    """Return how many samples of a pixel count, from the darkest, and how many of them the start leaves out."""
    kept = min(n_light, max(_LEAST_KEPT, round((1.0 - _BRIGHTEST) * n_light)))
    return kept, n_light // 4 if n_light >= 2 * _LEAST_KEPT else 0


def _limits(grey_ip: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return each pixel's brightest sample that counts, the darkest that the start counts, and the least."""
    kept, dim = order_limits(len(grey_ip))
    sorted_pi = np.sort(np.ascontiguousarray(grey_ip.T), axis=1)  # a third of the time of a partition, or of columns
    return sorted_pi[:, kept - 1].copy(), sorted_pi[:, dim].copy(), sorted_pi[:, 0].copy()


def _products(lights_i3: NDArray[np.float32]) -> NDArray[np.float32]:
    x_i, y_i, z_i = lights_i3.T
    return np.stack([x_i * x_i, x_i * y_i, x_i * z_i, y_i * y_i, y_i * z_i, z_i * z_i], axis=1)


def _solve(
    weight_ip: NDArray[np.float32],
    weighted_ip: NDArray[np.float32],
    lights_i3: NDArray[np.float32],
    products_i6: NDArray[np.float32],
    before_3p: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return weighted least squares of each pixel, (3, P); where too few samples are left, what was there before.

    The symmetric 3 x 3 systems are solved by their adjugates, in float64: sums of products are well within it.
    """
    sums_6p = products_i6.T @ weight_ip
    trace_p = sums_6p[0] + sums_6p[3] + sums_6p[5]
    a_p, b_p, c_p, d_p, e_p, f_p = (sums_6p / np.maximum(trace_p, np.float32(_FLOOR))).astype(np.float64)
    right_3p = (lights_i3.T @ weighted_ip) / np.maximum(trace_p, np.float32(_FLOOR))
    df_p, cb_p, be_p = d_p * f_p - e_p * e_p, c_p * e_p - b_p * f_p, b_p * e_p - c_p * d_p
    af_p, bc_p, ad_p = a_p * f_p - c_p * c_p, b_p * c_p - a_p * e_p, a_p * d_p - b_p * b_p
    determinant_p = a_p * df_p + b_p * cb_p + c_p * be_p
    is_sound_p = determinant_p > LEAST_DETERMINANT
    x_p, y_p, z_p = right_3p / np.where(is_sound_p, determinant_p, 1.0)
    solved_3p = np.stack(
        [
            df_p * x_p + cb_p * y_p + be_p * z_p,
            cb_p * x_p + af_p * y_p + bc_p * z_p,
            be_p * x_p + bc_p * y_p + ad_p * z_p,
        ]
    )
    return np.where(is_sound_p, solved_3p, before_3p).astype(np.float32)
