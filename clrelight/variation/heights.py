"""Height from normals: the surface whose slopes are nearest to theirs in least squares.

The normal equations are Poisson's with natural boundaries; on a whole rectangle cosines diagonalise them (Simchony,
Chellappa and Shao 1990). With a mask they are solved by conjugate gradients, the rectangle's solution preconditioning.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from clrelight.errors import InputError

_LEAST_Z = 0.05
"""Cosine to the camera below which a normal counts as steep as this: its slope has no end."""
_STEPS, _TOLERANCE = 200, 1e-6


def integrate_normals(
    normals_hw3: NDArray[np.float32], mask_hw: NDArray[np.bool_] | None = None
) -> NDArray[np.float32]:
    """Return heights towards the camera in pixels, (height, width), of mean 0 inside and 0 outside.

    Parameters
    ----------
    normals_hw3 : ndarray, shape (height, width, 3), float32
        Unit vectors, x right, y up, z towards the camera; 0 where there is none.
    mask_hw : ndarray, shape (height, width), bool, optional
        True where pixels count.

    Raises
    ------
    InputError
        If there is no pixel with a normal.
    """
    inside_hw = np.any(normals_hw3 != 0.0, axis=2)
    if mask_hw is not None:
        inside_hw &= mask_hw
    if not inside_hw.any():
        raise InputError("no pixel has a normal: there is no height to find")
    z_hw = np.maximum(normals_hw3[..., 2], _LEAST_Z).astype(np.float64)
    right_hw, down_hw = -normals_hw3[..., 0] / z_hw, normals_hw3[..., 1] / z_hw
    # Slopes between neighbours, where both are inside.
    along = inside_hw[:, 1:] & inside_hw[:, :-1], inside_hw[1:] & inside_hw[:-1]
    right_e = np.where(along[0], 0.5 * (right_hw[:, 1:] + right_hw[:, :-1]), 0.0)
    down_e = np.where(along[1], 0.5 * (down_hw[1:] + down_hw[:-1]), 0.0)
    wanted_hw = _divergence(right_e, down_e)
    spectrum_hw = _spectrum(inside_hw.shape)
    height_hw = _rectangle(wanted_hw, spectrum_hw)
    if not inside_hw.all():
        height_hw = _conjugate_gradients(wanted_hw, along, spectrum_hw, height_hw)
    height_hw -= height_hw[inside_hw].mean()
    return np.where(inside_hw, height_hw, 0.0).astype(np.float32)


def _divergence(right_e: NDArray[np.float64], down_e: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transpose of the differences between neighbours."""
    total_hw = np.zeros((right_e.shape[0], down_e.shape[1]))
    total_hw[:, 1:] += right_e
    total_hw[:, :-1] -= right_e
    total_hw[1:] += down_e
    total_hw[:-1] -= down_e
    return total_hw


def _spectrum(shape: tuple[int, ...]) -> NDArray[np.float64]:
    rows_h, columns_w = (2.0 - 2.0 * np.cos(np.pi * np.arange(size) / size) for size in shape)
    spectrum_hw = rows_h[:, None] + columns_w
    spectrum_hw[0, 0] = 1.0  # the mean, which slopes do not tell
    return spectrum_hw


def _rectangle(wanted_hw: NDArray[np.float64], spectrum_hw: NDArray[np.float64]) -> NDArray[np.float64]:
    found_hw = dctn(wanted_hw, type=2, norm="ortho") / spectrum_hw
    found_hw[0, 0] = 0.0
    return idctn(found_hw, type=2, norm="ortho")


def _conjugate_gradients(
    wanted_hw: NDArray[np.float64],
    along: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    spectrum_hw: NDArray[np.float64],
    height_hw: NDArray[np.float64],
) -> NDArray[np.float64]:
    def apply(values_hw: NDArray[np.float64]) -> NDArray[np.float64]:
        return _divergence(along[0] * np.diff(values_hw, axis=1), along[1] * np.diff(values_hw, axis=0))

    left_hw = wanted_hw - apply(height_hw)
    end = _TOLERANCE * max(float(np.linalg.norm(wanted_hw)), 1e-300)
    step_hw = near_hw = _rectangle(left_hw, spectrum_hw)
    energy = float(np.vdot(left_hw, near_hw))
    for _ in range(_STEPS):
        if np.linalg.norm(left_hw) <= end:
            break
        moved_hw = apply(step_hw)
        length = energy / max(float(np.vdot(step_hw, moved_hw)), 1e-300)
        height_hw = height_hw + length * step_hw
        left_hw = left_hw - length * moved_hw
        near_hw = _rectangle(left_hw, spectrum_hw)
        before, energy = energy, float(np.vdot(left_hw, near_hw))
        step_hw = near_hw + (energy / max(before, 1e-300)) * step_hw
    return height_hw
