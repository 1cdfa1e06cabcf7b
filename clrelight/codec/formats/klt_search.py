"""How the codec `klt` finds its step: a few pieces of a map are tried, then more of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.symbols import zero_order_bits
from clrelight.codec.entropy.unit_index import index_bytes
from clrelight.codec.entropy.units import LEVELS, Window, is_one_tile
from clrelight.codec.formats.klt_missed import around, missed_pixels
from clrelight.codec.formats.klt_pieces import Pieces, Tried
from clrelight.codec.formats.klt_tiles import LARGEST_ERROR, TileEncoder
from clrelight.codec.formats.klt_trials import STEP_POWER, Trial, list_pieces, list_samples, search_step
from clrelight.codec.formats.klt_units import HEAD_SIZE, count_streams, pack_axes
from clrelight.codec.transforms.colour import RADIANCE, colour_axes
from clrelight.codec.transforms.local_axes import MOST_TURNED, cut_cells, guess_step, turn_axes
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.principal import MAX_ENTRY, MEAN_STEPS, STEP_RANGE, Axes, quantise_axes, quantise_mean
from clrelight.codec.transforms.whitening import whitening_of
from clrelight.codec.workspace import Progress
from clrelight.memory import ARRAY_MEMORY

_FIRST_STEP = 2.0**-5
_TRIED = 0.08
"""An axis along which pixels deviate less than this part of a step is not tried."""
_AXIS_MULTIPLIER = 0.1
"""Squared steps of error that a bit of an axis must save: the faintest planes may be what lights from one side show."""
_ROUGHLY, _NEARLY, _FOUND = (0.7, 0.98, 1.4), (0.93, 0.97, 1.0), (0.95, 0.99, 1.04)
"""Parts of a budget where a search on few pieces ends, and aims; those of one that tells surely; and of the last."""
NEAR = (0.9, 0.997, 1.1)
"""The same where what comes after makes up for the rest."""
_FEW, _MANY, _AT_ONCE = 3, 16, 16
"""Pieces of the first search, those of the last where the map itself is coded until it fits, and those that lie in
memory together."""
_FIRST = 3
"""Of the numbers by which pieces are chosen, the first: 0 would take a corner."""
_FINE_STEP, _GUESSES = 2.0**-6, 3
"""A step by whose planes another is guessed; times that it is guessed, by the planes that the guess before asks for."""
_FEW_ENTRIES = 4096
"""Values of axes whose coded tables a trial weighs; of more it reckons them."""
_COST = 0.1, -0.45
"""Of the bytes of pieces, this part is what they take more than a map does, times this power of the bits of a pixel:
their streams learn the same from fewer samples."""


class StepFinder(TileEncoder):
    """A map whose step is looked for.

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
    beside : sequence of (row, column)
        Pixels that count for the axes beside those of the sample, the first above all.
    """

    def __init__(
        self,
        pixels: Pixels,
        transfer: str,
        metric: str = RADIANCE,
        memory: int = ARRAY_MEMORY,
        progress: Progress = lambda done, total: None,
        beside: Sequence[tuple[int, int]] = (),
    ) -> None:
        super().__init__(pixels)
        self._progress, self._beside = progress, beside
        shape, self._transfer, self._memory = pixels.shape, transfer, memory
        self._n_pixel = shape[1] * shape[2]
        self._whitening = whitening_of(
            shape, pixels.of_places, colour_axes(metric, transfer), pixels.basis, pixels.lights_i3, beside
        )
        largest = float(np.abs(self._whitening.mean_d).max())
        # Where pixels differ little from their mean, a rate asks for steps that the table of the mean cannot hold.
        self._finest = max(STEP_RANGE[0], 1.01 * largest * MEAN_STEPS / MAX_ENTRY)
        self._windows: list[Window] = []
        self._pieces: dict[tuple[int, ...], Pieces] = {}
        self._prepared = 0
        self._tried: dict[tuple[float, int], dict[int, Tried]] = {}
        self._exact = self._whitening.exact(0)
        self._packed: tuple[Axes, float, bytes] | None = None
        self._meant: tuple[float, tuple[int, NDArray[np.int64]]] | None = None
        self._of_entropy: tuple[int, float] | None = None
        self._surely = False
        self._begun: float | None = None

    def _mean(self, step: float) -> tuple[int, NDArray[np.int64]]:
        """Return the mean's fineness, and its entries; the last are remembered."""
        if self._meant is None or self._meant[0] != step:
            mean_d, root_nn = self._whitening.mean_d, self._whitening.root_nn
            self._meant = step, quantise_mean(mean_d, self._n_pixel, step, root_nn)
        return self._meant[1]

    def _prepare(self, count: int) -> None:
        """List pieces of which so many planes can be tried."""
        if count <= self._prepared:
            return
        _, height, width, _ = self._shape
        count = min(max(_with_spare(count), self._prepared * 3 // 2), len(self._whitening.deviation_j))
        self._windows, self._pieces = self._with_beside(list_pieces(height, width, count, self._memory)), {}
        self._tried, self._exact = {}, self._whitening.exact(count)
        self._prepared = count

    def _with_beside(self, windows: list[Window]) -> list[Window]:
        return around(windows, self._beside[0], *self._shape[1:3]) if self._beside else windows

    def missed(self, step: float) -> list[tuple[int, int]]:
        """Return pixels that lie over a step from the mean, the farthest first, at most some hundred.

        None at all where the sample has others that do: these have had their chance.
        """
        return [] if self._count(step) else missed_pixels(self._pixels, self._whitening, step)

    def _count(self, step: float) -> int:
        """Return the number of axes that may be worth their bits at a step."""
        return int((self._whitening.deviation_j > _TRIED * step).sum())

    def _cells(self, count: int) -> tuple[NDArray[np.float32], float]:
        """Return cells of the first planes of a part of the map, and how many times its pixels the map has."""
        windows = self._with_beside(list_samples(self._shape[1], self._shape[2], count))
        planes_jnyx = self.take_pieces(windows, self._whitening.exact(count)).host_planes(self.device)
        return cut_cells(planes_jnyx, LEVELS), self._n_pixel / sum(window.n_pixel for window in windows)

    def _turn(self, cells_jsc: NDArray[np.float32], step: float) -> None:
        """Turn the axes that matter at a step."""
        turned = min(self._count(step), MOST_TURNED)
        self._whitening = self._whitening.turned(turn_axes(cells_jsc[:turned], step))
        self._begun, self._pieces, self._prepared = step, {}, 0

    def _begin(self, budget: int) -> float:
        """Return a step that takes about a budget, and turn the axes, once."""
        if self._begun is None:
            self._begun, loudest = _FIRST_STEP, float(self._whitening.deviation_j[0])
            if 0.0 < loudest < np.inf:
                step = self._bounded(min(_FINE_STEP, loudest))
                for _ in range(_GUESSES):
                    count = max(self._count(step), 1)
                    cells_jsc, share = self._cells(count)
                    step = 2.0 ** guess_step(cells_jsc, share, 8.0 * budget, self._bounds())
                    if self._count(step) <= count:
                        break
                self._turn(cells_jsc, step)
        return self._begun

    def _try(self, step: float, most: int | None = None) -> Trial:
        """Return about the bytes at a step, and the axes that are worth theirs, by so many pieces or all."""
        count = self._count(step)
        self._prepare(count)
        vectors, deviation = self._whitening.vectors_jd[:count], self._whitening.deviation_j[:count]
        axes = quantise_axes(vectors, deviation, self._n_pixel, step, self._whitening.root_nn)
        streams, sizes, axis_bits, rows = 0.0, np.zeros(0), 0.0, list[int]()
        if count:
            chosen = _choose(len(self._windows), None if self._beside else most)
            tried = self._try_pieces(chosen, step, count)
            rows = [(self._windows[n].top + self._windows[n].bottom) // 2 for n in chosen]
            sizes, areas = np.array([each.size for each in tried]), np.array([self._windows[n].n_pixel for n in chosen])
            share = self._n_pixel / areas.sum()
            if len(self._windows) > 1:
                share /= 1.0 + _COST[0] * max(8.0 * sizes.sum() / areas.sum(), 0.1) ** _COST[1]
            bits_j = np.sum([each.bits_j for each in tried], axis=0) * share
            energy_j = np.sum([each.energy_j for each in tried], axis=0) * share / step**2
            error_j = np.sum([each.error_j for each in tried], axis=0)
            saved_j = energy_j - error_j * share
            saved_j -= energy_j * self._whitening.cost_j(axes.vectors_jd - vectors)
            axis_bits_j = np.array([zero_order_bits(np.abs(row)) for row in axes.entries_jd])
            pays = saved_j > _AXIS_MULTIPLIER * (bits_j + axis_bits_j)
            # Of what was cut off there is no telling: it is coded, and refused there.
            pays |= ~(error_j < LARGEST_ERROR)
            axes = Axes(axes.entries_jd[pays], axes.scales_j[pays])
            streams, axis_bits = float(sizes.sum() * share - bits_j[~pays].sum() / 8.0), float(axis_bits_j[pays].sum())
            sizes = sizes * share / self._n_pixel * len(areas)
        size = self._about_table_bytes(axes, step, axis_bits) + self._about_index_bytes(streams) + streams
        return Trial(step, size, axes, sizes, rows)

    def _try_pieces(self, chosen: Sequence[int], step: float, count: int) -> list[Tried]:
        """Return what the first planes of some pieces take at a step."""
        elsewhere, planes = self._pixels.elsewhere, self._exact
        found = self._tried.setdefault((step, count), {})
        missing = [n for n in chosen if n not in found]
        if elsewhere is not None:
            windows = [self._windows[n] for n in missing]
            if windows:
                found |= zip(
                    missing, elsewhere.try_pieces(windows, planes, self._pixels.transfer, step, count), strict=True
                )
            return [found[n] for n in chosen]
        for numbers in self._groups(missing):
            pieces = self._pieces.get(numbers)
            if pieces is None or pieces.values.shape[0] < count:
                held = min(_with_spare(count), len(planes[1]))
                self._pieces.pop(numbers, None)
                pieces = self.take_pieces([self._windows[n] for n in numbers], (planes[0][:held], planes[1][:held]))
                self._pieces[numbers] = pieces
            found |= zip(numbers, self.try_pieces(pieces, step, count), strict=True)
        return [found[n] for n in chosen]

    def _groups(self, missing: Sequence[int]) -> list[tuple[int, ...]]:
        """Return pieces in groups that are tried together: those that lie in memory, and of the others some at once."""
        held = [numbers for numbers in self._pieces if set(numbers) <= set(missing)]
        others = [n for n in missing if not any(n in numbers for numbers in held)]
        many = -(-len(others) // _AT_ONCE)
        return held + [tuple(others[i::many]) for i in range(many)]

    def _fixed_bytes(self, axes: Axes, step: float, streams: float) -> float:
        """Return the bytes beside those of streams, which take about so many."""
        return self._table_bytes(axes, step) + self._about_index_bytes(streams)

    def _about_index_bytes(self, streams: float) -> int:
        count = count_streams(self._shape)
        return index_bytes([int(streams / count) + 1] * count)

    def _table_bytes(self, axes: Axes, step: float) -> int:
        """Return the bytes of a body in front of its index."""
        return HEAD_SIZE + len(self._tables(axes, step))

    def _tables(self, axes: Axes, step: float) -> bytes:
        """Return the tables of a body; the last are remembered while streams fill a budget."""
        if self._packed is None or self._packed[0] is not axes or self._packed[1] != step:
            self._packed = axes, step, pack_axes(self._whitening.rotation_cc, axes, self._mean(step)[1])
        return self._packed[2]

    def _about_table_bytes(self, axes: Axes, step: float, bits: float) -> float:
        """Return the same, and of large tables about: what the first took of their entropy, others do too."""
        if axes.entries_jd.size <= _FEW_ENTRIES or not bits or self._surely:
            return self._table_bytes(axes, step)
        if self._of_entropy is None:
            beside = self._table_bytes(Axes(axes.entries_jd[:0], axes.scales_j[:0]), step)
            self._of_entropy = beside, (self._table_bytes(axes, step) - beside) / bits
        beside, of_a_bit = self._of_entropy
        return beside + of_a_bit * bits

    def _find_step(self, budget: int, *, surely: bool = False) -> Trial:
        """Return the trial of a step at which the map takes about as many bytes: by a few pieces first.

        Trials that are to tell `surely` take longer, and are not above the budget.
        """
        self._surely = surely
        step = self._begin(budget)
        self._prepare(self._count(step))
        if len(self._windows) > 1:
            step = likely_step(self._search(budget, step, _ROUGHLY, _FEW), budget)
        _, height, width, _ = self._shape
        # One tile is coded until its bytes fit.
        one = is_one_tile(height, width, self._prepared, self._memory)
        aims = _NEARLY if surely else NEAR if one else _FOUND
        return self._search(budget, step, aims, _MANY if one and not surely else None)

    def _search(self, budget: int, step: float, aims: tuple[float, float, float], most: int | None) -> Trial:
        """Return the trial of so many pieces that ends a search from a step on."""
        trials: dict[float, Trial] = {}

        def count(place: float) -> float:
            trials[place] = self._try(2.0**place, most)
            return trials[place].size

        return trials[search_step(count, float(np.log2(step)), self._bounds(), budget, aims)]

    def _bounds(self) -> tuple[float, float]:
        return float(np.log2(self._finest)), float(np.log2(STEP_RANGE[1]))

    def _bounded(self, step: float) -> float:
        return float(np.float32(min(max(step, self._finest), STEP_RANGE[1])))


def likely_step(trial: Trial, budget: int) -> float:
    """Return the step at which a budget is likely filled, by a trial near it."""
    return trial.step * float(trial.size / max(NEAR[1] * budget, 1.0)) ** STEP_POWER


def _with_spare(count: int) -> int:
    """Return so many planes, and those that the next step asks for beside if it is somewhat finer."""
    return count * 9 // 8 + 1


def _choose(count: int, most: int | None) -> list[int]:
    """Return which pieces are tried, some that lie all over a map or all; where they are more, all of the fewer are."""
    if most is None or count <= most:
        return list(range(count))
    # What multiples of the golden ratio leave over is spread, whatever the number.
    left = (np.arange(count) + _FIRST) * (5**0.5 - 1) / 2 % 1.0
    return sorted(np.argsort(left)[:most].tolist())
