"""Reflectance transformation imaging as its tools do it (RTIBuilder, relight): few basis functions, 8-bit JPEG planes.

Every pixel's code values are fitted by least squares with a few functions of the light; each plane of coefficients is
scaled to 8 bits over the central 99.5% of its values, and written as JPEG.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.jpeg_planes import compress_planes
from clrelight.dataset import LightStack
from clrelight.errors import InputError

_PCA_SAMPLES = 16384
_TIES = 1e-9
"""Smoothing of what goes through all lights, so that photographs of one and the same light are averaged."""


def ptm_basis(directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1, u, v, u^2, v^2, u v of each light (n_light, 6): polynomial texture maps (Malzbender et al. 2001)."""
    u, v = directions_i3[:, 0], directions_i3[:, 1]
    return np.stack([np.ones_like(u), u, v, u * u, v * v, u * v], axis=1)


def hsh_basis(directions_i3: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return the hemispherical harmonics up to a degree (n_light, (degree + 1)^2) (Gautron et al. 2004, eq. 8-9).

    Legendre functions of ``2 cos(theta) - 1``, orthonormal on the upper hemisphere. Lights below it count as on it.
    """
    from scipy.special import lpmv

    z = 2.0 * np.clip(directions_i3[:, 2], 0.0, 1.0) - 1.0
    azimuth = np.arctan2(directions_i3[:, 1], directions_i3[:, 0])
    columns = []
    for l in range(degree + 1):
        for m in range(-l, l + 1):
            a = abs(m)
            norm = math.sqrt((2 * l + 1) / (2.0 * math.pi) * math.factorial(l - a) / math.factorial(l + a))
            turn = np.sqrt(2.0) * (np.cos(a * azimuth) if m > 0 else np.sin(a * azimuth)) if m else 1.0
            columns.append(norm * lpmv(a, l, z) * turn)
    return np.stack(columns, axis=1)


_FIXED: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "ptm": ptm_basis,
    "hsh4": lambda directions_i3: hsh_basis(directions_i3, 1),
    "hsh9": lambda directions_i3: hsh_basis(directions_i3, 2),
    "hsh16": lambda directions_i3: hsh_basis(directions_i3, 3),
}
_PCA = {"pca9": 9, "pca18": 18, "pca27": 27}
_PHOTOGRAPHS = "rbf"

BASES = (*_FIXED, *_PCA, _PHOTOGRAPHS)
"""Names of the bases; pcaN are N principal components over lights and colours, interpolated between the lights; rbf
keeps all photographs and interpolates them by linear radial basis functions of the direction in space."""


@dataclass(frozen=True)
class RtiFit:
    """Planes fitted to some lights, and how images come from them.

    Attributes
    ----------
    planes : list of ndarray, shape (height, width, 1 or 3), float32
        0 outside the mask.
    relight : callable
        Takes planes and the index of one of the stack's lights, returns the image (height, width, channel) in units of
        the peak, not clipped.
    table_bytes : int
        What is stored beside the planes.
    mask_hw : ndarray, bool
        The pixels that count.
    span : tuple of float, optional
        Range of all planes where it is known beforehand.
    """

    planes: list[NDArray[np.float32]]
    relight: Callable[[list[NDArray[np.float32]], int], NDArray[np.float32]]
    table_bytes: int
    mask_hw: NDArray[np.bool_]
    span: tuple[float, float] | None = None

    def compress(self, quality: int | None) -> tuple[int, list[NDArray[np.float32]]]:
        """Return all bytes at a JPEG quality (None: float32), and the planes that come back."""
        size, decoded = compress_planes(self.planes, quality, self.mask_hw, self.span)
        return size + self.table_bytes, decoded


def fit_rti(stack: LightStack, fitted_i: NDArray[np.intp], basis: str) -> RtiFit:
    """Fit some lights of a stack, which is read whole into memory as float32.

    Raises
    ------
    InputError
        If the basis is unknown, there are fewer lights than functions, or the mask is empty.
    """
    if basis not in BASES:
        raise InputError(f"the basis must be one of {', '.join(BASES)}, got {basis!r}")
    height, width, channel = stack.image_shape
    values_ip = (stack.read_rows(0, height).reshape(stack.n_light, -1) / np.float32(stack.peak)).astype(np.float32)
    mask_hw = np.ones((height, width), bool) if stack.mask_hw is None else stack.mask_hw
    if not mask_hw.any():
        raise InputError("the mask leaves no pixel to measure")
    fit = _fit_pca if basis in _PCA else _fit_photographs if basis == _PHOTOGRAPHS else _fit_fixed
    counted_ip = values_ip if mask_hw.all() else values_ip[:, np.repeat(mask_hw.ravel(), channel)]
    planes_kp, relight, table_bytes = fit(counted_ip, stack.directions_i3, fitted_i, channel, basis)
    planes = []
    for plane_p in planes_kp:
        plane_hwc = np.zeros((height, width, plane_p.size // int(mask_hw.sum())), np.float32)
        plane_hwc[mask_hw] = plane_p.reshape(-1, plane_hwc.shape[2])
        planes.append(plane_hwc)

    def relight_planes(decoded: list[NDArray[np.float32]], light: int) -> NDArray[np.float32]:
        image_p = relight(np.stack([plane.ravel() for plane in decoded]), light)
        return image_p.reshape(height, width, channel)

    return RtiFit(planes, relight_planes, table_bytes, mask_hw, (0.0, 1.0) if basis == _PHOTOGRAPHS else None)


def _fit_fixed(
    values_ip: NDArray[np.float32], directions_i3: NDArray[np.float64], fitted_i: NDArray, channel: int, basis: str
) -> tuple[NDArray[np.float32], Callable[[NDArray[np.float32], int], NDArray[np.float32]], int]:
    """Return planes (function, pixel channel), how to relight, and 0 bytes of tables: the functions are known."""
    basis_ik = _FIXED[basis](directions_i3)
    if len(fitted_i) < basis_ik.shape[1]:
        raise InputError(f"basis {basis} needs at least {basis_ik.shape[1]} lights, got {len(fitted_i)}")
    planes_kp = np.linalg.pinv(basis_ik[fitted_i]).astype(np.float32) @ values_ip[fitted_i]
    return planes_kp, lambda decoded_kp, i: basis_ik[i].astype(np.float32) @ decoded_kp, 0


def _fit_photographs(
    values_ip: NDArray[np.float32], directions_i3: NDArray[np.float64], fitted_i: NDArray, channel: int, basis: str
) -> tuple[NDArray[np.float32], Callable[[NDArray[np.float32], int], NDArray[np.float32]], int]:
    """Return the photographs themselves, how to relight, and 0 bytes of tables.

    Linear radial basis functions and a constant: a weight for every photograph, which directions alone decide.
    """
    from scipy.interpolate import RBFInterpolator

    n_light = len(fitted_i)
    weights = RBFInterpolator(directions_i3[fitted_i], np.eye(n_light), kernel="linear", smoothing=_TIES)
    weights_ii = weights(directions_i3).astype(np.float32)
    return values_ip[fitted_i], lambda decoded_kp, i: weights_ii[i] @ decoded_kp, 0


def _fit_pca(
    values_ip: NDArray[np.float32], directions_i3: NDArray[np.float64], fitted_i: NDArray, channel: int, basis: str
) -> tuple[NDArray[np.float32], Callable[[NDArray[np.float32], int], NDArray[np.float32]], int]:
    """Return planes (component, pixel), how to relight, and the bytes of mean and axes at 8 bits each.

    Ponchio, Corsini and Scopigno 2018: principal components of each pixel's samples of all lights and colours; between
    lights they are interpolated by radial basis functions of the projected direction (thin plates).
    """
    from scipy.interpolate import RBFInterpolator

    n_light, n_plane = len(fitted_i), _PCA[basis]
    if n_light * channel < n_plane or n_light < 3:
        raise InputError(f"basis {basis} needs at least {max(3, -(-n_plane // channel))} lights, got {n_light}")
    samples_pd = values_ip[fitted_i].reshape(n_light, -1, channel).transpose(1, 0, 2).reshape(-1, n_light * channel)
    mean_d = samples_pd.mean(axis=0, dtype=np.float64)
    some_pd = samples_pd[:: -(-len(samples_pd) // _PCA_SAMPLES)] - mean_d
    axes_kd = np.linalg.eigh(some_pd.T @ some_pd)[1].T[::-1][:n_plane]
    tables_kd = np.stack([_to_8_bits(row) for row in (mean_d, *axes_kd)])
    planes_kp = (np.linalg.pinv(tables_kd[1:]).T @ (samples_pd - tables_kd[0]).T).astype(np.float32)
    interpolate = RBFInterpolator(directions_i3[fitted_i, :2], tables_kd.T.reshape(n_light, -1), smoothing=_TIES)
    at_lights = interpolate(directions_i3[:, :2])
    tables_ick = at_lights.reshape(len(directions_i3), channel, 1 + n_plane).astype(np.float32)

    def relight(decoded_kp: NDArray[np.float32], i: int) -> NDArray[np.float32]:
        return (tables_ick[i, :, 1:] @ decoded_kp + tables_ick[i, :, :1]).T.ravel()

    return planes_kp, relight, tables_kd.size + 8 * len(tables_kd)


def _to_8_bits(row_d: NDArray[np.float64]) -> NDArray[np.float64]:
    low, step = row_d.min(), max(np.ptp(row_d), 1e-12) / 255.0
    return low + np.rint((row_d - low) / step) * step
