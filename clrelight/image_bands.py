"""Decoding rows of an open image file, and laying them as the picture has them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.image_header import VALUE_TYPES, ImageHeader

_TYPEDESC = dict(VALUE_TYPES.values())


def read_rows(
    reader: oiio.ImageInput, header: ImageHeader, first: int, last: int, rows: int
) -> Iterator[tuple[int, NDArray]]:
    """Yield rows first..last of a picture from top to bottom, `rows` at a time, each band with its first row."""
    if header.orientation > 4:
        whole_hwc = orient(_decode(reader, header, 0, header.stored_shape[0]), header.orientation)
        for start in range(first, last, rows):
            yield start, whole_hwc[start : min(start + rows, last)]
    elif header.orientation in (3, 4):
        height = header.height
        # From the last stored row up.
        for start, stop in reversed(_cut(height - last, height - first, rows, header.row_step, height)):
            band_hwc = orient(_decode(reader, header, start, stop), header.orientation)
            row = height - stop
            yield max(row, first), band_hwc[max(first - row, 0) : last - row]
    else:
        yield from _place(reader, header, first, last, rows)


def orient(stored_hwc: NDArray, orientation: int) -> NDArray:
    """Return pixels as EXIF's orientation says they are to be seen; the same, mirrored, turned, or all of it."""
    rows = slice(None, None, -1 if orientation in (3, 4, 6, 7) else 1)
    columns = slice(None, None, -1 if orientation in (2, 3, 7, 8) else 1)
    turned = stored_hwc[rows, columns]
    return np.ascontiguousarray(turned.swapaxes(0, 1) if orientation > 4 else turned)


def _cut(first: int, last: int, rows: int, step: int, height: int) -> list[tuple[int, int]]:
    """Return where bands of stored rows begin and end; whole tiles where there are tiles."""
    return [
        (start, min(start + rows, height if step > 1 else last)) for start in range(first - first % step, last, rows)
    ]


def _place(
    reader: oiio.ImageInput, header: ImageHeader, first: int, last: int, rows: int
) -> Iterator[tuple[int, NDArray]]:
    """Yield bands of a picture whose rows are stored from the top, with zeros where none are stored."""
    left, top, width, height = header.covers
    inside = min(max(top, first), last), min(max(top + height, first), last)
    yield from _zeros(header, first, inside[0], rows)
    skipped_x, skipped_y = (-min(at, 0) for at in header.origin_xy) if header.stored_hw else (0, 0)
    shift = skipped_y - top  # a row of the picture + shift is its stored row
    whole = (left, width, header.stored_shape[1]) == (0, header.width, header.width)
    begin, end = inside[0] + shift, inside[1] + shift
    for start, stop in _cut(begin, end, rows, header.row_step, header.stored_shape[0]) if begin < end else ():
        band_hwc = _decode(reader, header, start, stop)[max(begin - start, 0) : end - start]
        if header.orientation == 2:
            band_hwc = orient(band_hwc, 2)
        if not whole:
            placed_hwc = np.zeros((len(band_hwc), header.width, header.channels), header.dtype)
            placed_hwc[:, left : left + width] = band_hwc[:, skipped_x : skipped_x + width]
            band_hwc = placed_hwc
        yield max(start, begin) - shift, band_hwc
    yield from _zeros(header, inside[1], last, rows)


def _zeros(header: ImageHeader, first: int, last: int, rows: int) -> Iterator[tuple[int, NDArray]]:
    for row in range(first, last, rows):
        yield row, np.zeros((min(rows, last - row), header.width, header.channels), header.dtype)


def _decode(reader: oiio.ImageInput, header: ImageHeader, start: int, stop: int) -> NDArray:
    """Return stored rows with the picture's channels."""
    spec, wanted = reader.spec(), _TYPEDESC[header.dtype]
    first, last = header.span
    x, y, part = spec.x, spec.y, header.picture.part
    if spec.tile_width:
        window = (x, x + spec.width, y + start, y + stop, 0, 1)
        band = reader.read_tiles(part, 0, *window, first, last, wanted)
    else:
        band = reader.read_scanlines(part, 0, y + start, y + stop, 0, first, last, wanted)
    # A JPEG that is cut short yields gray rows and only leaves a message.
    message = reader.geterror()
    if band is None or message:
        raise InputError(f"cannot decode image {header.path}: {' '.join(message.split()) or 'no reason given'}")
    band_hwc = band.reshape(stop - start, spec.width, last - first)
    picks = [channel - first for channel in header.picture.channels]
    if picks != list(range(last - first)):
        band_hwc = band_hwc[..., picks]
    return header.radiance.to_rgb(band_hwc) if header.radiance and header.radiance.changes_values else band_hwc
