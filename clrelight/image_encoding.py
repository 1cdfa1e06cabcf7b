"""What OpenImageIO is told of pictures that it encodes, whole or rows one after another."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from clrelight.durable import naming, replacing
from clrelight.errors import InputError, counted
from clrelight.image_sink import sink_for

_LARGE_PIXELS = 1 << 22  # from so many on a picture is packed fast rather than well


class EncodingError(RuntimeError):
    """An encoder refuses a picture; of what goes wrong while its rows are made others tell."""


@contextmanager
def encoding(name: str, extension: str, shape_hwc: tuple[int, ...], stored: Any) -> Iterator[Callable[[NDArray], None]]:
    """Lend what takes bands of rows, from top to bottom, and encodes them to a file of a name.

    EncodingError says why that did not do.
    """
    writer = oiio.ImageOutput.create(extension.removeprefix("."))  # not by the name, which has no such ending
    if writer is None:
        raise EncodingError(oiio.geterror())
    height, width, channels = shape_hwc
    spec = oiio.ImageSpec(width, height, channels, stored)
    spec.attribute("DateTime", "0000:00:00 00:00:00")  # else EXR and TIFF get today's: never the same bytes twice
    if channels not in (1, 3):
        # Otherwise the fourth is alpha.
        spec.channelnames = tuple(f"band{i:03}" for i in range(channels))
        spec.alpha_channel = -1
    if height * width >= _LARGE_PIXELS:
        _pack_fast(spec, extension, is_float=stored == oiio.FLOAT)
    if extension == ".jpg":
        spec.attribute("CompressionQuality", 95)
        spec.attribute("jpeg:subsampling", "4:4:4")
    if not writer.open(text_name(name), spec):
        raise EncodingError(writer.geterror() or "no reason given")
    row, done = 0, True

    def put(band_hwc: NDArray) -> None:
        nonlocal row, done
        end = row + len(band_hwc)
        whole = len(band_hwc) == height
        done &= writer.write_image(band_hwc) if whole else writer.write_scanlines(row, end, 0, band_hwc)
        row = end

    try:
        yield put
    finally:
        came = row
        if done and row < height:  # libpng would print that some are missing
            put(np.zeros((height - row, width, channels), np.uint8))
        message = writer.geterror()
        # Closing flushes what is left, so it can fail too.
        closed = writer.close()
    if came < height:
        raise EncodingError(f"{came} of {counted(height, 'row')} came")
    if not closed or not done:
        raise EncodingError(message or writer.geterror() or "no reason given")


def _pack_fast(spec: oiio.ImageSpec, extension: str, *, is_float: bool) -> None:
    """Say how a picture of many pixels is packed: in time that is no more than that of making it."""
    if extension == ".png":
        spec.attribute("compression", "rle")  # a third of the time that a search takes, and 6% fewer bytes
        spec.attribute("png:filter", 0x40)  # average: faster than Paeth, and photographs get smaller
    if extension == ".tif" and is_float:
        spec.attribute("compression", "none")  # deflate takes 60 times as long for 27% fewer bytes, at its one level
    if extension == ".exr":
        spec.attribute("compression", "zip:1")  # three quarters of the time of level 4, and 1 to 2% more bytes


@contextmanager
def png_rows(
    path: str | os.PathLike[str], shape_hwc: tuple[int, int, int]
) -> Iterator[Callable[[NDArray[np.uint8]], None]]:
    """Lend what takes bands of rows of a PNG, C-contiguous, which `clrelight.images.write_image` would write whole.

    While one band is made another may be packed, and a picture of many megapixels need not be held.
    """
    path = Path(os.fsdecode(path))
    with replacing(path) as part, naming(path), sink_for(part, ".png", math.prod(shape_hwc)) as name:
        try:
            with encoding(name, ".png", shape_hwc, oiio.UINT8) as put:
                yield put
        except EncodingError as error:
            raise InputError(f"cannot write {path}: {one_line(error)}") from None


def text_name(name: str) -> str:
    """Return a name; InputError where it is not UTF-8."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(f"images need names in UTF-8, for OpenImageIO takes no others: rename {name!r}") from None
    return name


def one_line(message: object) -> str:
    """Return what OpenImageIO says in one line."""
    return " ".join(str(message).split())
