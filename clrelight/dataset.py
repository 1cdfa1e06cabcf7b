"""The two records that carry everything between the parts: `LightStack` and `CoefficientMap`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import (
    COEFFICIENT_DTYPES,
    SAMPLE_DTYPES,
    as_coefficients,
    as_float64,
    as_samples,
    check_directions,
    check_peak,
    check_radiance,
    check_transfer,
)
from clrelight.bases import OfBasis
from clrelight.described import Described
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.memory import PIECE_BYTES
from clrelight.surface import Surface, check_surface, surface_facts
from clrelight.tiles import LightSubset, read_rows_into, row_tiles


@dataclass(frozen=True, repr=False)
class LightStack(Described):
    """Images of one view, each under one distant light; checked when made.

    Attributes
    ----------
    images_ihwc : array_like, shape (n_light, height, width, channel)
        Code values, one of `SAMPLE_DTYPES`; a NumPy array or an HDF5 dataset that is read tile by tile. Lists and
        arrays of other numbers are converted: see `sample_dtype`.
    directions_i3 : array_like, shape (n_light, 3)
        Unit vectors from the surface to the lights; held as float64.
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
    picked_i : ndarray, shape (n_light,), int, optional
        Where each image stands in the stack that `select` took it from, for messages.
    notes : tuple of str
        What a file left open, and how it was taken.
    surface : Surface, optional
        What the pixels are vertices of; directions are then in the surface's frames.
    """

    images_ihwc: Any
    directions_i3: NDArray[np.float64]
    peak: float
    transfer: str = "linear"
    weights_i: NDArray[np.float64] | None = None
    mask_hw: NDArray[np.bool_] | None = None
    name: str = "stack"
    picked_i: NDArray[np.intp] | None = None
    notes: tuple[str, ...] = ()
    surface: Surface | None = None

    def __post_init__(self) -> None:
        _convert(
            self, images_ihwc=as_samples(self.images_ihwc), directions_i3=as_float64(self.directions_i3, "directions")
        )
        if self.weights_i is not None:
            _convert(self, weights_i=as_float64(self.weights_i, "weights"))
        if self.mask_hw is not None:
            _convert(self, mask_hw=np.asarray(self.mask_hw))
        shape = tuple(self.images_ihwc.shape)
        if len(shape) != 4 or min(shape) < 1:
            raise InputError(f"images must be (light, height, width, channel), none of them empty, got shape {shape}")
        if self.images_ihwc.dtype not in SAMPLE_DTYPES:
            raise InputError(f"images must be {', '.join(SAMPLE_DTYPES)}, got {self.images_ihwc.dtype}")
        check_transfer(self.transfer)
        check_peak(self.peak)
        check_directions(self.directions_i3, shape[0])
        if self.weights_i is not None and (
            self.weights_i.shape != shape[:1] or not np.all(np.isfinite(self.weights_i) & (self.weights_i >= 0))
        ):
            raise InputError(f"weights must be {shape[0]} finite numbers >= 0, got shape {self.weights_i.shape}")
        if self.weights_i is not None and not self.weights_i.any():
            raise InputError("weights must not all be 0")
        if self.mask_hw is not None and (self.mask_hw.shape != shape[1:3] or self.mask_hw.dtype != np.bool_):
            raise InputError(f"mask must be bool of shape {shape[1:3]}, got {self.mask_hw.dtype} {self.mask_hw.shape}")
        check_surface(self.surface, shape[1:3])

    def read_rows(self, first: int, end: int, out_ihwc: NDArray | None = None) -> NDArray:
        """Return rows first..end of every image, C-contiguous (n_light, end - first, width, channel).

        They are read into `out_ihwc` where it is given, an array of that shape and the images' type.
        Raises InputError, naming light and pixel, where a float sample is negative or not finite.
        """
        tile_ihwc = self.load_rows(first, end, out_ihwc)
        if tile_ihwc.dtype.kind == "f":
            self.check_tile(tile_ihwc, first)
        return tile_ihwc

    def check_rows(self, first: int, end: int) -> None:
        """Raise the InputError of `read_rows` where there is reason to; images are arrays in memory."""
        if self.images_ihwc.dtype.kind == "f":
            check_radiance(self.images_ihwc[:, first:end], first, self.picked_i)

    def load_rows(self, first: int, end: int, out_ihwc: NDArray | None = None) -> NDArray:
        """Return what `read_rows` does, for callers that call `check_tile` themselves."""
        if out_ihwc is None:
            return np.ascontiguousarray(self.images_ihwc[:, first:end])
        return read_rows_into(self.images_ihwc, first, end, out_ihwc)

    def check_tile(self, tile_ihwc: NDArray, first: int, left: int = 0) -> None:
        """Raise InputError, naming light and pixel, where a sample is no radiance; the tile begins there."""
        check_radiance(tile_ihwc, first, self.picked_i, left)

    def select(self, lights_i: NDArray[np.intp]) -> LightStack:
        """Return the stack of these lights only; images stay where they are until read."""
        images = self.images_ihwc
        chosen = images[lights_i] if isinstance(images, np.ndarray) else LightSubset(images, lights_i)
        weights = None if self.weights_i is None else self.weights_i[lights_i]
        picked = np.asarray(lights_i) if self.picked_i is None else self.picked_i[lights_i]
        return replace(
            self, images_ihwc=chosen, directions_i3=self.directions_i3[lights_i], weights_i=weights, picked_i=picked
        )

    @property
    def n_light(self) -> int:
        """Number of lights, which is the number of images."""
        return int(self.images_ihwc.shape[0])

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of each image."""
        height, width, channel = self.images_ihwc.shape[1:]
        return int(height), int(width), int(channel)


@dataclass(frozen=True, repr=False)
class CoefficientMap(Described, OfBasis):
    """Coefficients of every pixel and channel, of spherical harmonics or another basis; checked when made.

    Attributes
    ----------
    coeffs_khwc : array_like, shape (n_coeff, height, width, channel), one of `COEFFICIENT_DTYPES`
        Coefficients of linear radiance in units of the peak; ``k = l (l + 1) + m``. May be an HDF5 dataset.
        `read_rows` and `to_float32` give float32 of either type. Lists and other numbers become float32.
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
    surface : Surface, optional
        What the pixels are vertices of; the functions are then in the surface's frames.
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
    surface: Surface | None = None

    def __post_init__(self) -> None:
        _convert(
            self,
            coeffs_khwc=as_coefficients(self.coeffs_khwc),
            directions_i3=as_float64(self.directions_i3, "directions"),
        )
        shape = tuple(self.coeffs_khwc.shape)
        if len(shape) != 4 or min(shape) < 1:
            raise InputError(f"coefficients must be (coefficient, height, width, channel), got shape {shape}")
        if self.coeffs_khwc.dtype not in (np.float32, np.float16):
            raise InputError(f"coefficients must be {' or '.join(COEFFICIENT_DTYPES)}, got {self.coeffs_khwc.dtype}")
        if self.degree < 0 or shape[0] != coefficient_count(self.degree):
            raise InputError(f"degree {self.degree} has {coefficient_count(self.degree)} coefficients, got {shape[0]}")
        self.check_basis()
        check_transfer(self.transfer)
        check_peak(self.peak)
        check_directions(self.directions_i3, None)
        for label, value, dtype in (("lambda", self.lambda_hwc, np.float32), ("rank", self.rank_hwc, np.int32)):
            if value is not None and (tuple(value.shape) != shape[1:] or value.dtype != dtype):
                raise InputError(
                    f"{label} must be {np.dtype(dtype)} of shape {shape[1:]}, got {value.dtype} {value.shape}"
                )
        check_surface(self.surface, shape[1:3])

    def read_rows(self, first: int, end: int, out_khwc: NDArray) -> NDArray:
        """Fill `out_khwc`, C-contiguous (n_coeff, end - first, width, channel), with rows first..end and return it.

        It is of the type that the map holds, or float32: then halves become float32, which changes no value.
        """
        held = self.coeffs_khwc.dtype
        if out_khwc.dtype == held:
            return read_rows_into(self.coeffs_khwc, first, end, out_khwc)
        if out_khwc.dtype != np.float32:
            raise TypeError(f"expected an array of {held} or float32, got {out_khwc.dtype}")
        n_coeff, _, width, channel = out_khwc.shape
        step = max(1, PIECE_BYTES // (n_coeff * width * channel * held.itemsize))
        for row, stop in row_tiles((first, end), step):
            rows_khwc = np.empty((n_coeff, stop - row, width, channel), held)
            out_khwc[:, row - first : stop - first] = read_rows_into(self.coeffs_khwc, row, stop, rows_khwc)
        return out_khwc

    def to_float32(self) -> CoefficientMap:
        """Return this map with its coefficients in memory as float32, which changes no value."""
        held = self.coeffs_khwc
        if isinstance(held, np.ndarray) and held.dtype == np.float32:
            return self
        height = self.image_shape[0]
        return replace(self, coeffs_khwc=self.read_rows(0, height, np.empty(held.shape, np.float32)))

    @property
    def n_coeff(self) -> int:
        """Number of coefficients of each column."""
        return int(self.coeffs_khwc.shape[0])

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of each image."""
        height, width, channel = self.coeffs_khwc.shape[1:]
        return int(height), int(width), int(channel)


@dataclass(frozen=True, repr=False)
class FitRecord(Described, OfBasis):
    """What a fit holds beside its maps; attributes as of `CoefficientMap`."""

    degree: int
    method: str
    peak: float
    transfer: str
    directions_i3: NDArray[np.float64]
    config: Mapping[str, Any]
    name: str
    surface: Surface | None = None

    @classmethod
    def of(cls, coefficients: CoefficientMap) -> FitRecord:
        """Return the record of a fit."""
        return cls(**{each.name: getattr(coefficients, each.name) for each in fields(cls)})

    def without_surface(self) -> FitRecord:
        """Return the record of what holds no geometry; its config says in whose frames functions are, and of what."""
        if self.surface is None:
            return self
        return replace(self, surface=None, config={**self.config, "surface": surface_facts(self.surface, self.config)})

    def to_map(self, coeffs_khwc: Any, lambda_hwc: Any = None, rank_hwc: Any = None) -> CoefficientMap:
        """Return the fit with these maps; InputError if they do not match the degree, or each other."""
        return CoefficientMap(coeffs_khwc, lambda_hwc=lambda_hwc, rank_hwc=rank_hwc, **vars(self))


def _convert(record: Any, **values: Any) -> None:
    for name, value in values.items():
        object.__setattr__(record, name, value)  # frozen for all others


def split_lights(n_light: int, holdout: int | None) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return every index but each K-th, and each K-th (``index % K == K - 1``); `clrelight.holdout` splits lights."""
    index = np.arange(n_light)
    if holdout is None:
        return index, index[:0]
    if holdout < 2:
        raise InputError(f"holdout must be at least 2 (every K-th light is kept out), got {holdout}")
    held = index % holdout == holdout - 1
    if not held.any():
        hint = f"use at most {n_light}" if n_light > 1 else "one light can only be fitted: leave holdout out"
        raise InputError(f"holdout {holdout} keeps no light out of {n_light}; {hint}")
    return index[~held], index[held]
