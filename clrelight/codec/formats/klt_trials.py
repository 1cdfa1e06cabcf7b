"""Where the codec `klt` looks for its step: a search for a number of bytes, and the pieces of a map that are tried."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.units import Layout, Tile, Window, lay_out
from clrelight.codec.transforms.principal import Axes
from clrelight.opencl.arguments import DeviceArray
from clrelight.search import search_falling

_WHOLE = 1 << 19
"""Pixels up to which a map is tried as a whole; of larger ones, pieces."""
_PIECE, _PIECES = 128, 48
_LEAST_TRIED, _MAX_TRIED = 1 << 22, 1 << 26
"""Values of the planes that are tried at once: what bounds memory, of which they take an eighth."""
_SAMPLE, _SAMPLES, _SAMPLED = 64, 16, 1 << 23
"""Side and number of the pieces by which axes are turned, and values of all their planes at most."""
_MAX_TRIALS = 24
_STEP_SLOPE = 1.05
"""By how much the logarithm of 2 of a step falls, about, where that of e of the bytes rises by 1."""

STEP_POWER = 0.8
"""Steps grow about with this power of what bytes are to shrink by."""


@dataclass(frozen=True)
class Part:
    """Wavelet coefficients of the planes of a part of the map, and which of them are coded.

    Attributes
    ----------
    values : DeviceArray, shape (n_plane, height, pitch), float32
    layout : Layout
    height, width : int
        Of the part; rows of the planes may be longer.
    """

    values: DeviceArray
    layout: Layout
    height: int
    width: int

    @classmethod
    def of(cls, values: DeviceArray, window: Window, tile: Tile, sides: tuple[int, int], together: bool) -> Part:
        """Return what of a window's values is a tile of an image of some sides."""
        layout = lay_out(tile.units, sides, window, values.shape[2], together, [(0, values.shape[0])])
        return cls(values, layout, *window.shape)

    def of_streams(self, chosen: Sequence[int]) -> Part:
        """Return the same of some streams, by their numbers."""
        return replace(self, layout=self.layout.of_streams(chosen))


@dataclass(frozen=True)
class Trial:
    """What a step would give.

    Attributes
    ----------
    step : float
    size : float
        About the bytes of the body.
    axes : Axes
        Those that are worth their bits.
    of_pixel : ndarray, shape (n_piece,), float64
        Bytes of each piece's streams for one of its pixels.
    rows : list of int
        In the middle of each piece.
    """

    step: float
    size: float
    axes: Axes
    of_pixel: NDArray[np.float64]
    rows: list[int]


def search_step(
    count: Callable[[float], float],
    place: float,
    bounds: tuple[float, float],
    budget: int,
    aims: tuple[float, float, float],
) -> float:
    """Return the logarithm of a step whose bytes come nearest to part of a budget from below, or of the coarsest one.

    It ends where the part of the budget that is used is the first of `aims` to the last, and aims at the second.
    """
    whole = math.log(budget) if budget > 0 else -math.inf
    least, aim, limit = (whole + math.log(part) for part in aims)
    aim = max(aim, 0.0)
    tried = search_falling(
        lambda place: math.log(max(count(place), 1.0)),
        place,
        bounds,
        aim,
        limit=limit,
        is_enough=lambda size: least <= size <= limit,
        expect=lambda place, size: place - _STEP_SLOPE * (aim - size),
        # In logarithms of 2 a step's bytes fall by a power between 0.3 and 3.
        slopes=(-4.8, -0.48),
        most=_MAX_TRIALS,
        width=1e-4,
    )
    below = [trial for trial in tried if trial[1] <= limit]
    return (max(below, key=lambda trial: trial[1]) if below else min(tried, key=lambda trial: trial[1]))[0]


def list_pieces(height: int, width: int, count: int, memory: int) -> list[Window]:
    """Return what of a map is tried: all of it, or pieces that lie all over it."""
    tried = min(max(memory // 8, _LEAST_TRIED), _MAX_TRIED)
    if height * width <= _WHOLE and height * width * count <= tried:
        return [Window(0, 0, height, width)]
    most = max(min(_PIECES, tried // (min(_PIECE, height) * min(_PIECE, width) * max(count, 1))), 1)
    return _spread(height, width, _PIECE, most)


def list_samples(height: int, width: int, count: int) -> list[Window]:
    """Return what of a map says how axes are turned: all of a small one, or small pieces that lie all over it."""
    most = max(min(_SAMPLES, _SAMPLED // (_SAMPLE**2 * count)), 1)
    if height * width <= most * _SAMPLE**2:
        return [Window(0, 0, height, width)]
    return _spread(height, width, _SAMPLE, most)


def _spread(height: int, width: int, side: int, most: int) -> list[Window]:
    """Return at most so many pieces of a map."""
    side_h, side_w = min(side, height), min(side, width)
    across = min(max(round((most * width / height) ** 0.5), 1), most, max(width // side_w, 1))
    down = max(min(most // across, height // side_h), 1)
    tops = [int((height - side_h) * (i + 0.5) / down) & ~31 for i in range(down)]
    lefts = [int((width - side_w) * (i + 0.5) / across) & ~31 for i in range(across)]
    return [Window(top, left, top + side_h, left + side_w) for top in tops for left in lefts]


def foretell(rows: list[int], of_pixel: NDArray[np.float64], tiles: list[Tile]) -> NDArray[np.float64]:
    """Return about the bytes of each tile, by those of a pixel of pieces that lie around some rows."""
    at = np.array(rows)
    centres = np.unique(at)
    # Few pieces tell little of their rows: half of what they differ by.
    means = [(of_pixel[at == row].mean() + of_pixel.mean()) / 2 for row in centres]
    middles = [(tile.top + tile.bottom) / 2 for tile in tiles]
    return np.interp(middles, centres, means) * [tile.n_pixel for tile in tiles]
