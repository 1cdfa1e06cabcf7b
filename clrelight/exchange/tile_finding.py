"""Finds the planes of a relight folder: whole images, or the finest level of tiles in any of the layouts."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from clrelight.errors import InputError
from clrelight.exchange.files import read_bytes
from clrelight.exchange.layouts import LAYOUTS, Layout, iiif_request
from clrelight.exchange.pyramid import Cut
from clrelight.exchange.rows import ImageRows, Place, Rows, TileRows
from clrelight.images import MAX_PIXELS

_ATTRIBUTE = re.compile(r"""(\w+)\s*=\s*["']([^"']{0,64})["']""")
_MOST_TILE = 1 << 14
_MOST_TEXT = 1 << 26
ENDINGS = ("jpg", "jpeg", "png")


@dataclass(frozen=True)
class _Named:
    """Tiles whose names follow from their places."""

    cut: Cut
    n_image: int
    name: Callable[[int, int, int], Path]

    def place(self, image: int, column: int, row: int) -> Place:
        return Place(self.name(image, column, row))


@dataclass(frozen=True)
class _Archived:
    """Tiles that lie one behind another: those of image i begin at `offsets[i]`, the first of the finest level on."""

    cut: Cut
    n_image: int
    files: list[Path]
    offsets: list[list[int]]
    stride: int

    def place(self, image: int, column: int, row: int) -> Place:
        index = self.stride * (row * self.cut.counts(0)[1] + column)
        offsets = self.offsets[image]
        return Place(self.files[image], offsets[index], offsets[index + 1])


def find_planes(folder: Path, images: list[str], ending: str, size: tuple[int, int] | None) -> Rows:
    """Return rows of the planes of a folder.

    Parameters
    ----------
    folder : Path
    images : list of str
        Three planes each.
    ending : str
        Of image files and tiles.
    size : (int, int), optional
        Height and width that the folder says: Google Maps tiles have no other place for it.

    Raises
    ------
    InputError
        If there is nothing of the first image, or something of another is missing or of another size.
    """
    if ending not in ENDINGS:
        raise InputError(f"{folder}: planes of format {ending!r}; those in {', '.join(ENDINGS)} can be read")
    first = images[0]
    if (folder / f"{first}.{ending}").exists():
        return ImageRows([folder / f"{image}.{ending}" for image in images])
    for mark, reader in (
        (f"{first}.dzi", _deep_zoom),
        (f"{first}/ImageProperties.xml", _zoomify),
        (f"{first}/info.json", _iiif),
        (f"{first}.tzi", _tar),
        ("planes.tzi", _interleaved),
        (first, _google),  # level 0 is missing where half of a side rounds to nothing
    ):
        if (folder / mark).exists():
            try:
                return reader(folder, images, ending, size)
            except (KeyError, IndexError, TypeError, ValueError, OverflowError, StopIteration) as error:
                if isinstance(error, InputError):
                    raise
                raise InputError(f"{folder / mark} does not say where its tiles are: {error!r}") from None
    raise InputError(f"{folder} holds neither {first}.{ending} nor tiles of it ({', '.join(LAYOUTS)})")


def _cut(height: Any, width: Any, tile: Any, overlap: Any = 0) -> Cut:
    sides = [int(each) for each in (height, width, tile, overlap)]
    if min(sides[:3]) < 1 or sides[0] * sides[1] > MAX_PIXELS or sides[2] > _MOST_TILE:
        raise ValueError(f"{sides[1]} × {sides[0]} pixels in tiles of {sides[2]}")
    if not 0 <= sides[3] <= sides[2]:
        raise ValueError(f"an overlap of {sides[3]}")
    return Cut(sides[0], sides[1], sides[2], sides[3])


def _text(file: Path) -> str:
    content = read_bytes(file)
    if len(content) > _MOST_TEXT:
        raise InputError(f"{file} is too large to say where tiles are")
    return content.decode("utf-8", "replace")


def _json(file: Path) -> dict[str, Any]:
    try:
        told = json.loads(_text(file))
    except (json.JSONDecodeError, RecursionError):
        raise InputError(f"{file} is no JSON") from None
    if not isinstance(told, dict):
        raise TypeError("no object")
    return told


def _same(cuts: list[Cut], files: list[Path]) -> Cut:
    for cut, file in zip(cuts, files, strict=True):
        if cut != cuts[0]:
            raise InputError(f"{file} has {cut.width} × {cut.height} pixels in tiles of {cut.tile}, others have not")
    return cuts[0]


def _deep_zoom(folder: Path, images: list[str], ending: str, size: object) -> Rows:
    files = [folder / f"{image}.dzi" for image in images]
    told = [dict(_ATTRIBUTE.findall(_text(file))) for file in files]
    cut = _same([_cut(each["Height"], each["Width"], each["TileSize"], each.get("Overlap", 0)) for each in told], files)
    ending = told[0].get("Format", ending)
    if ending not in ENDINGS:
        raise InputError(f"{files[0]}: tiles of format {ending!r}; those in {', '.join(ENDINGS)} can be read")
    # relight's first level is one tile, that of others one pixel, and some have a level less.
    numbers = [int(each.name) for each in (folder / f"{images[0]}_files").iterdir() if each.name.isdecimal()]
    finest = max(numbers, default=0)
    return TileRows(
        _Named(cut, len(images), lambda i, x, y: folder / f"{images[i]}_files" / str(finest) / f"{x}_{y}.{ending}")
    )


def _zoomify(folder: Path, images: list[str], ending: str, size: object) -> Rows:
    files = [folder / image / "ImageProperties.xml" for image in images]
    told = [dict(_ATTRIBUTE.findall(_text(file))) for file in files]
    cut = _same([_cut(each["HEIGHT"], each["WIDTH"], each["TILESIZE"]) for each in told], files)
    rows, columns = cut.counts(0)
    before = int(told[0]["NUMTILES"]) - rows * columns
    level = cut.n_level - 1

    def name(image: int, column: int, row: int) -> Path:
        group = (before + row * columns + column) // 256
        return folder / images[image] / f"TileGroup{group}" / f"{level}-{column}-{row}.{ending}"

    return TileRows(_Named(cut, len(images), name))


def _iiif(folder: Path, images: list[str], ending: str, size: object) -> Rows:
    files = [folder / image / "info.json" for image in images]
    told = [_json(file) for file in files]
    cut = _same([_cut(each["height"], each["width"], each["tiles"][0]["width"]) for each in told], files)
    return TileRows(_Named(cut, len(images), lambda i, x, y: folder / images[i] / iiif_request(cut, 0, x, y)))


def _google(folder: Path, images: list[str], ending: str, size: tuple[int, int] | None) -> Rows:
    if size is None:
        raise KeyError("width and height in info.json")
    layout: Layout = LAYOUTS["google"]
    cut = _cut(*size, layout.cut.tile)
    level = cut.n_level - 1
    return TileRows(
        _Named(cut, len(images), lambda i, x, y: folder / images[i] / str(level) / str(y) / f"{x}.{ending}"), True
    )


def _tar(folder: Path, images: list[str], ending: str, size: object) -> Rows:
    files = [folder / f"{image}.tzi" for image in images]
    told = [_json(file) for file in files]
    cut = _same([_cut(each["height"], each["width"], each["tilesize"], each["overlap"]) for each in told], files)
    archives = [file.with_suffix(".tzb") for file in files]
    found = [_offsets(each, archive, cut, 1) for each, archive in zip(told, archives, strict=True)]
    return TileRows(_Archived(cut, len(images), archives, found, 1))


def _interleaved(folder: Path, images: list[str], ending: str, size: object) -> Rows:
    told = _json(folder / "planes.tzi")
    cut, stride = _cut(told["height"], told["width"], told["tilesize"], told["overlap"]), int(told["stride"])
    if not len(images) <= stride <= 1024:
        raise ValueError(f"{stride} images, not {len(images)}")
    offsets = _offsets(told, folder / "planes.tzb", cut, stride)
    archives = len(images) * [folder / "planes.tzb"]
    return TileRows(_Archived(cut, len(images), archives, [offsets[number:] for number in range(len(images))], stride))


def _offsets(told: dict[str, Any], archive: Path, cut: Cut, stride: int) -> list[int]:
    """Return where tiles of the finest level begin, the last ones of the archive, and where it ends."""
    rows, columns = cut.counts(0)
    wanted = rows * columns * stride
    offsets = [int(each) for each in told["offsets"]]
    if len(offsets) <= wanted:
        raise ValueError(f"{len(offsets)} offsets for {wanted} tiles of the finest level")
    found = offsets[len(offsets) - wanted - 1 :]
    try:
        length = archive.stat().st_size
    except OSError as error:
        raise InputError(f"cannot read {archive}: {error.strerror or error}") from None
    if found[0] < 0 or found[-1] > length or any(a > b for a, b in pairwise(found)):
        raise InputError(f"{archive} has {length} bytes, and tiles lie beyond it or in no order")
    return found
