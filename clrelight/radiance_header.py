"""The text before the pixels of Radiance's ``.hdr`` pictures: what values mean, and how rows and columns run."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

_MAX_TEXT = 1 << 16
_SIZE = re.compile(rb"([+-][XY]) +(\d+) +([+-][XY]) +(\d+)\s*")
# Which EXIF orientation turns rows as they are stored to rows from the top (Ward, "Real pixels": the first axis is
# that of the scanlines; -Y runs from the top down, +X from the left to the right).
_ORIENTATIONS = {
    (b"-Y", b"+X"): 1,
    (b"-Y", b"-X"): 2,
    (b"+Y", b"-X"): 3,
    (b"+Y", b"+X"): 4,
    (b"+X", b"-Y"): 5,
    (b"-X", b"-Y"): 6,
    (b"-X", b"+Y"): 7,
    (b"+X", b"+Y"): 8,
}
# Linear Rec. 709 (D65) from CIE XYZ, IEC 61966-2-1.
_RGB_FROM_XYZ = (
    (3.2406255, -1.5372080, -0.4986286),
    (-0.9689307, 1.8757561, 0.0415175),
    (0.0557101, -0.2040211, 1.0569959),
)


@dataclass(frozen=True)
class RadianceHeader:
    """What the text says.

    Attributes
    ----------
    orientation : int
        EXIF orientation that brings the stored rows to rows from the top.
    factors : tuple of float
        What R, G and B are multiplied with: 1 over all EXPOSURE and COLORCORR.
    is_xyz : bool
        Values are CIE XYZ (``32-bit_rle_xyze``).
    names_format : bool
        There is a FORMAT line that says RGBE, without which OpenImageIO reads nothing.
    size_at : int
        Where the line with the size begins.
    notes : tuple of str
    """

    orientation: int
    factors: tuple[float, float, float]
    is_xyz: bool
    names_format: bool
    size_at: int
    notes: tuple[str, ...]

    @property
    def changes_values(self) -> bool:
        """Whether `to_rgb` does anything."""
        return self.is_xyz or self.factors != (1.0, 1.0, 1.0)

    def to_rgb(self, values_hwc: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return linear R, G, B with the exposure taken out."""
        with np.errstate(over="ignore", invalid="ignore"):  # who reads radiance refuses what is not finite
            scaled = values_hwc * np.asarray(self.factors, np.float32)
            return scaled @ np.asarray(_RGB_FROM_XYZ, np.float32).T if self.is_xyz else scaled


def read_radiance_header(file: BinaryIO, path: Path) -> RadianceHeader | None:
    """Return the header of an open file, or None where it is no Radiance picture.

    Raises
    ------
    InputError
        If it cannot be understood, or values are gamma corrected.
    """
    file.seek(0)
    text = file.read(_MAX_TEXT)
    if not text.startswith(b"#?"):
        return None
    end = re.search(rb"\n\r?\n", text)
    match = _SIZE.match(text, end.end()) if end else None
    if end is None or match is None or (match[1], match[3]) not in _ORIENTATIONS:
        raise InputError(f"cannot read image {path}: no line such as '-Y 512 +X 1024' follows its header")
    fields = re.findall(rb"(?m)^([A-Z]+)[ \t]*=[ \t]*(.*?)\s*$", text[: end.end()])
    factors, notes = np.ones(3), []
    for name, value in fields:
        if name in (b"EXPOSURE", b"COLORCORR"):
            factors /= _positive(name, value, path)
    if np.any(factors != 1.0):
        notes.append("divided by the header's exposure")
    for name, value in fields:
        if name == b"GAMMA" and np.any(_positive(name, value, path) != 1.0):
            raise InputError(f"image {path} says GAMMA={value.decode()}: expected linear values")
    formats = [value for name, value in fields if name == b"FORMAT"]
    is_xyz = b"32-bit_rle_xyze" in formats
    if formats and not is_xyz and b"32-bit_rle_rgbe" not in formats:
        raise InputError(
            f"image {path} has format {formats[0].decode(errors='replace')!r}, expected 32-bit_rle_rgbe or xyze"
        )
    if is_xyz:
        notes.append("XYZ is taken to linear Rec. 709")
    return RadianceHeader(
        orientation=_ORIENTATIONS[match[1], match[3]],
        factors=(float(factors[0]), float(factors[1]), float(factors[2])),
        is_xyz=is_xyz,
        names_format=b"32-bit_rle_rgbe" in formats,
        size_at=end.end(),
        notes=tuple(notes),
    )


def _positive(name: bytes, value: bytes, path: Path) -> NDArray[np.float64]:
    try:
        numbers = np.array([float(part) for part in value.split()])
    except ValueError:
        numbers = np.zeros(0)
    if numbers.size not in (1, 3) or not all(math.isfinite(number) and number > 0 for number in numbers):
        raise InputError(
            f"image {path} says {name.decode()}={value.decode(errors='replace')}, expected a number above 0"
        )
    return np.broadcast_to(numbers, 3)
