"""One picture in tiles for viewers of large images: Deep Zoom, as its makers number it, and static IIIF images."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.durable import replacing_folder
from clrelight.errors import InputError
from clrelight.exchange.codes import check_picture, display_values, row_pieces
from clrelight.exchange.layouts import Layout, find_layout
from clrelight.exchange.pyramid import Cut
from clrelight.exchange.tiles import TileWriter
from clrelight.images import read_bands, read_header

PICTURES = ("deepzoom", "iiif")
_DEEP_ZOOM = Layout("deepzoom", Cut(0, 0, 254, overlap=1, rounds_up=True, to_pixel=True))
_NAMES = {"deepzoom": "picture", "iiif": "."}

Bands = Iterator[tuple[int, NDArray[np.uint8]]]
"""First rows, and rows of 8 bits, (row, width, 3), from the top down."""


def bands_of_fit(coefficients: CoefficientMap, direction_3: NDArray[np.float64]) -> tuple[tuple[int, int], Bands]:
    """Return height and width of a fit, and its display values under a light from one direction."""
    check_picture(coefficients, "such a picture")
    height, width, _ = coefficients.image_shape
    basis_ik = coefficients.functions_at(direction_3[None])

    def bands() -> Bands:
        for first, end in row_pieces(coefficients, 1):
            shown_pc = display_values(coefficients, basis_ik, first, end)[0]
            yield first, np.rint(255.0 * shown_pc).astype(np.uint8).reshape(end - first, width, 3)

    return (height, width), bands()


def bands_of_image(path: str | os.PathLike[str]) -> tuple[tuple[int, int], Bands]:
    """Return height and width of an image file, and its rows; InputError unless it has 8 bits."""
    header = read_header(path)
    if header.dtype != np.uint8:
        raise InputError(
            f"{os.fsdecode(path)} has values of {header.dtype}: tiles are JPEGs of 8 bits, make it a PNG first"
        )
    return (header.height, header.width), (
        (first, np.broadcast_to(band_hwc, (*band_hwc.shape[:2], 3))) for first, band_hwc in read_bands(header)
    )


def write_picture_tiles(
    size: tuple[int, int],
    bands: Bands,
    out: str | os.PathLike[str],
    layout: str,
    *,
    quality: int,
    url: str,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write a picture as tiles.

    Parameters
    ----------
    size : (int, int)
        Height and width.
    bands : iterator
    out : path
        A new folder: ``picture.dzi`` and ``picture_files``, or ``info.json`` and its tiles.
    layout : str
        Of `PICTURES`.
    quality : int
        Of the JPEGs, 1 to 100.
    url : str
        Where the folder will be found, for IIIF.
    progress : callable, optional
        Called with rows done and in all.

    Returns
    -------
    list of Path
        What describes the tiles.
    """
    height, width = size
    chosen = _DEEP_ZOOM if layout == "deepzoom" else find_layout(layout)
    placed = replace(chosen, cut=replace(chosen.cut, height=height, width=width))
    target = Path(os.fsdecode(out))
    with (
        replacing_folder(target) as folder,
        closing(TileWriter(folder, placed, [_NAMES[layout]], quality, url=url)) as writer,
    ):
        for first, rows_hwc in bands:
            if progress is not None:
                progress(first, height)
            writer.add(rows_hwc[None])
        files = writer.finish()
    return [target / file for file in files]
