"""How the codec `klt` finds its step: a few pieces of a map are tried, then more of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.symbols import zero_order_bits
from clrelight.codec.entropy.unit_index import index_bytes
from clrelight.codec.entropy.units import LEVELS, Window, is_one_tile
from clrelight.codec.formats.klt_pieces import Pieces, Tried
from clrelight.codec.formats.klt_tiles import TileEncoder
from clrelight.codec.formats.klt_trials import Trial, list_pieces, list_samples, search_step
from clrelight.codec.formats.klt_units import HEAD_SIZE, count_streams, pack_axes
from clrelight.codec.transforms.colour import RADIANCE, colour_axes
from clrelight.codec.transforms.local_axes import MOST_TURNED, cut_cells, guess_step, turn_axes
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.principal import MAX_ENTRY, MEAN_STEPS, STEP_RANGE, Axes, quantise_axes, round_jointly
from clrelight.codec.transforms.whitening import whitening_of
from clrelight.codec.workspace import Progress
from clrelight.memory import ARRAY_MEMORY

_TRIED = 0.08
"""An axis along which pixels deviate less than this part of a step is not tried."""
_AXIS_MULTIPLIER = 0.1
"""Squared steps of error that a bit of an axis must save: the faintest planes may be what lights from one side show."""
_FIRST, _FINE, _GUESSES = -5.0, -6.0, 3
"""Logarithms of the first step that is tried where nothing is known, and of that by whose planes a step is guessed;
times that it is guessed, by the planes that the guess before asks for.
"""
_NEARLY, _FOUND, _FEW = (0.93, 0.97, 1.0), (0.95, 0.99, 1.04), 4
"""Parts of a budget where a search on every n-th piece ends, and aims; and those of one on all."""
NEAR = (0.9, 0.997, 1.1)
"""The same where what comes after makes up for the rest."""
_FEW_ENTRIES = 4096
"""Values of axes whose coded tables a trial weighs; of more it reckons them."""
_PIECES_COST = 1.05
"""What pieces take of what a map does for each of their pixels: 1.03 to 1.07."""


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
        self._whitening = whitening_of(
            shape, pixels.of_places, colour_axes(metric, transfer), pixels.basis, pixels.lights_i3
        )
        largest = float(np.abs(self._whitening.mean_d).max())
        # Where pixels differ little from their mean, a rate asks for steps that the table of the mean cannot hold.
        self._finest = max(STEP_RANGE[0], 1.01 * largest * MEAN_STEPS / MAX_ENTRY)
        self._windows: list[Window] = []
        self._pieces: dict[int, Pieces] = {}
        self._prepared = 0
        self._tried: dict[tuple[float, int], dict[int, Tried]] = {}
        self._exact = self._whitening.exact(0)
        self._packed: tuple[Axes, float, bytes] | None = None
        self._of_entropy: tuple[int, float] | None = None
        self._surely = False
        self._begun: float | None = None

    def _mean(self, step: float) -> NDArray[np.int64]:
        return round_jointly(self._whitening.mean_d * (MEAN_STEPS / step), self._whitening.root_nn)

    def _prepare(self, count: int) -> None:
        """List pieces of which so many planes can be tried."""
        if count <= self._prepared:
            return
        _, height, width, _ = self._shape
        # The next step may be finer.
        count = min(max(count * 9 // 8 + 1, self._prepared * 3 // 2), len(self._whitening.deviation_j))
        self._windows, self._pieces = list_pieces(height, width, count, self._memory), {}
        self._tried, self._exact = {}, self._whitening.exact(count)
        self._prepared = count

    def _matter(self, step: float) -> int:
        """Return the number of axes that may be worth their bits at a step."""
        return int((self._whitening.deviation_j > _TRIED * step).sum())

    def _cells(self, count: int) -> tuple[NDArray[np.float32], float]:
        """Return cells of the first planes of a part of the map, and how many times its pixels the map has."""
        windows = list_samples(self._shape[1], self._shape[2], count)
        planes_jnyx = self.take_pieces(windows, self._whitening.exact(count)).host_planes(self.device)
        return cut_cells(planes_jnyx, LEVELS), self._n_pixel / sum(window.n_pixel for window in windows)

    def _turn(self, cells_jsc: NDArray[np.float32], step: float) -> None:
        """Turn the axes that matter at a step."""
        self._whitening = self._whitening.turned(turn_axes(cells_jsc[: min(self._matter(step), MOST_TURNED)], step))
        self._begun, self._pieces, self._prepared = float(np.log2(step)), {}, 0

    def _begin(self, budget: int) -> float:
        """Return the logarithm of a step that takes about a budget, and turn the axes, once."""
        if self._begun is None:
            least, largest = self._bounds()
            self._begun, loudest = _FIRST, float(self._whitening.deviation_j[0])
            if 0.0 < loudest < np.inf:
                place = min(max(min(_FINE, float(np.log2(loudest))), least), largest)
                for _ in range(_GUESSES):
                    count = max(self._matter(2.0**place), 1)
                    cells_jsc, share = self._cells(count)
                    place = guess_step(cells_jsc, share, 8.0 * budget, (least, largest))
                    if self._matter(2.0**place) <= count:
                        break
                self._turn(cells_jsc, 2.0**place)
        return self._begun

    def _try(self, step: float, every: int = 1) -> Trial:
        """Return about the bytes at a step, and the axes that are worth theirs, by every n-th piece."""
        count = self._matter(step)
        self._prepare(count)
        vectors, deviation = self._whitening.vectors_jd[:count], self._whitening.deviation_j[:count]
        axes = quantise_axes(vectors, deviation, self._n_pixel, step, self._whitening.root_nn)
        streams, sizes, axis_bits = 0.0, np.zeros(0), 0.0
        if count:
            # Every second piece, or each, is also every fourth.
            chosen = range(len(self._windows))[_FEW // 2 % every :: every] or range(len(self._windows))
            tried = self._try_pieces(chosen, step, count)
            sizes, areas = np.array([each.size for each in tried]), np.array([self._windows[n].n_pixel for n in chosen])
            # Streams of a piece's coarse levels are shorter than those of a map, and learn as much anew.
            share = self._n_pixel / areas.sum() / (_PIECES_COST if len(self._windows) > 1 else 1.0)
            bits_j = np.sum([each.bits_j for each in tried], axis=0) * share
            energy_j = np.sum([each.energy_j for each in tried], axis=0) * share / step**2
            saved_j = energy_j - np.sum([each.error_j for each in tried], axis=0) * share
            saved_j -= energy_j * self._whitening.cost_j(axes.vectors_jd - vectors)
            axis_bits_j = np.array([zero_order_bits(np.abs(row)) for row in axes.entries_jd])
            pays = saved_j > _AXIS_MULTIPLIER * (bits_j + axis_bits_j)
            axes = Axes(axes.entries_jd[pays], axes.scales_j[pays])
            streams, axis_bits = float(sizes.sum() * share - bits_j[~pays].sum() / 8.0), float(axis_bits_j[pays].sum())
            sizes = sizes * share / self._n_pixel * len(areas)
        size = self._about_table_bytes(axes, step, axis_bits) + self._about_index_bytes(streams) + streams
        return Trial(step, size, axes, sizes)

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
        for group in sorted({number % _FEW for number in missing}):
            if group not in self._pieces:
                self._pieces[group] = self.take_pieces(self._windows[group::_FEW], planes)
            tried = self.try_pieces(self._pieces[group], step, count)
            found |= zip(range(group, len(self._windows), _FEW), tried, strict=True)
        return [found[n] for n in chosen]

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
            self._packed = axes, step, pack_axes(self._whitening.rotation_cc, axes, self._mean(step))
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
        place = self._begin(budget)
        _, height, width, _ = self._shape
        for stage in range(2):
            # One tile is coded until its bytes fit.
            one = is_one_tile(height, width, self._prepared, self._memory)
            every, aims = (2 if one else 1, _FOUND) if stage else (_FEW, _NEARLY)
            place, trial = self._search(budget, place, every, _NEARLY if surely else NEAR if one else aims)
            if len(self._windows) <= 1:
                break
        return trial

    def _search(self, budget: int, place: float, every: int, aims: tuple[float, float, float]) -> tuple[float, Trial]:
        """Return the logarithm of a step, and its trial on every n-th piece; `aims` as of `search_step`."""
        trials = dict[float, Trial]()

        def count(place: float) -> float:
            trials[place] = self._try(2.0**place, every)
            return trials[place].size

        place = search_step(count, place, self._bounds(), budget, aims)
        return place, trials[place]

    def _bounds(self) -> tuple[float, float]:
        return float(np.log2(self._finest)), float(np.log2(STEP_RANGE[1]))
