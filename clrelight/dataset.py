"""The two records that carry everything between the parts: `LightStack` and `CoefficientMap`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import TRANSFERS, coefficient_count
from clrelight.errors import InputError

SAMPLE_DTYPES = ("uint8", "uint16", "float16", "float32")
"""The types that images may have; kernels read each of them without conversion on the host."""

_UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True)
class LightStack:
    """Images of one view, each under one distant light; checked when made.

    Attributes
    ----------
    images_ihwc : array_like, shape (n_light, height, width, channel)
        Code values, one of `SAMPLE_DTYPES`; a NumPy array or an HDF5 dataset that is read tile by tile.
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors from the surface to the lights.
    peak : float
        Code value that means radiance 1.0.
    transfer : str
        ``"linear"`` or ``"srgb"``: the curve between code values and linear radiance.
    weights_i : ndarray, shape (n_light,), float64, optional
        Solid angle of each light's cell in steradian.
    mask_hw : ndarray, shape (height, width), bool, optional
        True where pixels count.
    name : str
        What tables call it.
    """

    images_ihwc: Any
    directions_i3: NDArray[np.float64]
    peak: float
    transfer: str = "linear"
    weights_i: NDArray[np.float64] | None = None
    mask_hw: NDArray[np.bool_] | None = None
    name: str = "stack"

    def __post_init__(self) -> None:
        shape = tuple(self.images_ihwc.shape)
        if len(shape) != 4 or min(shape) < 1:
            raise InputError(f"images must be (light, height, width, channel), none of them empty, got shape {shape}")
        if np.dtype(self.images_ihwc.dtype).name not in SAMPLE_DTYPES:
            raise InputError(f"images must be {', '.join(SAMPLE_DTYPES)}, got {self.images_ihwc.dtype}")
        if self.transfer not in TRANSFERS:
            raise InputError(f"transfer must be one of {', '.join(TRANSFERS)}, got {self.transfer!r}")
        if not (np.isfinite(self.peak) and self.peak > 0):
            raise InputError(f"peak must be a positive number, got {self.peak}")
        check_directions(self.directions_i3, shape[0])
        if self.weights_i is not None and (
            self.weights_i.shape != shape[:1] or not np.all(np.isfinite(self.weights_i) & (self.weights_i >= 0))
        ):
            raise InputError(f"weights must be {shape[0]} finite numbers >= 0, got shape {self.weights_i.shape}")
        if self.mask_hw is not None and (self.mask_hw.shape != shape[1:3] or self.mask_hw.dtype != np.bool_):
            raise InputError(f"mask must be bool of shape {shape[1:3]}, got {self.mask_hw.dtype} {self.mask_hw.shape}")

    @property
    def n_light(self) -> int:
        """Number of lights, which is the number of images."""
        return int(self.images_ihwc.shape[0])

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of each image."""
        height, width, channel = self.images_ihwc.shape[1:]
        return int(height), int(width), int(channel)


@dataclass(frozen=True)
class CoefficientMap:
    """Spherical-harmonic coefficients of every pixel and channel; checked when made.

    Attributes
    ----------
    coeffs_khwc : ndarray, shape (n_coeff, height, width, channel), float32
        Coefficients of linear radiance in units of the peak; ``k = l (l + 1) + m``. May be an HDF5 dataset.
    degree : int
        Largest degree; ``n_coeff = (degree + 1)**2``.
    method : str
        The fit that made it.
    peak, transfer
        Those of the stack it was fitted to.
    directions_i3 : ndarray, shape (n_light, 3), float64
        The lights it was fitted to (held-out ones are not among them).
    config : mapping
        Options of the fit, JSON values only.
    lambda_hwc : ndarray, shape (height, width, channel), float32, optional
        Regularisation of each column, where the method has one.
    rank_hwc : ndarray, shape (height, width, channel), int32, optional
        Number of eigenvectors kept in each column, where the method has one.
    name : str
        Name of the stack it was fitted to.
    """

    coeffs_khwc: Any
    degree: int
    method: str
    peak: float
    transfer: str
    directions_i3: NDArray[np.float64]
    config: Mapping[str, Any] = field(default_factory=dict)
    lambda_hwc: NDArray[np.float32] | None = None
    rank_hwc: NDArray[np.int32] | None = None
    name: str = "stack"

    def __post_init__(self) -> None:
        shape = tuple(self.coeffs_khwc.shape)
        if len(shape) != 4 or min(shape) < 1:
            raise InputError(f"coefficients must be (coefficient, height, width, channel), got shape {shape}")
        if self.coeffs_khwc.dtype != np.float32:
            raise InputError(f"coefficients must be float32, got {self.coeffs_khwc.dtype}")
        if self.degree < 0 or shape[0] != coefficient_count(self.degree):
            raise InputError(f"degree {self.degree} has {(self.degree + 1) ** 2} coefficients, got {shape[0]}")
        if self.transfer not in TRANSFERS:
            raise InputError(f"transfer must be one of {', '.join(TRANSFERS)}, got {self.transfer!r}")
        if not (np.isfinite(self.peak) and self.peak > 0):
            raise InputError(f"peak must be a positive number, got {self.peak}")
        check_directions(self.directions_i3, None)
        for label, value, dtype in (
            ("lambda", self.lambda_hwc, np.float32),
            ("rank", self.rank_hwc, np.int32),
        ):
            if value is not None and (tuple(value.shape) != shape[1:] or value.dtype != dtype):
                raise InputError(
                    f"{label} must be {np.dtype(dtype)} of shape {shape[1:]}, got {value.dtype} {value.shape}"
                )

    @property
    def n_coeff(self) -> int:
        """Number of coefficients of each column."""
        return int(self.coeffs_khwc.shape[0])

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of each image."""
        height, width, channel = self.coeffs_khwc.shape[1:]
        return int(height), int(width), int(channel)


def check_directions(directions_i3: NDArray, n_light: int | None) -> None:
    """Raise InputError unless `directions_i3` is (n_light, 3) float64 of finite unit vectors."""
    if directions_i3.ndim != 2 or directions_i3.shape[1] != 3 or directions_i3.dtype != np.float64:
        raise InputError(
            f"directions must be float64 of shape (n_light, 3), got {directions_i3.dtype} {directions_i3.shape}"
        )
    if n_light is not None and len(directions_i3) != n_light:
        raise InputError(f"there are {n_light} images but {len(directions_i3)} light directions")
    bad = np.flatnonzero(~(np.abs(np.linalg.norm(directions_i3, axis=1) - 1.0) <= _UNIT_TOLERANCE))
    if bad.size:
        raise InputError(f"light {bad[0]} has direction {directions_i3[bad[0]]}, which is no finite unit vector")
