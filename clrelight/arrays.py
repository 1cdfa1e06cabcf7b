"""Arrays of samples, coefficients and directions: what they may hold, what they are turned into."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import TRANSFERS
from clrelight.errors import InputError, counted

SAMPLE_DTYPES = ("uint8", "uint16", "float16", "float32")
"""The types that images may have; kernels read each of them without conversion on the host."""

COEFFICIENT_DTYPES = ("float32", "float16")
"""The types that coefficients may be stored in; kernels that relight read both."""

_ACCEPTED_KINDS = "buif"
_LEAST_PEAK = 1e-37
_UNIT_TOLERANCE = 1e-6


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


def check_directions(directions_i3: NDArray, n_light: int | None) -> None:
    """Raise InputError unless `directions_i3` is (n_light, 3) float64 of finite unit vectors."""
    if directions_i3.ndim != 2 or directions_i3.shape[1] != 3 or directions_i3.dtype != np.float64:
        raise InputError(
            f"directions must be float64 of shape (n_light, 3), got {directions_i3.dtype} {directions_i3.shape}"
        )
    if n_light is not None and len(directions_i3) != n_light:
        raise InputError(f"there are {counted(n_light, 'image')} but {counted(len(directions_i3), 'light direction')}")
    bad = np.flatnonzero(~(np.abs(np.linalg.norm(directions_i3, axis=1) - 1.0) <= _UNIT_TOLERANCE))
    if bad.size:
        raise InputError(f"light {bad[0]} has direction {directions_i3[bad[0]]}, which is no finite unit vector")


def check_transfer(transfer: str) -> None:
    """Raise InputError unless there is a curve of this name."""
    if transfer not in TRANSFERS:
        raise InputError(f"transfer must be one of {', '.join(TRANSFERS)}, got {transfer!r}")


def check_peak(peak: float) -> None:
    """Raise InputError unless a peak and its reciprocal are numbers that float32 holds."""
    if not (np.isfinite(peak) and peak > 0):
        raise InputError(f"peak must be a positive number, got {peak}")
    if not _LEAST_PEAK <= peak <= 1.0 / _LEAST_PEAK:
        raise InputError(f"peak must be from {_LEAST_PEAK:g} to {1.0 / _LEAST_PEAK:g}, which float32 holds, got {peak}")


def check_radiance(
    tile_ihwc: NDArray, first_row: int = 0, picked_i: NDArray[np.intp] | None = None, first_column: int = 0
) -> None:
    """Raise InputError, naming the first sample that is negative or not finite.

    `picked_i` says where each image stands in the stack that the user knows.
    """
    if is_radiance(tile_ihwc):
        return
    bad = ~(np.isfinite(tile_ihwc) & (tile_ihwc >= 0))
    light, row, column, channel = (int(v) for v in np.argwhere(bad)[0])
    stands = light if picked_i is None else int(picked_i[light])
    raise InputError(
        f"image {stands} is {tile_ihwc[light, row, column, channel]} at row {first_row + row}, "
        f"column {first_column + column}, channel {channel}: radiance must be finite and not negative"
    )


def is_radiance(values: NDArray) -> bool:
    """Return whether all values, float16 or float32, are finite and not negative."""
    bits = values.view(values.dtype.str.replace("f", "u"))
    # Of numbers >= 0 the bits are in the numbers' order, infinity and NaN behind them, and then all with a sign. NumPy
    # compares integers at the speed of memory, and halves one by one.
    if bits.max(initial=0) < np.asarray(np.inf, values.dtype).view(bits.dtype):
        return True
    return bool(np.all(np.isfinite(values) & (values >= 0)))  # a zero may have a sign
