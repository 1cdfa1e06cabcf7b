"""What an image file says of itself: sizes, types, and how its rows and values are to be taken."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from clrelight.errors import InputError
from clrelight.image_colours import ImageColours, read_colours
from clrelight.image_parts import Picture
from clrelight.radiance_header import RadianceHeader

_PLAIN_PIXELS, _PLAIN_BYTES = 200_000_000, 1 << 30
_MOST_COMPRESSED = 200
"""More decoded bytes than so many times the file's, beyond plain sizes, are no photograph: those reach some tens."""

VALUE_TYPES: dict[str, tuple[np.dtype, Any]] = {
    "uint8": (np.dtype(np.uint8), oiio.UINT8),
    "uint16": (np.dtype(np.uint16), oiio.UINT16),
    "half": (np.dtype(np.float16), oiio.HALF),
    "float": (np.dtype(np.float32), oiio.FLOAT),
}
"""The types of values that are read, by OpenImageIO's names for them."""

_LOSSY = re.compile(r"jpeg|dwa|b44|pxr24|webp", re.IGNORECASE)
_ENVMAPS = {"CubeFace Environment": "cube", "LatLong Environment": "latlong"}
_FIRST_CHANNEL = Picture(0, (0,))
_NO_COLOURS = ImageColours()


@dataclass(frozen=True)
class ImageHeader:
    """What an image file says of itself, before any pixel is decoded.

    Attributes
    ----------
    path : Path
    height, width : int
        Size of the picture as it is read: upright where the format says how, an EXR's display window.
    channels : int
        1 or 3; alpha is not read.
    dtype : numpy.dtype
        uint8, uint16, float16 or float32.
    origin_xy : tuple of int
        Where the first stored pixel lies in the picture; not (0, 0) only for EXR data windows.
    row_step : int
        Rows that have to be decoded together: the height of a tile, of a picture that is stored by columns, or 1.
    stored_hw : tuple of int, optional
        Rows and columns that are stored (an EXR's data window); `height` and `width` where it is None.
    orientation : int
        EXIF number of how stored rows lie; applied, since TIFF and HDR define it.
    camera_orientation : int
        What a camera noted, which is not applied: looking down, it is at random.
    picture : Picture
        The part and channels that are read.
    radiance : RadianceHeader, optional
        What an HDR file says its values mean.
    is_lossy : bool
        Codes are only near to what was saved.
    envmap : str
        ``"cube"`` or ``"latlong"`` where an EXR says that it is such an environment map.
    colours : ImageColours
        What it says of its colours; nothing is converted.
    stored : str
        Sizes, names and types of what is stored, by which a file that changed is known.
    """

    path: Path
    height: int
    width: int
    channels: int
    dtype: np.dtype
    origin_xy: tuple[int, int]
    row_step: int
    stored_hw: tuple[int, int] | None = None
    orientation: int = 1
    camera_orientation: int = 1
    picture: Picture = _FIRST_CHANNEL
    radiance: RadianceHeader | None = None
    is_lossy: bool = False
    envmap: str = ""
    colours: ImageColours = _NO_COLOURS
    stored: str = ""

    @property
    def row_bytes(self) -> int:
        """Bytes of one decoded row."""
        first, last = self.span
        return max(self.width * self.channels, self.stored_shape[1] * (last - first)) * self.dtype.itemsize

    @property
    def span(self) -> tuple[int, int]:
        """First channel that is decoded, and the one behind the last."""
        return min(self.picture.channels), max(self.picture.channels) + 1

    @property
    def covers(self) -> tuple[int, int, int, int]:
        """Where pixels are stored, as (x, y, width, height) within the picture."""
        if self.stored_hw is None or self.orientation > 4:
            return 0, 0, self.width, self.height
        (height, width), (x, y) = self.stored_hw, self.origin_xy
        left, top = max(x, 0), max(y, 0)
        return left, top, min(x + width, self.width) - left, min(y + height, self.height) - top

    @property
    def notes(self) -> tuple[str, ...]:
        """How the file was understood, where that is not plain."""
        x, y, width, height = self.covers
        partial = (width, height) != (self.width, self.height)
        window = (f"only {width}×{height} pixels at ({x}, {y}) are stored, black around them",) if partial else ()
        turned = (f"turned as orientation {self.orientation} says",) if self.orientation != 1 else ()
        exposed = self.radiance.notes if self.radiance else ()
        return (*self.picture.notes, *window, *turned, *exposed, *self.colours.notes)

    @property
    def stored_shape(self) -> tuple[int, int]:
        """Rows and columns that are stored."""
        return self.stored_hw or (self.height, self.width)


def describe_file(
    path: Path, kind: str, spec: oiio.ImageSpec, picture: Picture, radiance: RadianceHeader | None
) -> ImageHeader:
    """Return the header of a file of OpenImageIO's format `kind`, of which `spec` describes the picture's part.

    Raises
    ------
    InputError
        Naming the file, if its pixels are not of the kinds that are read.
    """
    if spec.deep or spec.depth > 1:
        raise InputError(f"image {path} is deep or a volume, expected a flat picture")
    if "CMYK" in (spec.get_string_attribute("jpeg:ColorSpace"), spec.get_string_attribute("tiff:ColorSpace")):
        raise InputError(f"image {path} is CMYK, expected gray or RGB")
    noted = spec.get_int_attribute("Orientation")
    noted = noted if 1 <= noted <= 8 else 1
    orientation = radiance.orientation if radiance else noted if kind == "tiff" else 1
    height, width, origin, stored = spec.height, spec.width, (spec.x, spec.y), None
    if kind == "openexr" and (spec.full_width, spec.full_height, spec.full_x, spec.full_y) != (width, height, *origin):
        origin = (spec.x - spec.full_x, spec.y - spec.full_y)
        height, width, stored = spec.full_height, spec.full_width, (height, width)
    elif kind == "openexr":
        origin = (0, 0)
    if orientation > 4:
        height, width, stored = width, height, (height, width)
    return ImageHeader(
        path=path,
        height=height,
        width=width,
        channels=len(picture.channels),
        dtype=_value_type(path, spec, picture),
        origin_xy=origin,
        row_step=height if orientation > 4 else max(1, spec.tile_height if spec.tile_width else 1),
        stored_hw=stored,
        orientation=orientation,
        camera_orientation=noted if kind not in ("tiff", "openexr", "hdr") else 1,
        picture=picture,
        radiance=radiance,
        is_lossy=kind == "jpeg" or _LOSSY.match(spec.get_string_attribute("compression")) is not None,
        envmap=_ENVMAPS.get(spec.get_string_attribute("textureformat"), "") if kind == "openexr" else "",
        colours=read_colours(kind, spec),
        stored=describe_stored(spec),
    )


def _value_type(path: Path, spec: oiio.ImageSpec, picture: Picture) -> np.dtype:
    """Return the type that holds all channels of a picture: halves beside floats become floats."""
    formats = spec.channelformats or (spec.format,) * spec.nchannels
    types = {str(formats[i]) for i in picture.channels}
    if types == {"half", "float"}:
        types = {"float"}
    if len(types) > 1 or not types <= VALUE_TYPES.keys():
        raise InputError(f"image {path} stores {'/'.join(sorted(types))} values, expected {', '.join(VALUE_TYPES)}")
    return VALUE_TYPES[types.pop()][0]


def check_size(header: ImageHeader, spec: oiio.ImageSpec, max_pixels: int) -> None:
    """Raise InputError where a picture is absurdly large, or so much larger than its file that it is made to harm."""
    file_bytes = header.path.stat().st_size
    for height, width in ((header.height, header.width), (spec.height, spec.width)):
        if height < 1 or width < 1 or width * height > max_pixels:
            raise InputError(f"image {header.path} claims {width}×{height} pixels, more than {max_pixels}")
        decoded = width * height * spec.nchannels * header.dtype.itemsize
        if (width * height > _PLAIN_PIXELS or decoded > _PLAIN_BYTES) and decoded > _MOST_COMPRESSED * file_bytes:
            raise InputError(
                f"image {header.path} claims {width}×{height} pixels ({decoded >> 20} MiB) in {file_bytes} bytes, as "
                "no photograph does: if it is meant so, save it uncompressed"
            )
    if min(header.covers[2:]) < 1:
        raise InputError(f"image {header.path} stores no pixel of its display window, {header.width}×{header.height}")


def turn_upright(header: ImageHeader) -> ImageHeader:
    """Return the header of a picture that is turned as its camera noted."""
    noted = header.camera_orientation
    turned = replace(header, orientation=noted, camera_orientation=1)
    if noted <= 4:
        return turned
    stored = (header.height, header.width)
    return replace(turned, height=stored[1], width=stored[0], stored_hw=stored, row_step=stored[1])


def describe_stored(spec: oiio.ImageSpec) -> str:
    """Return what is stored in one text, by which a file that changed is known."""
    sizes = (spec.x, spec.y, spec.width, spec.height, spec.full_x, spec.full_y, spec.full_width, spec.full_height)
    types = (str(spec.format), *map(str, spec.channelformats))
    return repr((sizes, spec.tile_width, spec.tile_height, spec.channelnames, types))
