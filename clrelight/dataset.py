"""The two records that carry everything between the parts: `LightStack` and `CoefficientMap`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import TRANSFERS
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count

SAMPLE_DTYPES = ("uint8", "uint16", "float16", "float32")
"""The types that images may have; kernels read each of them without conversion on the host."""

COEFFICIENT_DTYPES = ("float32", "float16")
"""The types that coefficients may be stored in; kernels that relight read both."""

_ACCEPTED_KINDS = "buif"
_LEAST_PEAK = 1e-37
_UNIT_TOLERANCE = 1e-6
_WIDENED_BYTES = 1 << 24
"""Halves that are held at a time while they become float32."""


@dataclass(frozen=True)
class LightStack:
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
        if self.transfer not in TRANSFERS:
            raise InputError(f"transfer must be one of {', '.join(TRANSFERS)}, got {self.transfer!r}")
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

    def check_tile(self, tile_ihwc: NDArray, first: int) -> None:
        """Raise InputError, naming light and pixel, where a sample of rows from `first` on is no radiance."""
        check_radiance(tile_ihwc, first, self.picked_i)

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


class LightSubset:
    """Some lights of an image dataset that is read when indexed."""

    def __init__(self, images_ihwc: Any, lights_i: NDArray[np.intp]) -> None:
        self._images, self._lights = images_ihwc, lights_i
        self.shape = (len(lights_i), *images_ihwc.shape[1:])
        self.dtype = images_ihwc.dtype

    def __getitem__(self, key: tuple[slice, ...]) -> NDArray:
        # HDF5 reads scattered lights slowly and rows of all lights fast, so pick after reading.
        lights, *rest = key
        return self._images[(slice(None), *rest)][self._lights][lights]

    def read_rows_into(self, first: int, end: int, out_ihwc: NDArray) -> None:
        """Read rows first..end; the lights that are left out take little memory where the images are a file's."""
        if hasattr(self._images, "read_some_into"):
            self._images.read_some_into(self._lights, first, end, out_ihwc)
        else:
            out_ihwc[...] = self._images[:, first:end][self._lights]


def read_rows_into(array_nhwc: Any, first: int, end: int, out_nhwc: NDArray) -> NDArray:
    """Fill `out_nhwc` with rows first..end of an array, of a dataset, or of some lights of one, and return it."""
    if hasattr(array_nhwc, "read_rows_into"):
        array_nhwc.read_rows_into(first, end, out_nhwc)
    else:
        out_nhwc[...] = array_nhwc[:, first:end]
    return out_nhwc


@dataclass(frozen=True)
class CoefficientMap:
    """Spherical-harmonic coefficients of every pixel and channel; checked when made.

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
        if self.transfer not in TRANSFERS:
            raise InputError(f"transfer must be one of {', '.join(TRANSFERS)}, got {self.transfer!r}")
        check_peak(self.peak)
        check_directions(self.directions_i3, None)
        for label, value, dtype in (
            ("lambda", self.lambda_hwc, np.float32),
            ("rank", self.rank_hwc, np.int32),
        ):
            if value is not None and (tuple(value.shape) != shape[1:] or value.dtype != dtype):
                raise InputError(
                    f"{label} must be {np.dtype(dtype)} of shape {shape[1:]}, got {value.dtype} {value.shape}"
                )

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
        step = max(1, _WIDENED_BYTES // (n_coeff * width * channel * held.itemsize))
        for row in range(first, end, step):
            stop = min(row + step, end)
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


@dataclass(frozen=True)
class FitRecord:
    """What a fit holds beside its coefficients; attributes as of `CoefficientMap`."""

    degree: int
    method: str
    peak: float
    transfer: str
    directions_i3: NDArray[np.float64]
    config: Mapping[str, Any]
    name: str

    @classmethod
    def of(cls, coefficients: CoefficientMap) -> FitRecord:
        """Return the record of a fit."""
        return cls(
            coefficients.degree,
            coefficients.method,
            coefficients.peak,
            coefficients.transfer,
            coefficients.directions_i3,
            coefficients.config,
            coefficients.name,
        )

    def to_map(self, coeffs_khwc: Any) -> CoefficientMap:
        """Return the fit with decoded coefficients; InputError if they do not match the degree."""
        return CoefficientMap(
            coeffs_khwc,
            self.degree,
            self.method,
            self.peak,
            self.transfer,
            self.directions_i3,
            self.config,
            name=self.name,
        )


def sample_dtype(dtype: np.dtype) -> np.dtype:
    """Return the type that samples of a type are held in: a byte for bool, 16 bits for wider integers and signed ones,
    float32 for wider floats, and the machine's byte order. InputError for what is no number.
    """
    if dtype.kind not in _ACCEPTED_KINDS:
        raise InputError(f"images must be {', '.join(SAMPLE_DTYPES)} or numbers that fit one of them, got {dtype}")
    if dtype.kind == "b" or (dtype.kind == "u" and dtype.itemsize == 1):
        return np.dtype(np.uint8)
    if dtype.kind == "f":
        return np.dtype(np.float16 if dtype.itemsize == 2 else np.float32)
    return np.dtype(np.uint16)


def to_samples(values: NDArray, dtype: np.dtype) -> NDArray:
    """Return samples in the type that `sample_dtype` gave for theirs; InputError where an integer does not fit."""
    if values.dtype.kind == "i" or (dtype.kind == "u" and values.dtype.itemsize > dtype.itemsize):
        low, high = values.min(initial=0), values.max(initial=0)
        if low < 0 or high > np.iinfo(dtype).max:
            raise InputError(
                f"images are {values.dtype} from {low} to {high}: integers must be from 0 to {np.iinfo(dtype).max}, "
                f"others are for floats"
            )
    with np.errstate(over="ignore"):  # an infinity is refused where the sample can be named
        return values.astype(dtype, copy=False)


def as_samples(images: Any) -> Any:
    """Return images as they are held: an array in memory, converted where need be, or what is read when indexed."""
    if isinstance(images, np.ndarray) or not hasattr(images, "shape"):
        values = _as_array(images, "images")
        return to_samples(values, sample_dtype(values.dtype))
    return images


def as_coefficients(coefficients: Any) -> Any:
    """Return coefficients as they are held: float32 or float16 in memory, or what is read when indexed."""
    if isinstance(coefficients, np.ndarray) or not hasattr(coefficients, "shape"):
        values = _as_array(coefficients, "coefficients")
        if values.dtype.kind not in _ACCEPTED_KINDS:
            raise InputError(f"coefficients must be {' or '.join(COEFFICIENT_DTYPES)}, got {values.dtype}")
        is_half = values.dtype.kind == "f" and values.dtype.itemsize == 2
        return values.astype(np.float16 if is_half else np.float32, copy=False)
    return coefficients


def as_float64(values: Any, what: str) -> NDArray[np.float64]:
    """Return numbers as float64; InputError for anything else."""
    found = _as_array(values, what)
    if found.dtype.kind not in _ACCEPTED_KINDS:
        raise InputError(f"{what} must be numbers, got {found.dtype}")
    return found.astype(np.float64, copy=False)


def _as_array(values: Any, what: str) -> NDArray:
    try:
        return np.asarray(values)
    except ValueError:  # rows of unequal length
        raise InputError(f"{what} must be an array, or lists of equal lengths") from None


def _convert(record: Any, **values: Any) -> None:
    for name, value in values.items():
        object.__setattr__(record, name, value)  # frozen for all others


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


def check_peak(peak: float) -> None:
    """Raise InputError unless a peak and its reciprocal are numbers that float32 holds."""
    if not (np.isfinite(peak) and peak > 0):
        raise InputError(f"peak must be a positive number, got {peak}")
    if not _LEAST_PEAK <= peak <= 1.0 / _LEAST_PEAK:
        raise InputError(f"peak must be from {_LEAST_PEAK:g} to {1.0 / _LEAST_PEAK:g}, which float32 holds, got {peak}")


def check_radiance(tile_ihwc: NDArray, first_row: int = 0, picked_i: NDArray[np.intp] | None = None) -> None:
    """Raise InputError, naming the first sample that is negative or not finite.

    `picked_i` says where each image stands in the stack that the user knows.
    """
    if is_radiance(tile_ihwc):
        return
    bad = ~(np.isfinite(tile_ihwc) & (tile_ihwc >= 0))
    light, row, column, channel = (int(v) for v in np.argwhere(bad)[0])
    stands = light if picked_i is None else int(picked_i[light])
    raise InputError(
        f"image {stands} is {tile_ihwc[light, row, column, channel]} at row {first_row + row}, column {column}, "
        f"channel {channel}: radiance must be finite and not negative"
    )


def is_radiance(values: NDArray) -> bool:
    """Return whether all values, float16 or float32, are finite and not negative."""
    bits = values.view(values.dtype.str.replace("f", "u"))
    # Of numbers >= 0 the bits are in the numbers' order, infinity and NaN behind them, and then all with a sign. NumPy
    # compares integers at the speed of memory, and halves one by one.
    if bits.max(initial=0) < np.asarray(np.inf, values.dtype).view(bits.dtype):
        return True
    return bool(np.all(np.isfinite(values) & (values >= 0)))  # a zero may have a sign


def split_lights(n_light: int, holdout: int | None) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return every index but each K-th, and each K-th (``index % K == K - 1``); `clrelight.holdout` splits lights."""
    index = np.arange(n_light)
    if holdout is None:
        return index, index[:0]
    if holdout < 2:
        raise InputError(f"holdout must be at least 2 (every K-th light is kept out), got {holdout}")
    held = index % holdout == holdout - 1
    if not held.any():
        raise InputError(f"holdout {holdout} keeps no light out of {n_light}; use at most {n_light}")
    return index[~held], index[held]
