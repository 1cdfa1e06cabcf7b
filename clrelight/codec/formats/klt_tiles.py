"""Tiles of the codec `klt` that are coded elsewhere: what cuts them into parts, and puts the streams of parts together.

A unit's stream hangs on its place, the axes, the step and the multiplier, and on nothing of how an image was cut: the
transform of a window is that of the image on all but its margin (`clrelight.codec.entropy.units.MARGIN`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from clrelight.codec.entropy.unit_streams import (
    CONTEXTS,
    FLAGS,
    SYMBOLS,
    Coded,
    ValuesLostError,
    default_tables,
    encode_streams,
)
from clrelight.codec.entropy.units import LEVELS, PRECINCT, Layout, Tile, Window, tile_of
from clrelight.codec.formats.klt_pieces import Pieces, Tried
from clrelight.codec.formats.klt_trials import Part
from clrelight.codec.formats.klt_units import is_together
from clrelight.codec.transforms.lifting import transform_planes
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.strips import Strips
from clrelight.codec.transforms.whitening import Planes, reshaped, with_type
from clrelight.errors import InputError
from clrelight.opencl.arguments import DeviceArray

MULTIPLIER = 0.15
"""Lagrange multiplier of rate–distortion optimisation: squared steps of error that a bit must save.

From 0.12 to 0.15 a map's own error hardly tells. Where lights come from a part of the hemisphere, what the fit makes up
elsewhere looks like noise: at 0.15 it takes far fewer of the bytes.
"""
LARGEST_ERROR = 2.0**40
"""Squared steps of a stream that no choice of indices costs: one of them was cut off, or was not finite."""
PART_PIXELS = 3 << 19
"""Pixels of a part, at most: a second or two of work. Smaller ones have more of what they read in their margins."""


class TileCoder(Protocol):
    """Codes tiles in other processes."""

    def code(
        self,
        tiles: Sequence[Tile],
        planes: Planes,
        transfer: str,
        step: float,
        multiplier: float,
        *,
        last: bool = False,
    ) -> Iterator[list[bytes]]:
        """Return the streams of each tile, in the order of the tiles; of the last ones some are coded again."""

    def code_again(
        self,
        chosen: Sequence[tuple[Tile, list[int]]],
        planes: Planes,
        transfer: str,
        step: float,
        multiplier: float,
        again: float,
    ) -> Iterator[list[bytes]]:
        """Return some streams of tiles, by their numbers within each, at another multiplier than `code` did."""

    def try_pieces(
        self, windows: Sequence[Window], planes: Planes, transfer: str, step: float, count: int
    ) -> list[Tried]:
        """Return what the first planes of pieces take at a step, each a map of its own."""


def sides_of(tile: Tile) -> tuple[int, int, int, int]:
    """Return the top, left, bottom and right of what a tile codes, whose window is larger."""
    left = min(unit.column << (unit.level or LEVELS) for unit in tile.units)
    return tile.top, left, tile.bottom, left + tile.n_pixel // (tile.bottom - tile.top)


def cut_tile(tile: Tile, height: int, width: int, most: int = PART_PIXELS) -> list[Tile]:
    """Return parts of a tile, of whole precincts and of so many pixels at most, rows first.

    Of a row of precincts there are two, or a multiple of two, of about one size: tiles are coded one after another,
    and two workers are to end together.
    """
    top, left, bottom, right = sides_of(tile)
    among = list(zip(tile.streams, tile.units, strict=True))
    precincts = -(-(right - left) // PRECINCT)
    pairs = -(-precincts // (2 * max(most // PRECINCT**2, 1)))
    columns = -(-precincts // (2 * pairs)) * PRECINCT
    return [
        tile_of(height, width, (row, column, min(row + PRECINCT, bottom), min(column + columns, right)), among)
        for row in range(top, bottom, PRECINCT)
        for column in range(left, right, columns)
    ]


def encode_elsewhere(
    coder: TileCoder,
    tiles: Sequence[Tile],
    sides: tuple[int, int],
    planes: Planes,
    transfer: str,
    step: float,
    multiplier: float,
    *,
    last: bool = False,
) -> Iterator[Coded]:
    """Return the streams of tiles of an image of some height and width, one after another, which are begun at once."""
    cut = [cut_tile(tile, *sides) for tile in tiles]
    made = coder.code([part for each in cut for part in each], planes, transfer, step, multiplier, last=last)
    for tile, parts in zip(tiles, cut, strict=True):
        yield _join(tile, [(part, next(made)) for part in parts], len(planes[1]))


def _join(tile: Tile, parts: Sequence[tuple[Tile, list[bytes]]], n_plane: int) -> Coded:
    """Return the streams of a tile from those of its parts; what is measured beside them is not known."""
    found = {t: stream for part, streams in parts for t, stream in zip(part.streams, streams, strict=True)}
    unknown = np.full((1, n_plane), np.nan, np.float32)
    return Coded(
        [found[t] for t in tile.streams],
        unknown,
        unknown,
        np.zeros((CONTEXTS, SYMBOLS), np.int64),
        np.zeros((FLAGS, 2), np.int64),
    )


class TileEncoder:
    """What codes parts of a map along given axes.

    Parameters
    ----------
    pixels : Pixels
        The map.
    """

    _counts = False

    def __init__(self, pixels: Pixels) -> None:
        self._shape, self._pixels, self.device = pixels.shape, pixels, pixels.device

    def forget(self) -> None:
        """Give back memory that parts were lent."""
        self._pixels.forget()

    def take_part(self, window: Window, tile: Tile, planes: Planes, *, lent: bool = False) -> Part:
        """Return wavelet coefficients of the planes of a window, of which a tile's are coded."""
        rows, columns = (window.top, window.bottom), (window.left, window.right)
        values = self._pixels.planes(rows, columns, planes, lent=lent)
        transform_planes("analyse", values, window.shape[1], LEVELS, self.device)
        return Part.of(values, window, tile, self._shape[1:3], is_together(self._shape))

    def encode_here(
        self, tile: Tile, planes: Planes, step: float, multiplier: float, strips: Strips | None = None
    ) -> Coded:
        """Return the streams of a tile, coded by this process; `strips` make its planes where they come in order."""
        try:
            return self.encode_part(self._take_tile(tile, planes, strips), step, multiplier)
        except ValuesLostError:
            return self.encode_part(self.take_part(tile.window, tile, planes, lent=True), step, multiplier, keep=True)

    def _take_tile(self, tile: Tile, planes: Planes, strips: Strips | None) -> Part:
        if strips is None:
            return self.take_part(tile.window, tile, planes, lent=True)
        return Part.of(strips.take(tile), strips.window_of(tile), tile, self._shape[1:3], False)

    def encode_part(
        self,
        part: Part,
        step: float,
        multiplier: float = MULTIPLIER,
        keep: bool = False,
        index: DeviceArray | None = None,
    ) -> Coded:
        """Return the streams of a part; its values are lost unless they are to be kept, or `index` gets indices.

        InputError where the indices of a pixel are larger than streams hold: it would be cut off, and what lies around
        it would drown in the rounding errors of float32.
        """
        coded = self._encode(part.values, part.layout, step, multiplier, keep, index)
        if not (coded.error_tj < LARGEST_ERROR).all():
            raise InputError(
                f"{self._brightest()}, which is too large among the others for klt at step {step:.3g}: "
                "mask that pixel, or take half with --clamp"
            )
        return coded

    def _brightest(self) -> str:
        """Say which coefficient of the map is the largest."""
        _, height, width, _ = self._shape
        largest, told = -1.0, ""
        for row in range(height):
            coeffs_khwc = self._pixels.coefficients((row, row + 1), (0, width))
            place = np.unravel_index(int(np.abs(coeffs_khwc).argmax()), coeffs_khwc.shape)
            k, _, column, channel = (int(i) for i in place)
            if (value := float(abs(coeffs_khwc[place]))) > largest:
                largest, told = value, f"{(k, row, column, channel)} is {float(coeffs_khwc[place]):g}"
        return f"coefficient (k, row, column, channel) = {told}"

    def take_pieces(self, windows: Sequence[Window], planes: Planes) -> Pieces:
        """Return wavelet coefficients of the planes of windows of one size, each a map of its own."""
        return Pieces.of(self._pixels, windows, planes, is_together(self._shape))

    def try_pieces(self, pieces: Pieces, step: float, count: int) -> list[Tried]:
        """Return what the first planes of pieces take at a step."""
        values = reshaped(pieces.values, (count, *pieces.values.shape[1:]))
        coded = self._encode(values, pieces.layout.of_first(count), step, MULTIPLIER, True)
        return pieces.share(coded, count)

    def _encode(
        self,
        values: DeviceArray,
        layout: Layout,
        step: float,
        multiplier: float,
        keep: bool,
        index: DeviceArray | None = None,
    ) -> Coded:
        if index is None:
            index = with_type(self._pixels.lend("index", values.shape) if keep else values, np.int32)
        return encode_streams(
            self.device,
            layout,
            values,
            index,
            default_tables(),
            multiplier,
            1.0 / step,
            count=self._counts,
            finest=False,
        )
