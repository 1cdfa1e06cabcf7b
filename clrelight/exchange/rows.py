"""Rows of planes that lie in images or tiles: read as they are asked for, from the top down."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, counted
from clrelight.exchange.pyramid import Cut
from clrelight.image_sink import named_content
from clrelight.images import read_bands, read_header, read_image

_BAND_BYTES = 1 << 20
"""Of each image, that are decoded at a time."""


class Rows(Protocol):
    """What is sliced by rows: an array, or something that reads."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Height, width and planes."""

    def __getitem__(self, rows: slice, /) -> NDArray[np.uint8]:
        """Return rows, (row, width, plane), uint8."""


class ImageRows:
    """Colour images of 8 bits and one size, three planes each.

    InputError if they are not, or one is missing.
    """

    def __init__(self, files: list[Path]) -> None:
        self._headers = [read_header(file) for file in files]
        first = self._headers[0]
        for header in self._headers:
            if header.dtype != np.uint8 or header.channels != 3:
                raise InputError(f"{header.path}: planes must be colour images of 8 bits")
            if (header.height, header.width) != (first.height, first.width):
                raise InputError(
                    f"{header.path} has {header.width} × {header.height} pixels, {_sides(first)} before it"
                )
        self.shape = (first.height, first.width, 3 * len(files))
        self._first, self._held = 0, np.empty((0, *self.shape[1:]), np.uint8)
        self._bands = self._read()

    def __getitem__(self, rows: slice, /) -> NDArray[np.uint8]:
        """Return rows; those before the last ones asked for are decoded anew from the top."""
        first, end, _ = rows.indices(self.shape[0])
        if first < self._first:
            self._first, self._held, self._bands = 0, self._held[:0], self._read()
        while self._first + len(self._held) < end:
            band_hwp = next(self._bands)
            kept_hwp = self._held[max(first - self._first, 0) :]
            self._first += len(self._held) - len(kept_hwp)
            self._held = np.concatenate([kept_hwp, band_hwp])
        return self._held[first - self._first : end - self._first]

    def _read(self) -> Iterator[NDArray[np.uint8]]:
        rows = max(_BAND_BYTES // (3 * self.shape[1]), 1)
        readers = [read_bands(header, band_bytes=rows * header.row_bytes) for header in self._headers]
        for bands in zip(*readers, strict=True):
            yield np.concatenate([band_hwc for _, band_hwc in bands], axis=2)


@dataclass(frozen=True)
class Place:
    """Where the bytes of a tile are: a file, or a part of one.

    Attributes
    ----------
    file : Path
    start, end : int, optional
        Bytes of a part.
    """

    file: Path
    start: int = 0
    end: int | None = None


class Tiles(Protocol):
    """Tiles of the finest level of some images."""

    @property
    def cut(self) -> Cut:
        """Of the finest level."""

    @property
    def n_image(self) -> int:
        """Images, of three planes each."""

    def place(self, image: int, column: int, row: int) -> Place:
        """Return where a tile is."""


class TileRows:
    """Planes in tiles, three to an image; InputError if the first tile of one is not what it should be."""

    def __init__(self, tiles: Tiles, padded: bool = False) -> None:
        self._tiles, self._padded = tiles, padded
        cut = tiles.cut
        self.shape = (cut.height, cut.width, 3 * tiles.n_image)
        self._row, self._held = -1, np.empty((0, *self.shape[1:]), np.uint8)
        for image in range(tiles.n_image):
            self._tile(image, 0, 0)

    def __getitem__(self, rows: slice, /) -> NDArray[np.uint8]:
        """Return rows; one row of tiles is kept."""
        first, end, _ = rows.indices(self.shape[0])
        out_hwp = np.empty((max(end - first, 0), *self.shape[1:]), np.uint8)
        tile = self._tiles.cut.tile
        for row in range(first // tile, -(-end // tile)):
            held_hwp, top = self._row_of_tiles(row), row * tile
            start, stop = max(first, top), min(end, top + len(held_hwp))
            out_hwp[start - first : stop - first] = held_hwp[start - top : stop - top]
        return out_hwp

    def _row_of_tiles(self, row: int) -> NDArray[np.uint8]:
        if row != self._row:
            cut = self._tiles.cut
            height = min(cut.tile, cut.height - row * cut.tile)
            held_hwp = np.empty((height, *self.shape[1:]), np.uint8)
            for column in range(cut.counts(0)[1]):
                left = column * cut.tile
                right = min(left + cut.tile, cut.width)
                for image in range(self._tiles.n_image):
                    held_hwp[:, left:right, 3 * image : 3 * image + 3] = self._tile(image, column, row)
            self._row, self._held = row, held_hwp
        return self._held

    def _tile(self, image: int, column: int, row: int) -> NDArray[np.uint8]:
        """Return a tile without what it shares with its neighbours."""
        cut, place = self._tiles.cut, self._tiles.place(image, column, row)
        (top, bottom), (left, right) = cut.span(row, cut.height), cut.span(column, cut.width)
        size = (cut.tile, cut.tile) if self._padded else (bottom - top, right - left)
        pixels_hwc = read_tile(place, size)
        top, left = row * cut.tile - top, column * cut.tile - left
        height, width = cut.height - row * cut.tile, cut.width - column * cut.tile
        return pixels_hwc[top : top + min(cut.tile, height), left : left + min(cut.tile, width)]


def read_tile(place: Place, size: tuple[int, int], channels: int = 3) -> NDArray[np.uint8]:
    """Return an image of 8 bits, in a file or a part of one; InputError unless it has this height and width."""
    if place.end is None:
        return _checked(place.file, str(place.file), size, channels)
    what = f"bytes {place.start} to {place.end} of {place.file}"
    try:
        with open(place.file, "rb") as whole:
            whole.seek(place.start)
            content = whole.read(place.end - place.start)
    except OSError as error:
        raise InputError(f"cannot read {place.file}: {error.strerror or error}") from None
    with named_content(content, ".jpg") as name:  # OpenImageIO reads from no memory in Python
        try:
            return _checked(Path(name), what, size, channels)
        except InputError as error:
            raise InputError(str(error).replace(f"image {name}", what).replace(name, what)) from None


def _checked(file: Path, what: str, size: tuple[int, int], channels: int) -> NDArray[np.uint8]:
    header = read_header(file)  # before the memory that it asks for
    if (header.height, header.width) != size or header.channels != channels or header.dtype != np.uint8:
        wanted = f"{size[1]} × {size[0]} pixels of {counted(channels, 'channel')} in 8 bits"
        raise InputError(f"{what} has {_sides(header)} of {header.channels} in {header.dtype}, expected {wanted}")
    return read_image(header)


def _sides(header: object) -> str:
    return f"{header.width} × {header.height}"  # type: ignore[attr-defined]
