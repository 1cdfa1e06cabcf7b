"""What a stack takes of its photographs: which pixels, how their values change, and what is odd about them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import default_peak
from clrelight.errors import InputError
from clrelight.image_header import ImageHeader
from clrelight.images import BAND_BYTES, read_bands
from clrelight.ingest.shrinking import Shrink
from clrelight.lights import LightTable, subset_text
from clrelight.masks import read_mask
from clrelight.negatives import Negatives
from clrelight.tiles import Rectangle

# Half precision keeps 11 bits between these.
_HALF_SMALLEST, _HALF_LARGEST = 2.0**-14, 65504.0


@dataclass(frozen=True)
class Values:
    """How code values of a file become those of the stack: as they are, or times a factor per light and channel."""

    dtype: np.dtype
    peak: float
    factors_ic: NDArray[np.float32] | None = None
    code_peak: float = 1.0

    def convert(self, band_hwc: NDArray, light: int) -> NDArray:
        """Return the stack's values of some rows of an image."""
        if self.factors_ic is None:
            return band_hwc
        return np.multiply(band_hwc, self.factors_ic[light], dtype=np.float32)


@dataclass
class Extremes:
    """Whether an image is black, or at the code of white or above, wherever pixels count.

    Floats have no such code: what is above 1.0 is not clipped.
    """

    white_code: float
    black: bool = True
    white: bool = True

    def take(self, band_hwc: NDArray, mask_hw: NDArray[np.bool_] | None) -> None:
        """Take in further rows of the image; once both are out of the question this costs nothing."""
        self.white = self.white and band_hwc.dtype.kind == "u"
        if mask_hw is not None and mask_hw.any():
            # One pixel decides nearly always, and spares picking out the others.
            self._look(band_hwc[np.unravel_index(mask_hw.argmax(), mask_hw.shape)])
            if self.black or self.white:
                self._look(band_hwc[mask_hw])
        elif mask_hw is None:
            self._look(band_hwc)

    def _look(self, values: NDArray) -> None:
        self.black = self.black and not values.any()
        self.white = self.white and bool(values.min() >= self.white_code)


@dataclass(frozen=True)
class Photographs:
    """What is read: the images, the part of them that is kept, and how their values change."""

    headers: list[ImageHeader]
    window: Rectangle
    values: Values
    negatives: Negatives = field(default_factory=Negatives)
    mask_hw: NDArray[np.bool_] | None = None
    extremes: Sequence[Extremes] = ()
    shrink: Shrink | None = None
    transfer: str = "linear"

    @property
    def shape_ihwc(self) -> tuple[int, int, int, int]:
        """Shape of the stack."""
        shape = self.window.shape if self.shrink is None else self.shrink.shape
        return len(self.headers), *shape, self.headers[0].channels

    def bands(self, light: int, band_bytes: int) -> Iterator[tuple[int, NDArray]]:
        """Yield the stack's values of an image from top to bottom, with the first row of each band in the stack."""
        bands = self._whole_bands(light, band_bytes)
        if self.shrink is not None:
            bands = self.shrink.bands(bands, self.values.dtype, self.transfer, self.values.peak)
        return bands

    def _whole_bands(self, light: int, band_bytes: int) -> Iterator[tuple[int, NDArray]]:
        header = self.headers[light]
        for row, band_hwc in read_bands(header, (self.window.top, self.window.bottom), band_bytes):
            kept_hwc = _columns(band_hwc, self.window)
            if header.dtype.kind == "f":
                kept_hwc = self.negatives.clip(kept_hwc, light, f"image {header.path}", row, self.window.left)
            if self.extremes:
                at = row - self.window.top
                self.extremes[light].take(
                    kept_hwc, None if self.mask_hw is None else self.mask_hw[at : at + len(kept_hwc)]
                )
            yield row - self.window.top, self.values.convert(kept_hwc, light)

    def extreme_notes(self, chosen: list[int]) -> Iterator[str]:
        """Yield which images are wholly black or white, as where a lamp failed, and what leaves them out."""
        sound = [light for light, each in zip(chosen, self.extremes, strict=True) if not (each.black or each.white)]
        subset = subset_text(sound)
        instead = f"; --subset {subset} leaves them out" if sound and len(subset) <= 60 else ""
        for what, why, found in (
            ("black", "did the light fail?", [each.black for each in self.extremes]),
            ("white", "is it overexposed?", [each.white for each in self.extremes]),
        ):
            names = [header.path.name for header, is_so in zip(self.headers, found, strict=True) if is_so]
            if names:
                which = f"{len(names)} images are" if len(names) > 1 else "1 image is"
                listed = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
                yield f"{which} wholly {what} ({why}): {listed}{instead}"


def place_crop(header: ImageHeader, crop: tuple[int, int, int, int] | None) -> Rectangle:
    """Return what a crop (x, y, width, height) keeps; InputError where it is empty or not within the images."""
    if crop is None:
        return Rectangle(0, 0, header.height, header.width)
    x, y, width, height = crop
    if min(x, y) < 0 or min(width, height) < 1 or x + width > header.width or y + height > header.height:
        raise InputError(
            f"crop x={x} y={y} width={width} height={height} is empty or not within the images of "
            f"{header.width}×{header.height} pixels"
        )
    return Rectangle(y, x, y + height, x + width)


def choose_values(
    table: LightTable, header: ImageHeader, chosen: list[int], transfer: str, peak: float | None, divide: bool
) -> Values:
    """Return how code values become those of the stack; `divide`: by the lights' intensities, where there are any."""
    code_peak = float(peak) if peak is not None else default_peak(header.dtype)
    if table.intensities_ic is None or not divide:
        return Values(header.dtype, code_peak, code_peak=code_peak)
    if transfer != "linear":
        raise InputError(f"light intensities divide linear values only, got transfer {transfer!r}: do not divide them")
    intensities = table.intensities_ic
    if intensities.shape[1] not in (1, header.channels):
        raise InputError(
            f"{table.source.parent} gives {intensities.shape[1]} intensities a light, but images have "
            f"{header.channels} channel: do not divide them"
        )
    relative = intensities.mean() / intensities
    factors_ic = relative / code_peak
    # Codes are integers, so the smallest value but 0 is that of code 1.
    in_half = factors_ic.min() >= _HALF_SMALLEST and factors_ic.max() * 255 <= _HALF_LARGEST
    dtype = np.dtype(np.float16 if header.dtype == np.uint8 and in_half else np.float32)
    return Values(dtype, 1.0, factors_ic[chosen].astype(np.float32), code_peak)


def keep_mask(
    path: Path | None, header: ImageHeader, window: Rectangle, memory_bytes: int
) -> tuple[NDArray[np.bool_] | None, list[str]]:
    """Return which of the pixels that are kept count, None without a mask, and what to say of it."""
    if path is None:
        return None, []
    whole_hw, notes = read_mask(path, (header.height, header.width), min(BAND_BYTES, memory_bytes // 2))
    mask_hw = np.ascontiguousarray(_columns(whole_hw[window.rows], window))
    if not mask_hw.any():
        raise InputError(f"mask {path} is zero everywhere in the pixels that are kept")
    return mask_hw, [f"mask {path.name} keeps {np.count_nonzero(mask_hw)} of {mask_hw.size} pixels", *notes]


def _columns(band_hwc: NDArray, window: Rectangle) -> NDArray:
    return band_hwc[:, window.columns]
