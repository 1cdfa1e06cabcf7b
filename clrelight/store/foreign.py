"""Stacks that others write, with h5py or MATLAB: what can be read in only one way is read so, and noted."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import sample_dtype, to_samples
from clrelight.conventions import default_peak
from clrelight.dataset import LightStack
from clrelight.errors import StoreFormatError
from clrelight.memory import PIECE_BYTES
from clrelight.store.blocks import box_of
from clrelight.store.opening import Opened
from clrelight.store.stored import StoredArray
from clrelight.store.surfaces import surface_of
from clrelight.tiles import Rectangle, check_shape, row_tiles

LEAST_LENGTH, MOST_LENGTH = 0.99, 1.01
"""Directions of such lengths are made unit vectors; others are no directions."""

_NOTED_LENGTH = 1e-5
"""Off by less, a direction was rounded, and is made a unit vector without a word."""


class ForeignImages:
    """Images of another type or with other axes than ours, converted as they are read.

    Parameters
    ----------
    stored : StoredArray
    axes : tuple of int
        Which axis of it holds lights, rows, columns, and channels, where it has such an axis.
    dtype : dtype
        What samples become.
    """

    def __init__(self, stored: StoredArray, axes: tuple[int, ...], dtype: np.dtype) -> None:
        self._stored, self._axes, self._gray = stored, axes, len(axes) == 3
        self.shape = tuple(stored.shape[axis] for axis in axes) + (1,) * self._gray
        self.dtype, self.ndim = dtype, 4
        self.chunks: tuple[int, ...] | None = None
        if stored.chunks is not None and axes == tuple(range(stored.ndim)):
            self.chunks = stored.chunks + (1,) * self._gray

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> NDArray:
        """Read a selection, as `StoredArray` does."""
        box, rest = box_of(key, self.shape)
        out = np.empty([part.stop - part.start for part in box], self.dtype)
        self._convert_into(box, out)
        return out[rest]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        """Read everything."""
        whole = self[...]
        return whole if dtype is None else whole.astype(dtype, copy=False)

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """See `clrelight.tiles.PixelArray`."""
        check_shape(tile, out, self.shape, picked_n)
        if picked_n is None:
            self._convert_into(box_of(np.s_[:, tile.rows, tile.columns], self.shape)[0], out)
            return
        step = max(1, PIECE_BYTES // (math.prod(self.shape) // self.shape[1] * self.dtype.itemsize))
        for start, stop in row_tiles((tile.top, tile.bottom), step):
            out[:, start - tile.top : stop - tile.top] = self[:, start:stop, tile.columns][picked_n]

    def _convert_into(self, box: tuple[slice, ...], out: NDArray) -> None:
        """Read and convert a few rows at a time: wide types take more memory than what they become."""
        if not out.size:
            return
        lights, rows, *others = box
        row_bytes = out[:, 0].size * self._stored.dtype.itemsize
        step = max(1, PIECE_BYTES // row_bytes)
        for start in range(rows.start, rows.stop, step):
            stop = min(start + step, rows.stop)
            key: list[slice] = [slice(None)] * len(self._axes)
            wanted = [lights, slice(start, stop), *others][: len(self._axes)]
            for axis, part in zip(self._axes, wanted, strict=True):
                key[axis] = part
            values = self._stored[tuple(key)].transpose(self._axes)
            if self._gray:
                values = values[..., None]
            out[:, start - rows.start : stop - rows.start] = to_samples(values, self.dtype)


def stack_of_others(opened: Opened) -> LightStack:
    """Return the stack in an open file that has no seal; StoreFormatError or InputError if it is none."""
    for name in ("images", "directions"):
        if name not in opened.arrays:
            raise StoreFormatError(f"it has no dataset {name}, which {opened.schema.name} needs")
    notes: list[str] = []
    stored = opened.arrays["images"]
    directions_i3, are_rows = _read_directions(opened.arrays["directions"], stored.shape)
    axes = _find_axes(stored.shape, len(directions_i3), are_rows)
    if axes != tuple(range(stored.ndim)):
        read = _times(tuple(stored.shape[axis] for axis in axes))
        named = ", ".join(("light", "height", "width", "channel")[: len(axes)])
        notes.append(
            f"images {_times(stored.shape)} have their axes in reverse, as MATLAB writes them: read as {read} ({named})"
        )
    peak = _read_peak(opened, stored.dtype, notes)
    dtype = sample_dtype(stored.dtype)
    is_ours = axes == (0, 1, 2, 3) and stored.dtype == dtype
    images: Any = stored if is_ours else ForeignImages(stored, axes, dtype)
    if images.shape[3] not in (1, 3):
        extra = " (an alpha channel is no colour: leave it out)" if images.shape[3] in (2, 4) else ""
        notes.append(f"images have {images.shape[3]} channels, each is taken as a colour of its own{extra}")
    transfer = _read_text(opened, "transfer", "linear", notes).lower()
    name = _read_text(opened, "name", Path(opened.path).stem or "stack", notes)
    return LightStack(
        images,
        _normalize(directions_i3, notes),
        peak,
        transfer,
        _read_weights(opened),
        _read_mask(opened, images.shape[1:3], axes, notes),
        name,
        notes=tuple(notes),
        surface=surface_of(opened),
    )


def _read_peak(opened: Opened, dtype: np.dtype, notes: list[str]) -> float:
    if opened.has("peak"):
        return opened.attribute("peak", float)
    if dtype.kind in "iu" and dtype.itemsize > 2:
        raise StoreFormatError(
            f"images are {dtype} and it has no attribute peak, the value that means 1.0: write it, "
            f"f.attrs['peak'] = 255.0 or 65535.0"
        )
    peak = default_peak(dtype)
    notes.append(f"it has no attribute peak: {peak:g} is taken as the value that means 1.0")
    return peak


def _read_text(opened: Opened, name: str, default: str, notes: list[str]) -> str:
    if opened.has(name):
        return opened.attribute(name, str)
    notes.append(f"it has no attribute {name}: taken as {default}")
    return default


def _read_directions(stored: StoredArray, images: tuple[int, ...]) -> tuple[NDArray[np.float64], bool]:
    """Return directions, one in a row, and whether the file has one in a column instead."""
    shape = stored.shape
    if stored.ndim != 2 or 3 not in shape or stored.dtype.kind not in "iuf":
        raise StoreFormatError(f"directions are {stored.dtype} {shape}, expected numbers N×3 (x, y, z of each light)")
    values = stored[...].astype(np.float64)
    if shape[1] != 3 or (shape[0] == 3 and 3 not in (images[0], images[-1])):
        return np.ascontiguousarray(values.T), True
    return values, False


def _normalize(directions_i3: NDArray[np.float64], notes: list[str]) -> NDArray[np.float64]:
    """Return unit vectors of nearly unit vectors; what is farther off is left, to be refused by name."""
    length_i = np.linalg.norm(directions_i3, axis=1)
    if not np.all((length_i >= LEAST_LENGTH) & (length_i <= MOST_LENGTH)):
        return directions_i3
    off = float(np.max(np.abs(length_i - 1.0), initial=0.0))
    if off > _NOTED_LENGTH:
        notes.append(f"directions are made unit vectors: their lengths are off by up to {100 * off:.2g}%")
    return directions_i3 if off < 1e-15 else directions_i3 / length_i[:, None]


def _find_axes(shape: tuple[int, ...], n_light: int, is_transposed: bool) -> tuple[int, ...]:
    """Return which axes hold lights, rows, columns and channels; StoreFormatError where that cannot be told."""
    if len(shape) not in (3, 4) or min(shape) < 1:
        raise StoreFormatError(
            f"images must be (light, height, width, channel) or (light, height, width), none of them empty, "
            f"got {_times(shape)}"
        )
    where = f"images {_times(shape)} with {n_light} directions"
    if n_light not in (shape[0], shape[-1]):
        raise StoreFormatError(f"{where}: expected as many images as directions along the first axis")
    channels = (1, 3)
    if len(shape) == 3:
        if shape[0] == n_light and not (is_transposed and shape[-1] == n_light):
            return 0, 1, 2
        if shape[0] != n_light and is_transposed:
            return 2, 1, 0
        raise StoreFormatError(
            f"{where}: it cannot be told which axis holds the lights; expected (light, height, width), "
            f"by numpy.moveaxis(images, -1, 0)"
        )
    if shape[0] == n_light:
        if shape[1] in (1, 3, 4) and shape[3] > 4 and shape[2] > 4:
            raise StoreFormatError(
                f"{where} look like (light, channel, height, width): expected (light, height, width, channel), "
                f"by numpy.moveaxis(images, 1, 3)"
            )
        return 0, 1, 2, 3
    if shape[0] in channels and shape[2] not in channels:
        return 3, 2, 1, 0
    raise StoreFormatError(
        f"{where} have the lights last: expected (light, height, width, channel), by numpy.moveaxis(images, -1, 0)"
    )


def _read_weights(opened: Opened) -> NDArray[np.float64] | None:
    stored = opened.arrays.get("weights")
    if stored is None:
        return None
    if stored.dtype.kind not in "iuf" or stored.size != max(stored.shape, default=0):
        raise StoreFormatError(f"weights are {stored.dtype} {stored.shape}, expected one number for each light")
    return stored[...].astype(np.float64).reshape(-1)


def _read_mask(
    opened: Opened, shape_hw: tuple[int, ...], axes: tuple[int, ...], notes: list[str]
) -> NDArray[np.bool_] | None:
    stored = opened.arrays.get("mask")
    if stored is None:
        return None
    if stored.dtype.kind not in "biuf" or math.prod(stored.shape) != math.prod(shape_hw) or stored.ndim != 2:
        raise StoreFormatError(f"mask is {stored.dtype} {stored.shape}, expected {_times(shape_hw)} of 0 and 1")
    mask_hw = stored[...].T if axes[0] != 0 else stored[...]
    if mask_hw.shape != shape_hw:
        raise StoreFormatError(f"mask is {_times(mask_hw.shape)}, the images are {_times(shape_hw)}")
    if mask_hw.dtype.kind == "b":
        return np.ascontiguousarray(mask_hw)
    largest = 255 if (mask_hw == 255).any() else 1
    is_soft = mask_hw.dtype.kind == "f" and largest == 1 and bool(np.all((mask_hw >= 0) & (mask_hw <= 1)))
    if not (is_soft or np.all((mask_hw == 0) | (mask_hw == largest))):
        raise StoreFormatError("mask must be 0 and 1, or 0 and 255, or from 0 to 1, and holds something else")
    if not np.all((mask_hw == 0) | (mask_hw == largest)):
        notes.append("the mask has values between 0 and 1: those from 0.5 on count")
    return np.ascontiguousarray(mask_hw >= 0.5 * largest)


def _times(shape: tuple[int, ...]) -> str:
    return "×".join(str(n) for n in shape)
