"""How the codec `klt` finds its step, and what it writes: body 4."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.symbols import zero_order_bits
from clrelight.codec.entropy.unit_index import index_bytes
from clrelight.codec.entropy.unit_streams import Coded
from clrelight.codec.entropy.units import Tile, Window, list_tiles, whole_tile
from clrelight.codec.formats.klt_tiles import MULTIPLIER, TileEncoder, Tried, encode_elsewhere
from clrelight.codec.formats.klt_trials import (
    MULTIPLIER_POWER,
    MULTIPLIERS,
    Part,
    Trial,
    fill_by_multiplier,
    foretell,
    list_pieces,
    search_step,
)
from clrelight.codec.formats.klt_units import HEAD_SIZE, Head, count_streams, is_together, pack_axes, pack_body
from clrelight.codec.transforms.colour import RADIANCE, colour_axes
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.principal import MAX_ENTRY, MEAN_STEPS, STEP_RANGE, Axes, quantise_axes
from clrelight.codec.transforms.strips import Strips
from clrelight.codec.transforms.whitening import Planes, whitening_of
from clrelight.codec.workspace import Progress
from clrelight.errors import InputError
from clrelight.memory import ARRAY_MEMORY

_TRIED = 0.08
"""An axis along which pixels deviate less than this part of a step is not tried."""
_AXIS_MULTIPLIER = 0.1
"""Squared steps of error that a bit of an axis must save: the faintest planes may be what lights from one side show."""
_LEAST_USED, _AIM = 0.992, 0.997
_FOUND, _NEARLY, _FEW = (0.985, 0.993), (0.93, 0.97), 4
"""Parts of a budget where a search on all pieces ends, and one on every n-th; and where they aim."""
_LEAST_FILLED, _MAX_PASSES = 0.99, 3
_STEP_POWER = 0.9
"""Steps grow about with this power of what bytes are to shrink by."""


class Encoder(TileEncoder):
    """A map ready to be encoded at any step.

    Parameters
    ----------
    pixels : Pixels
        The map.
    transfer : str
        The curve behind which what `pixels` gives is.
    metric : str
        One of `clrelight.codec.transforms.colour.METRICS`: which errors cost alike.
    memory : int
        Bytes that the planes of a tile may take.
    progress : callable
        Told how many rows of the image are coded.
    """

    def __init__(
        self,
        pixels: Pixels,
        transfer: str,
        metric: str = RADIANCE,
        memory: int = ARRAY_MEMORY,
        progress: Progress = lambda done, total: None,
    ) -> None:
        super().__init__(pixels)
        self._progress = progress
        shape, self._transfer, self._memory = pixels.shape, transfer, memory
        self._n_pixel = shape[1] * shape[2]
        self._whitening = whitening_of(shape, pixels.of_row, colour_axes(metric, transfer), pixels.basis)
        largest = float(np.abs(self._whitening.mean_d).max())
        # Where pixels differ little from their mean, a rate asks for steps that the table of the mean cannot hold.
        self._finest = max(STEP_RANGE[0], 1.01 * largest * MEAN_STEPS / MAX_ENTRY)
        self._windows: list[Window] = []
        self._pieces: list[Part] = []
        self._prepared = 0

    def encode(self, step: float) -> tuple[bytes, dict[str, float]]:
        """Return the body at a step, and the step with the number of planes; InputError if the step is too fine."""
        step = float(np.float32(step))
        if step < self._finest:
            raise InputError(f"klt step must be {self._finest:.3g} or more for this map, got {step:g}")
        axes = self._try(step).axes
        planes, streams = self._whitening.solved(axes), [b""] * count_streams(self._shape)
        tiles = self._tiles(axes)
        for tile, coded in zip(tiles, self._encode_tiles(tiles, planes, step, MULTIPLIER), strict=True):
            self._collect(streams, tile, coded)
        return self._pack(axes, step, streams), {"step": step, "planes": float(len(axes.scales_j))}

    def encode_within(self, budget: int) -> tuple[bytes, dict[str, float]]:
        """Return the body that fills a budget of bytes best, and what was found; InputError if none is as small."""
        trial = self._find_step(budget)
        tiles = self._tiles(trial.axes)
        if len(tiles) <= 1:
            body, step = self._fit_step(budget, trial, tiles)
        else:
            body, step = self._fit_multipliers(budget, trial, tiles)
        return body, {"step": step, "planes": float(len(trial.axes.scales_j))}

    def _collect(self, streams: list[bytes], tile: Tile, coded: Coded) -> None:
        """Put a tile's streams among those of the image."""
        for t, stream in zip(tile.streams, coded.streams, strict=True):
            streams[t] = stream
        self._progress(tile.bottom, self._shape[1])

    def _pack(self, axes: Axes, step: float, streams: list[bytes]) -> bytes:
        whitening = self._whitening
        if not len(axes.scales_j):
            streams = []
        head = Head(whitening.exponent, step, len(axes.scales_j), self._transfer, 0, self._pixels.basis)
        return pack_body(head, whitening.rotation_cc, axes, self._mean(step), streams)

    def _mean(self, step: float) -> NDArray[np.int64]:
        return np.rint(self._whitening.mean_d * (MEAN_STEPS / step)).astype(np.int64)

    # Trials: on pieces of a large map, and in exact coordinates.

    def _prepare(self, count: int) -> None:
        """Make the first planes of the pieces."""
        if count <= self._prepared:
            return
        _, height, width, _ = self._shape
        count = min(max(count, self._prepared * 3 // 2), len(self._whitening.deviation_j))
        self._windows = list_pieces(height, width, count, self._memory)
        if self._pixels.elsewhere is None:
            planes = self._whitening.exact(count)
            self._pieces = [self.take_part(window, None, planes) for window in self._windows]
        self._prepared = count

    def _encode_tiles(self, tiles: list[Tile], planes: Planes, step: float, multiplier: float) -> Iterator[Coded]:
        """Return the streams of tiles, one after another; where others help, parts of all are begun at once."""
        coder, sides = self._pixels.elsewhere, (self._shape[1], self._shape[2])
        if coder is not None and not is_together(self._shape):
            return encode_elsewhere(coder, tiles, sides, planes, self._pixels.transfer, step, multiplier)
        strips = self._strips(planes, tiles)
        return (self.encode_here(tile, planes, step, multiplier, strips) for tile in tiles)

    def _strips(self, planes: Planes, tiles: list[Tile]) -> Strips | None:
        return Strips.of(self._pixels, planes, tiles) if self._pixels.elsewhere is None else None

    def _encode_tile(self, tile: Tile, planes: Planes, step: float, multiplier: float, strips: Strips | None) -> Coded:
        if self._pixels.elsewhere is None:
            return self.encode_here(tile, planes, step, multiplier, strips)
        return next(self._encode_tiles([tile], planes, step, multiplier))

    def _try(self, step: float, every: int = 1) -> Trial:
        """Return about the bytes at a step, and the axes that are worth theirs, by every n-th piece."""
        count = int((self._whitening.deviation_j > _TRIED * step).sum())
        self._prepare(count)
        vectors, deviation = self._whitening.vectors_jd[:count], self._whitening.deviation_j[:count]
        axes = quantise_axes(vectors, deviation, self._n_pixel, step)
        streams, sizes = 0.0, np.zeros(0)
        if count:
            chosen = range(len(self._windows))[every // 2 :: every] or range(len(self._windows))
            tried = self._try_pieces(chosen, step, count)
            sizes, areas = np.array([each.size for each in tried]), np.array([self._windows[n].n_pixel for n in chosen])
            share = self._n_pixel / areas.sum()
            bits_j = np.sum([each.bits_j for each in tried], axis=0) * share
            energy_j = np.sum([each.energy_j for each in tried], axis=0) * share / step**2
            saved_j = energy_j - np.sum([each.error_j for each in tried], axis=0) * share
            saved_j -= energy_j * ((axes.vectors_jd - vectors) ** 2).sum(axis=1)
            pays = saved_j > _AXIS_MULTIPLIER * (bits_j + [zero_order_bits(np.abs(row)) for row in axes.entries_jd])
            axes = Axes(axes.entries_jd[pays], axes.scales_j[pays])
            streams = float(sizes.sum() * share - bits_j[~pays].sum() / 8.0)
            sizes = sizes / areas
        size = self._fixed_bytes(axes, step, streams) + streams
        return Trial(step, size, axes, sizes)

    def _try_pieces(self, chosen: Sequence[int], step: float, count: int) -> list[Tried]:
        """Return what the first planes of some pieces take at a step."""
        elsewhere = self._pixels.elsewhere
        if elsewhere is not None:
            windows, planes = [self._windows[n] for n in chosen], self._whitening.exact(self._prepared)
            return elsewhere.try_pieces(windows, planes, self._pixels.transfer, step, count)
        return [self.try_piece(self._pieces[n], step, count) for n in chosen]

    def _fixed_bytes(self, axes: Axes, step: float, streams: float) -> float:
        """Return the bytes beside those of streams, which take about so many."""
        tables = pack_axes(self._whitening.rotation_cc, axes, self._mean(step))
        return HEAD_SIZE + len(tables) + self._index_about(streams)

    def _index_about(self, streams: float) -> float:
        count = count_streams(self._shape)
        return index_bytes([int(streams / count) + 1] * count)

    def _find_step(self, budget: int) -> Trial:
        """Return the trial of a step at which the map takes about as many bytes: by a few pieces first."""
        place = -5.0
        for every, aims in ((_FEW, _NEARLY), (1, _FOUND)):
            trials: dict[float, Trial] = {}

            def count(place: float, every: int = every, trials: dict[float, Trial] = trials) -> float:
                trials[place] = self._try(2.0**place, every)
                return trials[place].size

            place = search_step(count, place, self._bounds(), budget, aims)
            if len(self._windows) <= 1:
                break
        return trials[place]

    def _bounds(self) -> tuple[float, float]:
        return float(np.log2(self._finest)), float(np.log2(STEP_RANGE[1]))

    # What is written: planes solved against the axes as they are coded.

    def _tiles(self, axes: Axes) -> list[Tile]:
        count, (_, height, width, _) = len(axes.scales_j), self._shape
        if not count:
            return []
        return (
            [whole_tile(height, width, [0])]
            if is_together(self._shape)
            else list_tiles(height, width, count, self._memory)
        )

    def _fit_step(self, budget: int, trial: Trial, tiles: list[Tile]) -> tuple[bytes, float]:
        """Return the body of a map that is one tile, at the step where it fits the budget best, and that step."""
        planes = self._whitening.solved(trial.axes)
        parts = [self.take_part(tile.window, tile, planes) for tile in tiles]
        fitting: list[tuple[int, bytes, float]] = []
        least = 0

        def count(place: float) -> float:
            nonlocal least
            exact = float(np.float32(2.0**place))
            streams = [s for part in parts for s in self.encode_part(part, exact, keep=True).streams]
            body = self._pack(trial.axes, exact, streams)
            least = len(body)
            if len(body) <= budget:
                fitting.append((len(body), body, exact))
            return len(body)

        search_step(count, float(np.log2(trial.step)), self._bounds(), budget, (_LEAST_USED, _AIM))
        if not fitting:
            raise InputError(f"klt needs {least} bytes for this map even at its coarsest step, the budget is {budget}")
        _, body, step = max(fitting, key=lambda each: each[0])
        return body, step

    def _fit_multipliers(self, budget: int, trial: Trial, tiles: list[Tile]) -> tuple[bytes, float]:
        """Return the body of a map of many tiles, and its step; the multiplier saves what tiles take too much."""
        rows, step = [(each.top + each.bottom) // 2 for each in self._windows], trial.step
        foretold = foretell(rows, trial.of_pixel, tiles)
        best: tuple[bytes, float] | None = None
        least = 0
        for _ in range(_MAX_PASSES):
            step = float(np.float32(step))
            body, foretold = self._pass_tiles(budget, step, trial.axes, tiles, foretold)
            least = len(body)
            if len(body) <= budget and (best is None or len(body) > len(best[0])):
                best = body, step
            if _LEAST_FILLED * budget <= len(body) <= budget:
                break
            # At the usual multiplier, tiles would have taken what is foretold of them now.
            factor = (float(foretold.sum()) / (_AIM * budget)) ** _STEP_POWER
            step, before = min(max(step * factor, self._finest), STEP_RANGE[1]), step
            foretold *= (before / step) ** (1.0 / _STEP_POWER)
        if best is None:
            raise InputError(f"klt needs {least} bytes for this map at step {step:.3g}, the budget is {budget}")
        return best

    def _pass_tiles(
        self, budget: int, step: float, axes: Axes, tiles: list[Tile], foretold: NDArray[np.float64]
    ) -> tuple[bytes, NDArray[np.float64]]:
        """Return a body, and about the bytes that each tile would have at the usual multiplier."""
        planes, streams = self._whitening.solved(axes), [b""] * count_streams(self._shape)
        self._pieces, self._prepared = [], 0  # their memory is that of tiles now
        fixed = self._fixed_bytes(axes, step, float(budget))
        spent, usual, strips = 0.0, np.zeros(len(tiles)), self._strips(planes, tiles)
        for number, tile in enumerate(tiles):
            left = budget - fixed - spent
            # What has come so far tells how the trials err.
            trust = float(usual.sum() / foretold[:number].sum()) if number else 1.0
            ratio = max(left, 1.0) / (float(foretold[number:].sum()) * trust)
            multiplier = min(max(MULTIPLIER * ratio ** (-1.0 / MULTIPLIER_POWER), MULTIPLIERS[0]), MULTIPLIERS[1])
            if number + 1 == len(tiles):
                strips = None
                coded, multiplier = fill_by_multiplier(self._trying(tile, planes, step), left, multiplier)
            else:
                coded = self._encode_tile(tile, planes, step, multiplier, strips)
            spent += coded.size
            usual[number] = coded.size * (multiplier / MULTIPLIER) ** MULTIPLIER_POWER
            self._collect(streams, tile, coded)
        return self._pack(axes, step, streams), usual

    def _trying(self, tile: Tile, planes: Planes, step: float) -> Callable[[float], Coded]:
        """Return what codes a tile at any multiplier."""
        if self._pixels.elsewhere is not None:
            return functools.partial(self._encode_tile, tile, planes, step, strips=None)
        self._pixels.forget()  # indices of this one take as much again as its values
        part = self.take_part(tile.window, tile, planes, lent=True)
        return functools.partial(self.encode_part, part, step, keep=True)
