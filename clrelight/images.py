"""Image files through OpenImageIO: stored values at their own depth, read in bands, written whole or not at all."""

from __future__ import annotations

import os
import shutil
import struct
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from clrelight.durable import naming, replacing
from clrelight.errors import InputError
from clrelight.image_bands import read_rows
from clrelight.image_encoding import EncodingError, encoding, one_line, text_name
from clrelight.image_header import ImageHeader, check_size, describe_file, describe_stored, turn_upright
from clrelight.image_parts import choose_picture
from clrelight.image_sink import sink_for
from clrelight.radiance_header import RadianceHeader, read_radiance_header

IMAGE_EXTENSIONS = frozenset(
    (".bmp", ".exr", ".hdr", ".jpeg", ".jpg", ".pfm", ".pgm", ".png", ".pnm", ".ppm", ".tga", ".tif", ".tiff")
)
"""What counts as an image when a folder is listed; a file named by the user is tried whatever it is called."""

_CURES = dict.fromkeys(
    (".arw", ".cr2", ".cr3", ".dng", ".iiq", ".nef", ".nrw", ".orf", ".pef", ".raf", ".rw2", ".srw", ".x3f"),
    "is a camera's raw file: only its preview could be read; develop it to 16-bit TIFF with a linear curve",
) | dict.fromkeys((".heic", ".heif", ".avif"), "is of a format that is not read: save it as 16-bit TIFF or PNG")
"""What to do about files of formats that people have and that are not read; some raw files are TIFFs by their form."""

MAX_PIXELS = 1 << 31
BAND_BYTES = 8 << 20
"""Size of a band where the caller gives none: enough for the decoders that use several threads."""

_PARTED = ("openexr", "tiff")
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


def read_header(path: str | os.PathLike[str], *, layer: str | None = None, upright: bool = False) -> ImageHeader:
    """Return the header of an image; InputError if it is missing, no image, or holds what we do not read.

    Parameters
    ----------
    path : path
    layer : str, optional
        Which layer of an EXR or page of a TIFF; see `choose_picture`.
    upright : bool
        Apply the orientation that a camera noted.
    """
    path = Path(os.fsdecode(path))
    with _opened(path) as (reader, radiance):
        specs = [reader.spec()]
        while reader.format_name() in _PARTED and reader.seek_subimage(len(specs), 0):
            specs.append(reader.spec())
        reader.geterror()  # that there is no further part
        picture = choose_picture(f"image {path}", specs, is_exr=reader.format_name() == "openexr", layer=layer)
        header = describe_file(path, reader.format_name(), specs[picture.part], picture, radiance)
        check_size(header, specs[picture.part], MAX_PIXELS)
    return turn_upright(header) if upright and header.camera_orientation != 1 else header


def read_image(path: str | os.PathLike[str] | ImageHeader) -> NDArray:
    """Return the picture of an image file, or of one whose header is known.

    Values are not changed by alpha or colour-space hints; codes of odd depths (1, 2, 4, 10, 12 bit, other PNM maxima)
    arrive scaled to 8 or 16 bit. What the format defines is applied: TIFF's orientation, the order of rows and columns
    and the exposure of HDR, an EXR's windows (pixels that are not stored are 0).

    Returns
    -------
    ndarray, shape (height, width, 1 or 3), uint8, uint16, float16 or float32

    Raises
    ------
    InputError
        Naming the file, if it is missing, damaged, cut short, or not of these types and channels.
    """
    header = path if isinstance(path, ImageHeader) else read_header(path)
    image_hwc = np.empty((header.height, header.width, header.channels), header.dtype)
    for row, band_hwc in read_bands(header):
        image_hwc[row : row + len(band_hwc)] = band_hwc
    return image_hwc


def read_alpha(header: ImageHeader) -> NDArray:
    """Return the alpha channel of an image that has one, as (height, width)."""
    alpha = header.picture.alpha
    if alpha is None:
        raise InputError(f"image {header.path} has no alpha channel")
    picture = replace(header.picture, channels=(alpha,))
    bands = read_bands(replace(header, picture=picture, channels=1, radiance=None))
    return np.concatenate([band_hwc[..., 0] for _, band_hwc in bands])


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
    with _opened(header.path, with_pixels=True) as (reader, _):
        if not reader.seek_subimage(header.picture.part, 0) or describe_stored(reader.spec()) != header.stored:
            raise InputError(f"image {header.path} changed while it was read")
        yield from read_rows(reader, header, first, last, band_rows)


def write_image(path: str | os.PathLike[str], values_hwc: NDArray) -> None:
    """Write values as they are, under a temporary name that becomes the right one when the file is whole.

    Floats (linear radiance) go to ``.exr`` (float16, float32; any number of channels), ``.tif`` (as float32) and
    ``.hdr`` (3 channels; the format itself keeps 8 bits); display codes to ``.png``, ``.tif``, ``.ppm``, ``.pgm``
    (uint8, uint16), ``.jpg``, ``.bmp``, ``.tga`` (uint8). Nothing is scaled or sent through a transfer curve here.

    Parameters
    ----------
    path : path
        Its extension chooses the format.
    values_hwc : ndarray, shape (height, width, 1 or 3) or (height, width); in ``.exr`` (height, width, any)
        Of a type that the format holds.

    Raises
    ------
    InputError
        If the extension is not known, it cannot hold these values, or the file cannot be written.
    """
    path = Path(os.fsdecode(path))
    values = np.asarray(values_hwc)
    values = values[..., None] if values.ndim == 2 else values
    extension = _SYNONYMS.get(path.suffix.lower(), path.suffix.lower())
    if extension not in _WRITABLE:
        raise InputError(f"cannot write {path}: extension {path.suffix!r} is none of {', '.join(_WRITABLE)}")
    if values.ndim != 3 or values.size == 0:
        raise InputError(f"an image to write must be (height, width, channel), got shape {values.shape}")
    if values.shape[2] not in (1, 3) and extension != ".exr":
        raise InputError(f"cannot write {path}: {values.shape[2]} channels go to .exr, others hold 1 or 3")
    if values.dtype.name not in _WRITABLE[extension]:
        fitting = [known for known, types in _WRITABLE.items() if values.dtype.name in types]
        advice = f"{values.dtype} goes to {', '.join(fitting)}" if fitting else f"{values.dtype} goes to no format"
        raise InputError(f"cannot write {path}: {extension} holds {', '.join(_WRITABLE[extension])}; {advice}")
    if values.shape[2] != _ONLY_CHANNELS.get(extension, values.shape[2]):
        raise InputError(
            f"cannot write {path}: {extension} holds {_ONLY_CHANNELS[extension]} channels, got {values.shape[2]}"
        )
    with replacing(path) as part, naming(path), sink_for(part, extension, values.nbytes) as name:
        try:
            _encode(name, extension, np.ascontiguousarray(values), _WRITABLE[extension][values.dtype.name])
        except EncodingError as error:
            raise InputError(f"cannot write {path}: {one_line(error)}") from None


@contextmanager
def _opened(path: Path, *, with_pixels: bool = False) -> Iterator[tuple[oiio.ImageInput, RadianceHeader | None]]:
    """Lend an open file, and what it says where it is a Radiance picture."""
    if not path.is_file():
        raise InputError(f"there is no image {path}")
    if path.suffix.lower() in _CURES:
        raise InputError(f"image {path} {_CURES[path.suffix.lower()]}")
    try:
        _check_png(path, with_pixels=with_pixels)
        with open(path, "rb") as file, _plain_radiance(file, path) as (name, radiance):
            reader = _open(name, path)
            try:
                yield reader, radiance
            finally:
                reader.close()
    except OSError as error:
        raise InputError(f"cannot read image {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        # OpenImageIO repeats what a file says in its messages, and names of channels.
        raise InputError(f"cannot read image {path}: it is damaged, or names in it are not UTF-8") from None


def _open(name: str, path: Path) -> oiio.ImageInput:
    hints = oiio.ImageSpec()
    # Otherwise colours come multiplied by alpha, and rounded.
    hints.attribute("oiio:UnassociatedAlpha", 1)
    reader = oiio.ImageInput.open(text_name(name), hints)
    if reader is None:
        raise InputError(f"cannot read image {path}: {one_line(oiio.geterror()).replace(name, str(path))}")
    return reader


@contextmanager
def _plain_radiance(file: BinaryIO, path: Path) -> Iterator[tuple[str, RadianceHeader | None]]:
    """Lend the name of a file that OpenImageIO opens, and what a Radiance picture says.

    It reads neither XYZE nor files without a format, whose pixels are stored like any: these are lent as a copy.
    """
    radiance = read_radiance_header(file, path)
    if radiance is None or radiance.names_format:
        yield str(path), radiance
        return
    with tempfile.NamedTemporaryFile(suffix=".hdr") as copy:
        file.seek(radiance.size_at)
        copy.write(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n")
        shutil.copyfileobj(file, copy)
        copy.flush()
        yield copy.name, radiance


def _encode(name: str, extension: str, values: NDArray, stored: Any) -> None:
    with encoding(name, extension, values.shape, stored) as put:
        put(values)


def _check_png(path: Path, *, with_pixels: bool) -> None:
    """Raise InputError if a PNG is cut short or damaged: libpng would print that to stderr besides.

    Checksums of pixels are taken only where pixels are wanted; that is much faster than to decode them.
    """
    with open(path, "rb") as file:
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
            if kind != b"IDAT" or with_pixels:
                _check_png_chunk(file, path, kind, length)


def _check_png_chunk(file: BinaryIO, path: Path, kind: bytes, length: int) -> None:
    found, left = zlib.crc32(kind), length
    while left:
        piece = file.read(min(left, BAND_BYTES))
        if not piece:
            break
        found, left = zlib.crc32(piece, found), left - len(piece)
    if file.read(4) != struct.pack(">I", found):
        raise InputError(f"cannot decode image {path}: the PNG is damaged, its chunk {kind!r} has another checksum")
