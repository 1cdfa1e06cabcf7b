"""Lamps from the shading of a matte surface whose normals are known: photometric stereo the other way round.

illumination-variation, eq. 1-2: a lit pixel shows ``rho n . l``, with the lamp's intensity as the length of l. Known
normals tell l by least squares, three of them are enough; pixels in shadow and gloss are left out as in `normals`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

MOST_CONDITION = 100.0
"""Of the normals: beyond, they lie so nearly in one plane that they do not tell lights."""
DARK, GLOSS = 0.1, 0.7
"""Share of a pixel's brightest samples below which it is in shadow; share of its samples, from the darkest, that count,
as in `normals`: the others may be gloss."""
_ROUNDS, _LEAST_PIXELS = 80, 6
_SCALE = 0.05
"""Residual, as a share of the lamp's brightest, at which a sample's weight has halved."""
_FLOOR = 1e-12
_STANDING_OUT = 2.0
"""How far the second and third of what photographs have in common are above the fourth: 1 to 1.7 of noise, 2.8 and more
of photographed objects."""


@dataclass(frozen=True)
class ShadingLights:
    """Lamps of photographs.

    Attributes
    ----------
    lights_i3 : ndarray, shape (n_light, 3), float64
        Vectors towards the lamps, as long as these are bright: in the mean 1. 0 where too few pixels are lit.
    residual_i : ndarray, shape (n_light,), float64
        Root mean square of what the lit pixels are off the law, as a share of theirs.
    lit_i : ndarray, shape (n_light,), float64
        Share of pixels that were lit.
    albedo_p : ndarray, shape (P,), float64
    """

    lights_i3: NDArray[np.float64]
    residual_i: NDArray[np.float64]
    lit_i: NDArray[np.float64]
    albedo_p: NDArray[np.float64]


def lights_from_normals(
    samples_ip: NDArray[np.floating],
    normals_p3: NDArray[np.floating],
    albedo_p: NDArray[np.floating] | None = None,
) -> ShadingLights:
    """Return the lamp of each photograph of a matte surface.

    Parameters
    ----------
    samples_ip : ndarray, shape (n_light, P)
        Linear grey.
    normals_p3 : ndarray, shape (P, 3)
        Unit normals.
    albedo_p : ndarray, shape (P,), optional
        Default: found along with the lights, turn by turn, which needs more than one photograph of varied normals.

    Raises
    ------
    InputError
        If the normals lie nearly in a plane, or nothing is lit.
    """
    seen_ip: NDArray[np.float64] = np.asarray(samples_ip, np.float64)
    normals_p3 = np.asarray(normals_p3, np.float64)
    singular_r = np.linalg.svd(normals_p3, compute_uv=False)
    condition = singular_r[0] / singular_r[-1] if len(normals_p3) > 2 and singular_r[-1] > _FLOOR else np.inf
    if not condition <= MOST_CONDITION:
        raise InputError(
            f"the normals do not tell where light comes from: their condition is {condition:.3g}, "
            f"at most {MOST_CONDITION:g}"
        )
    bright_p = np.quantile(seen_ip, GLOSS, axis=0)
    if not np.any(bright_p > 0.0):
        raise InputError("nothing is lit in the photographs")
    is_known = albedo_p is not None
    found_p = bright_p if albedo_p is None else np.asarray(albedo_p, np.float64)
    lit_ip = (seen_ip > DARK * bright_p) & (seen_ip <= bright_p) & (bright_p > 0.0)
    weight_ip = lit_ip.astype(np.float64)
    lights_i3 = np.zeros((len(seen_ip), 3))
    for _ in range(_ROUNDS):
        scaled_p3 = found_p[:, None] * normals_p3
        before_i3, lights_i3 = lights_i3, _solve(seen_ip, scaled_p3, weight_ip)
        shade_ip = lights_i3 @ normals_p3.T
        away_ip = seen_ip - found_p * shade_ip
        top_i1 = np.linalg.norm(lights_i3, axis=1)[:, None] * np.maximum(found_p, _FLOOR) + _FLOOR
        scaled_ip = away_ip / (_SCALE * top_i1)
        # Gloss only ever adds: what lies above counts less than what lies below.
        weight_ip = 1.0 / (1.0 + scaled_ip**2) / (1.0 + np.maximum(scaled_ip, 0.0) ** 2)
        weight_ip *= lit_ip & (shade_ip > DARK * np.linalg.norm(lights_i3, axis=1)[:, None])
        if not is_known:
            shaded_ip = weight_ip * shade_ip
            seen_p = np.sum(shaded_ip * shade_ip, axis=0)
            found_p = np.where(seen_p > _FLOOR, np.sum(shaded_ip * seen_ip, axis=0) / np.maximum(seen_p, _FLOOR), 0)
            found_p = np.maximum(found_p, 0.0)
            length = np.linalg.norm(lights_i3, axis=1)
            mean = float(length[length > 0.0].mean()) if np.any(length > 0.0) else 1.0
            found_p, lights_i3 = found_p * mean, lights_i3 / mean
        if np.abs(lights_i3 - before_i3).max() < 1e-6 * np.abs(lights_i3).max():
            break
    scaled_p3 = found_p[:, None] * normals_p3
    lights_i3 = _solve(seen_ip, scaled_p3, weight_ip)
    away_ip = seen_ip - lights_i3 @ scaled_p3.T
    used_ip = weight_ip > 0.1
    energy_i = np.sum(np.where(used_ip, seen_ip**2, 0.0), axis=1)
    residual_i = np.sqrt(np.sum(np.where(used_ip, away_ip**2, 0.0), axis=1) / np.maximum(energy_i, _FLOOR))
    return ShadingLights(lights_i3, residual_i, used_ip.mean(axis=1), found_p)


def are_sums_of_three(samples_ip: NDArray[np.floating]) -> bool | None:
    """Return whether photographs are nearly sums of three pictures, as those of a matte object under lamps are.

    Of their products with each other the second and third eigenvalue stand out of the others; those of noise are alike.
    None of fewer than four photographs, which always are such sums.

    Parameters
    ----------
    samples_ip : ndarray, shape (n_light, P)
        Linear grey.
    """
    if len(samples_ip) < 4:
        return None
    seen_ip = np.asarray(samples_ip, np.float64)
    energy_k = np.linalg.eigvalsh(seen_ip @ seen_ip.T)[::-1]
    rounding = 1e-12 * float(energy_k[0])
    return bool(0.5 * (energy_k[1] + energy_k[2]) > _STANDING_OUT * max(float(energy_k[3]), rounding))


def shade_explains(
    samples_ip: NDArray[np.floating],
    normals_p3: NDArray[np.floating],
    lights_i3: NDArray[np.float64],
    albedo_p: NDArray[np.floating],
) -> bool:
    """Return whether lamps explain most photographs better than the albedo alone does, each times its best factor.

    Parameters
    ----------
    samples_ip : ndarray, shape (n_light, P)
    normals_p3 : ndarray, shape (P, 3)
    lights_i3 : ndarray, shape (n_light, 3)
    albedo_p : ndarray, shape (P,)
        Known, not found along with the lights.
    """
    seen_ip, flat_ip = np.asarray(samples_ip, np.float64), np.asarray(albedo_p, np.float64)[None]
    shaded_ip = flat_ip * np.maximum(lights_i3 @ np.asarray(normals_p3, np.float64).T, 0.0)
    left = []
    for model_ip in (shaded_ip, flat_ip):
        factor_i = np.sum(seen_ip * model_ip, axis=1) / np.maximum(np.sum(model_ip**2, axis=1), _FLOOR)
        left.append(np.sum((seen_ip - factor_i[:, None] * model_ip) ** 2, axis=1))
    return bool(np.median(left[0] / np.maximum(left[1], 1e-30)) < 1.0)


def _solve(
    samples_ip: NDArray[np.float64], scaled_p3: NDArray[np.float64], weight_ip: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return weighted least squares of each photograph; 0 where fewer than six pixels count."""
    products_p9 = (scaled_p3[:, :, None] * scaled_p3[:, None, :]).reshape(-1, 9)
    normal_i33 = (weight_ip @ products_p9).reshape(-1, 3, 3)
    right_i3 = (weight_ip * samples_ip) @ scaled_p3
    lights_i3 = np.zeros_like(right_i3)
    for i, (matrix, right) in enumerate(zip(normal_i33, right_i3, strict=True)):
        if np.count_nonzero(weight_ip[i]) >= _LEAST_PIXELS and np.linalg.cond(matrix) < MOST_CONDITION**2:
            lights_i3[i] = np.linalg.solve(matrix, right)
    return lights_i3
