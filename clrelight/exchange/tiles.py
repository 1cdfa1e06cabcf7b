"""Writes images as tiles of a layout, several images at once, while their rows arrive."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clrelight.durable import naming
from clrelight.exchange.jpegs import MOST_SIDE, close_jpeg, open_jpeg, write_jpeg
from clrelight.exchange.layouts import ARCHIVES, Layout
from clrelight.exchange.pyramid import Cut, Pyramid
from clrelight.streaming import some_threads

_DEEP_ZOOM = """<?xml version="1.0" encoding="UTF-8"?>
<Image xmlns="http://schemas.microsoft.com/deepzoom/2008" Format="jpg" Overlap="{overlap}" TileSize="{tile}">
  <Size Height="{height}" Width="{width}"/>
</Image>
"""
_ZOOMIFY = (
    '<IMAGE_PROPERTIES WIDTH="{width}" HEIGHT="{height}" NUMTILES="{tiles}" NUMIMAGES="1" VERSION="1.8" '
    'TILESIZE="{tile}"/>\n'
)


class TileWriter:
    """Images of one size that become tiles side by side.

    Parameters
    ----------
    folder : Path
        Exists, and is nobody else's.
    layout : Layout
        Of the images' size.
    images : sequence of str
        Their names: of ``.dzi`` files, of folders, or of archives.
    quality : int
        Of the JPEGs, 1 to 100.
    url : str
        Where the folder will be found: IIIF writes it into ``info.json``.
    """

    def __init__(self, folder: Path, layout: Layout, images: Sequence[str], quality: int, *, url: str = "") -> None:
        self._folder, self._layout, self._images, self._quality = folder, layout, list(images), quality
        self._url = url.rstrip("/")
        self._names = [layout.tile_names(image) for image in images]
        self._made: set[Path] = set()
        self._pyramids = [Pyramid(layout.cut, 3, partial(self._emit, number)) for number in range(len(images))]
        self._pool = some_threads(len(images))
        cut = layout.cut
        self._whole: list[tuple[Path, Any]] = []
        if layout.name == "iiif" and max(cut.height, cut.width) <= MOST_SIDE and cut.n_level > 1:
            self._whole = [(self._place(f"{image}/full/max/0/default.jpg"), None) for image in images]
            self._whole = [(file, open_jpeg(file, cut.height, cut.width, quality)) for file, _ in self._whole]
        self._row = 0

    def add(self, rows_nhwc: NDArray[np.uint8]) -> None:
        """Take the next rows, (image, rows, width, 3)."""
        for _ in self._pool.map(self._add, range(len(rows_nhwc)), rows_nhwc):
            pass
        self._row += rows_nhwc.shape[1]

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown(cancel_futures=True)

    def _add(self, number: int, rows_hwc: NDArray[np.uint8]) -> None:
        self._pyramids[number].add(rows_hwc)
        if self._whole:
            rows_hwc = np.ascontiguousarray(rows_hwc)
            self._whole[number][1].write_scanlines(self._row, self._row + len(rows_hwc), 0, rows_hwc)

    def finish(self) -> list[Path]:
        """Write what describes the tiles; return its files, relative to the folder: there are too many tiles."""
        for file, output in self._whole:
            close_jpeg(file, output)
        with naming(self._folder):
            if self._layout.name in ARCHIVES:
                return self._archived()
            return [found for image in self._images for found in self._described(image)]

    def _emit(self, number: int, level: int, column: int, row: int, tile_hwc: NDArray[np.uint8]) -> None:
        if self._layout.pads:
            rows, columns = (self._layout.cut.tile - side for side in tile_hwc.shape[:2])
            tile_hwc = np.pad(tile_hwc, ((0, rows), (0, columns), (0, 0)), mode="edge")
        write_jpeg(self._place(self._names[number][level, column, row]), tile_hwc, self._quality)

    def _place(self, name: str) -> Path:
        file = self._folder / name
        if file.parent not in self._made:
            with naming(self._folder):
                file.parent.mkdir(parents=True, exist_ok=True)
            self._made.add(file.parent)
        return file

    def _described(self, image: str) -> list[Path]:
        cut, tiles = self._layout.cut, len(self._names[0])
        sides: dict[str, int] = {"height": cut.height, "width": cut.width, "tile": cut.tile}
        found: list[tuple[str, str]] = []
        if self._layout.name == "deepzoom":
            found = [(f"{image}.dzi", _DEEP_ZOOM.format(overlap=cut.overlap, **sides))]
        elif self._layout.name == "zoomify":
            found = [(f"{image}/ImageProperties.xml", _ZOOMIFY.format(tiles=tiles, **sides))]
        elif self._layout.name == "iiif":
            identity = f"{self._url}/{image}".removesuffix("/.")
            found = [(f"{image}/info.json", json.dumps(iiif_info(cut, identity), indent=1) + "\n")]
        for name, text in found:
            (self._folder / name).write_text(text, encoding="utf-8")
        return [Path(name) for name, _ in found]

    def _archived(self) -> list[Path]:
        """Put all tiles of an image, or those of all images in turn, into one file; its index says where they lie."""
        interleaved = self._layout.name == "itarzoom"
        groups = [self._images] if interleaved else [[image] for image in self._images]
        found: list[Path] = []
        for group in groups:
            stem = "planes" if interleaved else group[0]
            with open(self._folder / f"{stem}.tzb", "wb") as archive:
                offsets = [0, *self._appended(archive, group)]
            cut = self._layout.cut
            told: dict[str, Any] = {"tilesize": cut.tile, "overlap": cut.overlap, "format": "jpg"}
            told |= {"width": cut.width, "height": cut.height, "nlevels": cut.n_level}
            told |= {"mode": "interleaved", "stride": len(group)} if interleaved else {}
            (self._folder / f"{stem}.tzi").write_text(json.dumps(told | {"offsets": offsets}))
            found += [Path(f"{stem}.tzi"), Path(f"{stem}.tzb")]
        for image in self._images:
            shutil.rmtree(self._folder / f"{image}_files", ignore_errors=True)
        return found

    def _appended(self, archive: BinaryIO, group: list[str]) -> list[int]:
        ends: list[int] = []
        chosen = [self._names[self._images.index(image)] for image in group]
        for place in self._layout.cut.places():
            for names in chosen:
                archive.write((self._folder / names[place]).read_bytes())
                ends.append(archive.tell())
        return ends


def iiif_info(cut: Cut, identity: str) -> dict[str, Any]:
    """Return the ``info.json`` of a static image service, IIIF Image API 3.0 at level 0."""
    levels = range(cut.n_level)
    alone = [level for level in reversed(levels) if cut.counts(level) == (1, 1)]
    sizes = [{"width": cut.size(level)[1], "height": cut.size(level)[0]} for level in alone]
    return {
        "@context": "http://iiif.io/api/image/3/context.json",
        "id": identity,
        "type": "ImageService3",
        "protocol": "http://iiif.io/api/image",
        "profile": "level0",
        "width": cut.width,
        "height": cut.height,
        "sizes": sizes,
        "tiles": [{"width": cut.tile, "height": cut.tile, "scaleFactors": [1 << level for level in levels]}],
    }
