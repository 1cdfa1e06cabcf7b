"""Image files through OpenImageIO: stored values at their own depth, read in bands, written whole or not at all."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.store.durable import replacing

IMAGE_EXTENSIONS = frozenset(
    (".bmp", ".exr", ".hdr", ".jpeg", ".jpg", ".pfm", ".pgm", ".png", ".pnm", ".ppm", ".tga", ".tif", ".tiff")
)
"""What counts as an image when a folder is listed; a file named by the user is tried whatever it is called."""

MAX_PIXELS = 1 << 31
BAND_BYTES = 8 << 20
"""Size of a band where the caller gives none: enough for the decoders that use several threads."""

_FORMATS: dict[str, tuple[np.dtype, Any]] = {
    "uint8": (np.dtype(np.uint8), oiio.UINT8),
    "uint16": (np.dtype(np.uint16), oiio.UINT16),
    "half": (np.dtype(np.float16), oiio.HALF),
    "float": (np.dtype(np.float32), oiio.FLOAT),
}
_TYPEDESC = dict(_FORMATS.values())
# What each extension can store without a change of values: the array's type, and the type in the file.
_WRITABLE: dict[str, dict[str, Any]] = {
    ".exr": {"float16": oiio.HALF, "float32": oiio.FLOAT},
    ".tif": {"uint8": oiio.UINT8, "uint16": oiio.UINT16, "float16": oiio.FLOAT, "float32": oiio.FLOAT},
    ".hdr": {"float16": oiio.FLOAT, "float32": oiio.FLOAT},
    ".png": {"uint8": oiio.UINT8, "uint16": oiio.UINT16},
    ".jpg": {"uint8": oiio.UINT8},
    ".bmp": {"uint8": oiio.UINT8},
    ".tga": {"uint8": oiio.UINT8},
    ".ppm": {"uint8": oiio.UINT8, "uint16": oiio.UINT16},
    ".pgm": {"uint8": oiio.UINT8, "uint16": oiio.UINT16},
}
_SYNONYMS = {".tiff": ".tif", ".jpeg": ".jpg"}
_ONLY_CHANNELS = {".hdr": 3, ".ppm": 3, ".pgm": 1}


@dataclass(frozen=True)
class ImageHeader:
    """What an image file says of itself, before any pixel is decoded.

    Attributes
    ----------
    path : Path
    height, width : int
        Size of the stored pixels (the data window of an EXR), at most `MAX_PIXELS` in all.
    channels : int
        1 or 3; an alpha channel and whatever follows R, G, B are not read.
    dtype : numpy.dtype
        uint8, uint16, float16 or float32.
    origin_xy : tuple of int
        Where the first stored pixel lies in the picture; not (0, 0) only for EXR data windows.
    row_step : int
        Rows that have to be decoded together: the height of a tile, or 1.
    """

    path: Path
    height: int
    width: int
    channels: int
    dtype: np.dtype
    origin_xy: tuple[int, int]
    row_step: int

    @property
    def row_bytes(self) -> int:
        """Bytes of one decoded row."""
        return self.width * self.channels * self.dtype.itemsize


def read_header(path: str | os.PathLike[str]) -> ImageHeader:
    """Return the header of an image; InputError if it is missing, no image, or holds what we do not read."""
    reader, header = _open(Path(path))
    reader.close()
    return header


def read_image(path: str | os.PathLike[str]) -> NDArray:
    """Return all stored values of an image.

    Only the first picture of a file that has several is read. Values are never changed by alpha, colour-space
    hints or orientation; codes of odd depths (1, 2, 4, 10, 12 bit, other PNM maxima) arrive scaled to 8 or 16 bit.

    Returns
    -------
    ndarray, shape (height, width, 1 or 3), uint8, uint16, float16 or float32

    Raises
    ------
    InputError
        Naming the file, if it is missing, damaged, cut short, or not of these types and channels.
    """
    header = read_header(path)
    image_hwc = np.empty((header.height, header.width, header.channels), header.dtype)
    for row, band_hwc in read_bands(header):
        image_hwc[row : row + len(band_hwc)] = band_hwc
    return image_hwc


def read_bands(
    header: ImageHeader, rows: tuple[int, int] | None = None, band_bytes: int = BAND_BYTES
) -> Iterator[tuple[int, NDArray]]:
    """Decode an image from top to bottom, once, a band of rows at a time.

    Parameters
    ----------
    header : ImageHeader
        From `read_header`; the file must still be like this.
    rows : (int, int), optional
        First row and the row behind the last; all by default.
    band_bytes : int
        Bytes of a band; exceeded only where ``header.row_step`` rows alone are larger.

    Yields
    ------
    row : int
        First row of the band.
    band_hwc : ndarray, shape (rows, width, channels), ``header.dtype``

    Raises
    ------
    InputError
        Naming the file, if it is damaged or cut short, or has changed since its header was read.
    """
    first, last = rows if rows is not None else (0, header.height)
    step = header.row_step
    band_rows = max(1, band_bytes // (header.row_bytes * step)) * step
    reader, now = _open(header.path)
    try:
        if now != header:
            raise InputError(f"image {header.path} changed while it was read")
        for start in range(first - first % step, last, band_rows):
            stop = min(start + band_rows, header.height if step > 1 else last)
            band_hwc = _decode(reader, header, start, stop)[max(first - start, 0) : last - start]
            yield max(start, first), band_hwc
    finally:
        reader.close()


def write_image(path: str | os.PathLike[str], values_hwc: NDArray) -> None:
    """Write values as they are, under a temporary name that becomes the right one when the file is whole.

    Floats (linear radiance) go to ``.exr`` (float16, float32), ``.tif`` (as float32) and ``.hdr`` (3 channels;
    the format itself keeps 8 bits); display codes to ``.png``, ``.tif``, ``.ppm``, ``.pgm`` (uint8, uint16),
    ``.jpg``, ``.bmp``, ``.tga`` (uint8). Nothing is scaled or sent through a transfer curve here.

    Parameters
    ----------
    path : path
        Its extension chooses the format.
    values_hwc : ndarray, shape (height, width, 1 or 3) or (height, width)
        Of a type that the format holds.

    Raises
    ------
    InputError
        If the extension is not known, it cannot hold these values, or the file cannot be written.
    """
    path = Path(path)
    values = np.asarray(values_hwc)
    values = values[..., None] if values.ndim == 2 else values
    extension = _SYNONYMS.get(path.suffix.lower(), path.suffix.lower())
    if extension not in _WRITABLE:
        raise InputError(f"cannot write {path}: extension {path.suffix!r} is none of {', '.join(_WRITABLE)}")
    if values.ndim != 3 or values.shape[2] not in (1, 3) or values.size == 0:
        raise InputError(f"an image to write must be (height, width, 1 or 3), got shape {values.shape}")
    if values.dtype.name not in _WRITABLE[extension]:
        fitting = [known for known, types in _WRITABLE.items() if values.dtype.name in types]
        advice = f"{values.dtype} goes to {', '.join(fitting)}" if fitting else f"{values.dtype} goes to no format"
        raise InputError(f"cannot write {path}: {extension} holds {', '.join(_WRITABLE[extension])}; {advice}")
    if values.shape[2] != _ONLY_CHANNELS.get(extension, values.shape[2]):
        raise InputError(
            f"cannot write {path}: {extension} holds {_ONLY_CHANNELS[extension]} channels, got {values.shape[2]}"
        )
    with replacing(path) as part:
        try:
            _encode(part.path, extension, np.ascontiguousarray(values), _WRITABLE[extension][values.dtype.name])
        except (OSError, RuntimeError) as error:
            raise InputError(f"cannot write {path}: {_one_line(error)}") from None


def _open(path: Path) -> tuple[oiio.ImageInput, ImageHeader]:
    if not path.is_file():
        raise InputError(f"there is no image {path}")
    try:
        _check_png_end(path)
    except OSError as error:
        raise InputError(f"cannot read image {path}: {error.strerror}") from None
    hints = oiio.ImageSpec()
    # Otherwise colours come multiplied by alpha, and rounded.
    hints.attribute("oiio:UnassociatedAlpha", 1)
    reader = oiio.ImageInput.open(_text_name(path), hints)
    if reader is None:
        raise InputError(f"cannot read image {path}: {_one_line(oiio.geterror())}")
    try:
        return reader, _header(path, reader.spec())
    except InputError:
        reader.close()
        raise


def _header(path: Path, spec: oiio.ImageSpec) -> ImageHeader:
    if spec.width * spec.height > MAX_PIXELS:
        raise InputError(f"image {path} claims {spec.width}×{spec.height} pixels, more than {MAX_PIXELS}")
    if spec.deep or spec.depth > 1:
        raise InputError(f"image {path} is deep or a volume, expected a flat picture")
    if "CMYK" in (spec.get_string_attribute("jpeg:ColorSpace"), spec.get_string_attribute("tiff:ColorSpace")):
        raise InputError(f"image {path} is CMYK, expected gray or RGB")
    names = [name.upper() for name in spec.channelnames]
    if names[:3] == ["R", "G", "B"]:
        channels = 3
    elif len(names) == 1 or (len(names) == 2 and spec.alpha_channel == 1):
        channels = 1
    else:
        raise InputError(f"image {path} has channels {', '.join(spec.channelnames)}, expected gray or R, G, B")
    types = {str(t) for t in (spec.channelformats or (spec.format,))[:channels]}
    if len(types) > 1 or not types <= _FORMATS.keys():
        raise InputError(f"image {path} stores {'/'.join(sorted(types))} values, expected {', '.join(_FORMATS)}")
    return ImageHeader(
        path=path,
        height=spec.height,
        width=spec.width,
        channels=channels,
        dtype=_FORMATS[types.pop()][0],
        origin_xy=(spec.x, spec.y),
        row_step=max(1, spec.tile_height if spec.tile_width else 1),
    )


def _decode(reader: oiio.ImageInput, header: ImageHeader, start: int, stop: int) -> NDArray:
    x, y = header.origin_xy
    wanted = _TYPEDESC[header.dtype]
    if reader.spec().tile_width:
        window = (x, x + header.width, y + start, y + stop, 0, 1)
        band = reader.read_tiles(*window, 0, header.channels, wanted)
    else:
        band = reader.read_scanlines(y + start, y + stop, 0, 0, header.channels, wanted)
    # A JPEG that is cut short yields gray rows and only leaves a message.
    message = reader.geterror()
    if band is None or message:
        raise InputError(f"cannot decode image {header.path}: {_one_line(message) or 'no reason given'}")
    return band.reshape(stop - start, header.width, header.channels)


def _encode(path: Path, extension: str, values: NDArray, stored: Any) -> None:
    writer = oiio.ImageOutput.create(extension.removeprefix("."))  # not by the path, which ends in .part
    if writer is None:
        raise RuntimeError(oiio.geterror())
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], stored)
    if extension == ".jpg":
        spec.attribute("CompressionQuality", 95)
        spec.attribute("jpeg:subsampling", "4:4:4")
    done = writer.open(_text_name(path), spec) and writer.write_image(values)
    message = writer.geterror()
    # Closing flushes what is left, so it can fail too.
    if not writer.close() or not done:
        raise RuntimeError(message or writer.geterror() or "no reason given")


def _check_png_end(path: Path) -> None:
    """Raise InputError if a PNG is cut short: found in microseconds, and libpng would print to stderr."""
    with open(path, "rb", buffering=0) as file:
        if file.read(8) != b"\x89PNG\r\n\x1a\n":
            return
        size, at, kind = path.stat().st_size, 8, b""
        while kind != b"IEND":
            file.seek(at)
            head = file.read(8)
            length, kind = struct.unpack(">I4s", head) if len(head) == 8 else (0, b"")
            at += 12 + length
            if at > size or not kind:
                raise InputError(f"cannot decode image {path}: the PNG is cut short at {size} bytes")


def _text_name(path: Path) -> str:
    name = str(path)
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(f"images need names in UTF-8, for OpenImageIO takes no others: rename {name!r}") from None
    return name


def _one_line(message: object) -> str:
    return " ".join(str(message).split())
