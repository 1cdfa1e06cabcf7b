"""The wavelet coefficients of an image's planes from top to bottom, strip by strip, with no row made twice.

What a strip's transform needs of the rows above it are six rows of each level, and what it makes of the rows below are
first rows of the next strip's subbands: both stay from strip to strip. A strip alone would need `MARGIN` rows above it
and below, half as many as it has itself. The bits are the same.
"""

from __future__ import annotations

from clrelight.codec.entropy.units import LEVELS, MARGIN, Tile, Window
from clrelight.codec.slabs import round_up
from clrelight.codec.transforms.lifting import padded_width
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.whitening import Planes
from clrelight.opencl.arguments import DeviceArray

_SLACK, _ROWS_OF_WORK, _ROWS_OF_LEVEL, _MORE_ROWS = 32, 4, 6, 3
"""As in ``strips.cl``."""
_WORKERS = 4
"""Of each compute unit, so that none waits long for the last."""


class Strips:
    """Planes in wavelet coefficients, of strips that are asked for from top to bottom.

    Parameters
    ----------
    pixels : Pixels
        What planes are made of, on a CPU.
    planes : Planes
        What makes them.
    most_rows : int
        Of a strip.
    """

    def __init__(self, pixels: Pixels, planes: Planes, most_rows: int) -> None:
        self._pixels, self._planes, self._device = pixels, planes, pixels.device
        _, self._height, self._width, _ = pixels.shape
        count, pitch = len(planes[1]), padded_width(self._width)
        self._columns = 0, self._width
        self._at_once = pixels.rows_at_once(self._columns, planes)
        window_rows = min(most_rows + MARGIN, self._height)
        self._values = pixels.lend("window", (count, window_rows, pitch))
        self._fresh = pixels.lend("fresh", (count, self._at_once, pitch))
        widths = [-(-self._width >> level) for level in range(LEVELS)]
        state = _ROWS_OF_LEVEL * sum(round_up(width, 8) + _SLACK for width in widths)
        self._state = pixels.lend("state", (count, state))
        workers = min(count, _WORKERS * self._device.info.compute_units)
        work = _ROWS_OF_WORK * (pitch + _SLACK) + 2 * (self._at_once // 2 + _MORE_ROWS) * (pitch // 2 + _SLACK)
        self._scratch = pixels.lend("scratch", (workers, work + 8))
        self._window, self._fed = Window(0, 0, window_rows, self._width), 0

    @classmethod
    def of(cls, pixels: Pixels, planes: Planes, tiles: list[Tile]) -> Strips | None:
        """Return what makes the coefficients of tiles; None where they are no strips, or the device has no kernels.

        Strips are as wide as the image, but for the last, which may be in pieces.
        """
        width, last = pixels.shape[2], tiles[-1].top if tiles else 0
        whole = all(tile.top == last or (tile.window.left, tile.window.right) == (0, width) for tile in tiles)
        if len(tiles) < 2 or not whole or pixels.device.style != "cpu":
            return None
        return cls(pixels, planes, max(tile.bottom - tile.top for tile in tiles))

    def window_of(self, tile: Tile) -> Window:
        """Return the part of the image whose coefficients are there when a tile's are."""
        return Window(tile.top, 0, min(tile.bottom + MARGIN, self._height), self._width)

    def take(self, tile: Tile) -> DeviceArray:
        """Return the coefficients of `window_of` a tile, (n_plane, rows or more, pitch), those in the tile right.

        They may be overwritten where they are of the tile, until the next is asked for.
        """
        window = self.window_of(tile)
        if window.top > self._window.top:
            self._move(window)
        self._window = window
        while self._fed < window.bottom:
            self._feed(min(self._at_once, window.bottom - self._fed))
        self._device.finish()
        return self._values

    def _move(self, window: Window) -> None:
        """Queue what puts the rows that the last window had of this one where they belong."""
        before = self._window
        self._device.launch(
            "codec/strips.cl",
            "move_rows",
            (self._values.shape[0],),
            *(self._values, LEVELS, self._height, self._width, before.top, before.shape[0], window.shape[0]),
            *(window.top - before.top, self._fed, *self._values.shape),
        )

    def _feed(self, count: int) -> None:
        """Queue the analysis of the next rows."""
        self._pixels.fill(self._fresh, (self._fed, self._fed + count), self._columns, self._planes)
        workers, work = self._scratch.shape
        self._device.launch(
            "codec/strips.cl",
            "analyse_rows",
            (workers,),
            *(self._values, self._fresh, self._state, self._scratch, LEVELS, self._height, self._width),
            *(self._window.top, self._window.shape[0], self._fed, count, workers, work),
            *(*self._values.shape[:2], self._fresh.shape[1], self._state.shape[1], self._values.shape[2]),
        )
        self._fed += count
