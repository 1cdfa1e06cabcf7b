"""Pictures that say which pixels count."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import default_peak
from clrelight.errors import InputError
from clrelight.image_header import ImageHeader
from clrelight.images import BAND_BYTES, read_alpha, read_bands, read_header


def read_mask(
    path: Path, shape_hw: tuple[int, int], band_bytes: int = BAND_BYTES
) -> tuple[NDArray[np.bool_], list[str]]:
    """Return where a mask's pixels are not zero, and what a user should know.

    Where all colours are the same throughout, the mask is in the alpha channel. Codes of lossy formats (JPEG) scatter
    about those that were saved, so there a pixel counts from half of the largest code up.

    Parameters
    ----------
    path : Path
    shape_hw : tuple of int
        Height and width that it must have.
    band_bytes : int
        Bytes that are decoded at a time.

    Raises
    ------
    InputError
        If it cannot be read, is of another size, or NaN.
    """
    header = read_header(path)
    if (header.height, header.width) != shape_hw:
        raise InputError(
            f"mask {path} has {header.width}×{header.height} pixels, but the images {shape_hw[1]}×{shape_hw[0]}"
        )
    notes = [f"mask {path.name}: {note}" for note in header.notes if note not in header.colours.notes]
    if header.camera_orientation != 1:
        notes.append(f"mask {path.name} carries EXIF orientation {header.camera_orientation}, not applied")
    least = default_peak(header.dtype) / 2 if header.is_lossy else 0
    mask_hw, is_flat, has_grays = _read_colours(header, least, band_bytes)
    if is_flat and header.picture.alpha is not None:
        mask_hw = read_alpha(header) > least
        notes.append(f"mask {path.name}: its colours are the same throughout, so its alpha says what counts")
    elif header.is_lossy:
        notes.append(f"mask {path.name} is of a lossy format: what is at least half as bright as white counts")
    elif has_grays:
        notes.append(f"mask {path.name} has more than two levels: whatever is not zero counts")
    return mask_hw, notes


def _read_colours(header: ImageHeader, least: float, band_bytes: int) -> tuple[NDArray[np.bool_], bool, bool]:
    """Return where any colour is above `least`, whether there is one colour only, and whether more than two levels."""
    mask_hw = np.empty((header.height, header.width), bool)
    low: NDArray | None = None
    high: NDArray | None = None
    lowest_lit = np.inf
    for row, band_hwc in read_bands(header, None, band_bytes):
        if band_hwc.dtype.kind == "f" and np.isnan(band_hwc).any():
            raise InputError(f"mask {header.path} holds NaN, expected numbers")
        lit_hwc = band_hwc > least
        mask_hw[row : row + len(band_hwc)] = lit_hwc.any(axis=2)
        lowest_lit = min(lowest_lit, float(band_hwc.min(where=lit_hwc, initial=_largest(band_hwc.dtype))))
        darkest, brightest = band_hwc.min(axis=(0, 1)), band_hwc.max(axis=(0, 1))
        low = darkest if low is None else np.minimum(low, darkest)
        high = brightest if high is None else np.maximum(high, brightest)
    assert low is not None
    assert high is not None
    return mask_hw, bool(np.all(low == high)), bool(mask_hw.any() and lowest_lit < float(high.max()))


def _largest(dtype: np.dtype) -> float:
    return float(np.inf) if dtype.kind == "f" else float(np.iinfo(dtype).max)
