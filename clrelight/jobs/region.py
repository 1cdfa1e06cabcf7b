"""Parts of an image, and images at lower resolution: what files of units give without reading all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clrelight.codec import decode
from clrelight.codec.entropy.units import LEVELS, PRECINCT, low_side
from clrelight.codec.views import Region
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.jobs.inputs import Packed, whole
from clrelight.tiles import read_tile

_COLUMNS = 64
"""Columns of tiles are a multiple of this."""


@dataclass(frozen=True)
class Part:
    """What of an image is asked for.

    Attributes
    ----------
    box : tuple of int, optional
        Column and row of the first pixel, width and height, in pixels of the whole image; None: all of it.
    level : int
        How often width and height are halved.
    """

    box: tuple[int, int, int, int] | None = None
    level: int = 0

    @property
    def is_all(self) -> bool:
        """Whether nothing is left out."""
        return self.box is None and self.level == 0

    def of(self, height: int, width: int) -> Region:
        """Return the part of an image of a size; InputError where it has none there."""
        x, y, w, h = self.box or (0, 0, width, height)
        if x + w > width or y + h > height:
            raise InputError(f"region {x},{y},{w},{h} does not lie in an image of {width} x {height} pixels")
        bottom, right = low_side(y + h, self.level), low_side(x + w, self.level)
        return Region(y >> self.level, x >> self.level, bottom, right, self.level)


def list_tiles(height: int, width: int, pixel_bytes: int, most_bytes: int) -> list[Region]:
    """Return parts that are an image together, rows first, each of about so many bytes and of a precinct's height."""
    columns = max(most_bytes // (pixel_bytes * min(PRECINCT, height)) // _COLUMNS, 1) * _COLUMNS
    return [
        Region(top, left, min(top + PRECINCT, height), min(left + columns, width))
        for top in range(0, height, PRECINCT)
        for left in range(0, width, columns)
    ]


def take_part(region: Sequence[int] | None, level: int) -> Part:
    """Return what is asked for; InputError where it makes no sense."""
    depth = whole(level, "level")
    if not 0 <= depth <= LEVELS:
        raise InputError(f"level must be 0 to {LEVELS}, got {level}")
    if region is None:
        return Part(None, depth)
    numbers = [whole(each, "region") for each in region]
    if len(numbers) != 4 or min(numbers[:2]) < 0 or min(numbers[2:]) < 1:
        raise InputError(f"region must be X,Y,WIDTH,HEIGHT, the last two 1 or more, got {','.join(map(str, region))}")
    return Part((numbers[0], numbers[1], numbers[2], numbers[3]), depth)


def refuse_level(part: Part, what: str) -> None:
    """Raise InputError if a lower resolution is asked of what has none."""
    if part.level:
        raise InputError(f"{what} holds no levels of resolution: files that codec klt writes now do")


def crop(coefficients: CoefficientMap, part: Part) -> CoefficientMap:
    """Return a part of a fit at full resolution: without the surface, of which it has not all vertices."""
    region = part.of(*coefficients.image_shape[:2])
    stored = coefficients.coeffs_khwc
    part_khwc = read_tile(stored, region, np.empty((stored.shape[0], *region.shape, stored.shape[3]), stored.dtype))
    return FitRecord.of(coefficients).without_surface().to_map(part_khwc.astype(np.float32, copy=False))


def decode_part(packed: Packed, part: Part, device: Device) -> CoefficientMap:
    """Return a part of an encoded fit; of files in units, only what it hangs on is decoded."""
    encoded, record = packed.encoded, packed.record
    regions, region = packed.regions(), part.of(*encoded.shape[1:3])
    if regions is not None:
        return replace(record, surface=None).to_map(regions.coefficients(region, device))
    refuse_level(part, f"an encoding by {encoded.codec}")
    return crop(record.to_map(decode(encoded, device)), part)
