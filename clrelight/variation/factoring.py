"""Lamps and surface at once, where neither is known: photographs of a matte surface as a product of two.

Illumination variation, 0.4.2: ``M = L S`` of rank 3 without shadows (Hayakawa 1994) is unique but for a 3 x 3 matrix.
That the normals are those of a surface leaves the bas-relief family of three numbers (Belhumeur, Kriegman and Yuille
1999; Yuille and Snow 1997), lamps of one intensity leave a sign, and the outline of a body tells it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

from clrelight.errors import InputError
from clrelight.variation.shading import DARK, GLOSS

LEAST_LIGHTS = 6
"""The six products that make lamps of one intensity need so many."""
_ROUNDS, _SCALE = 25, 0.05
_LEAST_PIXELS = 50
_RELIEFS = (0.3, 0.6, 1.0, 1.7, 3.0)
"""Depths from which the bas-relief is looked for, beside that of singular vectors of equal size."""
_FLOOR = 1e-12


@dataclass(frozen=True)
class Factored:
    """Lamps and normals of photographs.

    Attributes
    ----------
    lights_i3 : ndarray, shape (n_light, 3), float64
        Vectors towards the lamps, as long as these are bright: in the mean 1.
    residual_i : ndarray, shape (n_light,), float64
        Root mean square of what samples are off the product of rank 3, as a share of theirs.
    uneven : float
        Standard deviation of the lamps' intensities beside their mean, which equal ones would bring to 0.
    """

    lights_i3: NDArray[np.float64]
    residual_i: NDArray[np.float64]
    uneven: float


def lights_from_surface(samples_ihw: NDArray[np.floating], mask_hw: NDArray[np.bool_]) -> Factored:
    """Return the lamps of photographs of a matte body that bulges towards the camera, of equal intensity.

    Parameters
    ----------
    samples_ihw : ndarray, shape (n_light, height, width)
        Linear grey.
    mask_hw : ndarray, shape (height, width), bool
        Where the body is.

    Raises
    ------
    InputError
        If there are fewer than six photographs, or hardly a pixel is lit.
    """
    if len(samples_ihw) < LEAST_LIGHTS:
        raise InputError(f"lamps and surface at once need at least {LEAST_LIGHTS} photographs, got {len(samples_ihw)}")
    samples_ip = np.asarray(samples_ihw[:, mask_hw], np.float64)
    if np.count_nonzero(samples_ip.max(axis=0) > 0.0) < _LEAST_PIXELS:
        raise InputError(f"fewer than {_LEAST_PIXELS} pixels of the photographs are lit")
    left_i3, right_3p, residual_i = _factor(samples_ip)
    to_surface = _integrable(right_3p, mask_hw)
    surface_3p, lights_i3 = to_surface @ right_3p, left_i3 @ np.linalg.inv(to_surface)
    lights_i3, relief = _even_out(lights_i3)
    surface_3p = np.linalg.inv(relief) @ surface_3p
    lights_i3, _ = _bulging(lights_i3, surface_3p, mask_hw)
    length_i = np.linalg.norm(lights_i3, axis=1)
    return Factored(lights_i3 / length_i.mean(), residual_i, float(length_i.std() / length_i.mean()))


def _factor(
    samples_ip: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return L (n_light, 3), S (3, P) and residuals: rank 3 by weighted least squares, side by side in turn.

    Shadows and what may be gloss have weight 0; others less the further they are off.
    """
    bright_p = np.quantile(samples_ip, GLOSS, axis=0)
    counted_ip = (samples_ip > DARK * bright_p) & (samples_ip <= bright_p) & (bright_p > 0.0)
    left_ir, size_r, right_rp = np.linalg.svd(samples_ip, full_matrices=False)
    root_r = np.sqrt(size_r[:3])
    left_i3 = np.asarray(left_ir[:, :3] * root_r, np.float64)
    right_3p = np.asarray(root_r[:, None] * right_rp[:3], np.float64)
    weight_ip = counted_ip.astype(np.float64)
    for _ in range(_ROUNDS):
        right_3p = _solve(left_i3, samples_ip, weight_ip)
        left_i3 = _solve(right_3p.T, samples_ip.T, weight_ip.T).T
        away_ip = (samples_ip - left_i3 @ right_3p) / (_SCALE * np.maximum(bright_p, _FLOOR))
        weight_ip = counted_ip / (1.0 + away_ip**2) / (1.0 + np.maximum(away_ip, 0.0) ** 2)
    used_ip = weight_ip > 0.1
    energy_i = np.sum(np.where(used_ip, samples_ip**2, 0.0), axis=1)
    off_ip = np.where(used_ip, samples_ip - left_i3 @ right_3p, 0.0)
    share_i = np.sum(off_ip**2, axis=1) / np.maximum(energy_i, _FLOOR)
    return left_i3, right_3p, np.asarray(np.sqrt(share_i), np.float64)


def _solve(
    left_i3: NDArray[np.float64], samples_ip: NDArray[np.float64], weight_ip: NDArray[np.float64]
) -> NDArray[np.float64]:
    products_i9 = (left_i3[:, :, None] * left_i3[:, None, :]).reshape(-1, 9)
    matrix_p33 = (weight_ip.T @ products_i9).reshape(-1, 3, 3)
    size_p = np.trace(matrix_p33, axis1=1, axis2=2)
    matrix_p33 += (1e-6 * size_p + _FLOOR)[:, None, None] * np.eye(3)
    right_p3 = (weight_ip * samples_ip).T @ left_i3
    found_p3 = np.asarray(np.linalg.solve(matrix_p33, right_p3[:, :, None])[:, :, 0], np.float64)
    return found_p3.T


def _integrable(right_3p: NDArray[np.float64], mask_hw: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the matrix, but for a bas-relief, that makes scaled normals m of the factor: ``m = A b``.

    Slopes -m1 / m3 and -m2 / m3 are those of one height: ``d(m1 / m3) / dy = d(m2 / m3) / dx``, which is linear in the
    cross products of A's rows, ``(b x db/dy) . (a3 x a1) = (b x db/dx) . (a3 x a2)``.
    """
    field_3hw = np.zeros((3, *mask_hw.shape))
    field_3hw[:, mask_hw] = right_3p
    inner_hw = np.zeros_like(mask_hw)
    inner_hw[1:-1, 1:-1] = (
        mask_hw[1:-1, 1:-1] & mask_hw[:-2, 1:-1] & mask_hw[2:, 1:-1] & mask_hw[1:-1, :-2] & mask_hw[1:-1, 2:]
    )
    y, x = np.nonzero(inner_hw)
    if len(y) < _LEAST_PIXELS:
        raise InputError(f"fewer than {_LEAST_PIXELS} pixels have neighbours on all sides: nothing tells the surface")
    b_n3 = field_3hw[:, y, x].T
    up_n3 = 0.5 * (field_3hw[:, y - 1, x] - field_3hw[:, y + 1, x]).T
    right_n3 = 0.5 * (field_3hw[:, y, x + 1] - field_3hw[:, y, x - 1]).T
    rows_n6 = np.concatenate([np.cross(b_n3, up_n3), -np.cross(b_n3, right_n3)], axis=1)
    rows_n6 /= np.maximum(np.sum(b_n3**2, axis=1, keepdims=True), _FLOOR)
    weight_n = np.ones(len(rows_n6))
    for _ in range(15):  # steps of the surface are no slopes
        null_6 = np.linalg.eigh((rows_n6 * weight_n[:, None]).T @ rows_n6)[1][:, 0]
        off_n = np.abs(rows_n6 @ null_6)
        weight_n = 1.0 / (1.0 + (off_n / max(2.0 * float(np.median(off_n)), _FLOOR)) ** 2)
    first_3, second_3 = null_6[:3], null_6[3:]
    third_3 = np.cross(first_3, second_3)
    size = float(third_3 @ third_3)
    if not size > _FLOOR:
        raise InputError("the photographs do not tell a surface: it looks flat")
    # a3 x a1 = p and a3 x a2 = q are met by a1 = p x a3 / |a3|^2, and so on, with any share of a3 on top.
    return np.stack([np.cross(first_3, third_3) / size, np.cross(second_3, third_3) / size, third_3])


def _even_out(lights_i3: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lamps as even as a bas-relief makes them, and the matrix that did: ``lights = before @ matrix``.

    Scaled normals go through the matrix's inverse: rows 1, 2 of it are those of the identity with a share of row 3.
    """
    scale = np.sqrt(np.mean(lights_i3**2, axis=0)) + _FLOOR
    plain_i3 = lights_i3 / np.mean(np.linalg.norm(lights_i3, axis=1))

    def relief(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        # Of normals: m1 + mu m3, m2 + nu m3, lambda m3, all times a common factor. Lamps go with its inverse.
        mu, nu, log_depth, log_size = parameters
        normals = np.array([[1.0, 0.0, mu], [0.0, 1.0, nu], [0.0, 0.0, np.exp(log_depth)]])
        return np.linalg.inv(normals) * np.exp(log_size)

    def off(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.linalg.norm(plain_i3 @ relief(parameters), axis=1) - 1.0

    best = None
    for depth in (*_RELIEFS, float(2.0 * scale[2] / (scale[0] + scale[1]))):
        found = optimize.least_squares(off, np.array([0.0, 0.0, np.log(depth), 0.0]), loss="soft_l1", f_scale=0.1)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    matrix = relief(best.x)
    return plain_i3 @ matrix, matrix


def _bulging(
    lights_i3: NDArray[np.float64], surface_3p: NDArray[np.float64], mask_hw: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lamps and normals with the signs of a body that bulges: it faces the camera, left parts to the left."""
    if np.sum(surface_3p[2]) < 0.0:
        lights_i3, surface_3p = -lights_i3, -surface_3p
    unit_3p = surface_3p / np.maximum(np.linalg.norm(surface_3p, axis=0), _FLOOR)
    # At its outline a body turns away from the camera, outwards; where there is none, it bulges about its middle.
    soft_hw = ndimage.gaussian_filter(mask_hw.astype(np.float64), 0.02 * np.sqrt(mask_hw.sum()) + 1.0, mode="nearest")
    down_hw, right_hw = np.gradient(soft_hw)
    outwards_p = -unit_3p[0] * right_hw[mask_hw] + unit_3p[1] * down_hw[mask_hw]
    if not np.any(np.abs(right_hw[mask_hw]) + np.abs(down_hw[mask_hw]) > 1e-3):
        y_p, x_p = np.nonzero(mask_hw)
        outwards_p = unit_3p[0] * (x_p - x_p.mean()) - unit_3p[1] * (y_p - y_p.mean())
    if outwards_p.sum() < 0.0:
        turn = np.array([-1.0, -1.0, 1.0])
        lights_i3, surface_3p = lights_i3 * turn, surface_3p * turn[:, None]
    return lights_i3, surface_3p
