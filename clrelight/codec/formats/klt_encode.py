"""How the codec `klt` finds its step, and what it writes: body 4."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.unit_index import index_bytes
from clrelight.codec.entropy.unit_streams import Coded, samples_of
from clrelight.codec.entropy.units import Tile, list_tiles, whole_tile
from clrelight.codec.formats.klt_fill import MULTIPLIER_POWER, change_multiplier, fill
from clrelight.codec.formats.klt_last import Last, LastElsewhere, LastHere
from clrelight.codec.formats.klt_search import NEAR, StepFinder, likely_step
from clrelight.codec.formats.klt_steer import steer
from clrelight.codec.formats.klt_tiles import MULTIPLIER, encode_elsewhere
from clrelight.codec.formats.klt_trials import STEP_POWER, Trial, foretell, search_step
from clrelight.codec.formats.klt_units import Head, count_streams, is_together, pack_body, parse_body
from clrelight.codec.transforms.principal import STEP_RANGE, Axes
from clrelight.codec.transforms.strips import Strips
from clrelight.codec.transforms.whitening import Planes
from clrelight.errors import InputError, PayloadError

_USED = (0.992, 0.997, 1.0)
"""Parts of a budget where a search for the step of one stream ends, and aims; it ends at the last, too."""
_SLACK = 0.005
"""Part of a budget that they may leave."""
_STEERED = 0.9975
"""Part of a budget at which what is steered aims: it ends within the slack, mostly."""
_LEAST_FILLED, _AIM = 0.99, 0.997
_ENOUGH = (4, _LEAST_FILLED), (7, 0.985), (16, 0.0)
"""Before so many passes over all tiles, which part of a budget ends them; the last go on until anything fits."""
_HUGE = 64
"""Power of two of a map below which nothing that is made of it passes float32."""
_CHANGE = 1.02
"""Times by which a step then changes more than is foretold."""


class _NoRoomError(InputError):
    """A map with some axes takes more bytes than there are."""


class Encoder(StepFinder):
    """A map ready to be encoded at any step, or within any number of bytes."""

    def encode(self, step: float) -> tuple[bytes, dict[str, float]]:
        """Return the body at a step, and the step with the number of planes; InputError if the step is too fine."""
        step = float(np.float32(step))
        if step < self._finest:
            raise InputError(f"klt step must be {self._finest:.3g} or more for this map, got {step:g}")
        if count := self._count(step):
            self._turn(self._cells(count)[0], step)
        axes = self._try(step).axes
        planes, streams = self._whitening.solved(axes), [b""] * count_streams(self._shape)
        tiles = self._tiles(axes)
        for tile, coded in zip(tiles, self._encode_tiles(tiles, planes, step, MULTIPLIER), strict=True):
            self._collect(streams, tile, coded.streams)
        return self._pack(axes, step, streams), {"step": step, "planes": float(len(axes.scales_j))}

    def encode_within(self, budget: int) -> tuple[bytes, dict[str, float]]:
        """Return the body that fills a budget of bytes best, and what was found; InputError if none is as small."""
        for surely in (False, True):
            trial = self._find_step(budget, surely=surely)
            with suppress(_NoRoomError):  # axes of few bytes may take more than trials say
                return self._fit(budget, trial)
        none = Axes(trial.axes.entries_jd[:0], trial.axes.scales_j[:0])
        return self._fit(budget, replace(trial, axes=none))

    def check_kept(self, found: dict[str, float]) -> None:
        """Raise InputError where what was found makes zeros of numbers below the least normal one of float32."""
        is_tiny = self._whitening.exponent <= np.finfo(np.float32).minexp  # no map of zeros has this one
        if is_tiny and not found["planes"] and not self._mean(found["step"])[1].any():
            raise InputError("klt would make this map 0 everywhere: no number is above 1.2e-38; scale it")

    def check_decodes(self, body: bytes) -> None:
        """Raise InputError where decoders would refuse a body, for what axes and mean make passes float32."""
        if self._whitening.exponent < _HUGE:
            return
        try:
            parse_body(body, self._shape)
        except PayloadError:
            raise InputError(f"{self._brightest()}, too near the end of float32 for klt: scale the map") from None

    def _fit(self, budget: int, trial: Trial) -> tuple[bytes, dict[str, float]]:
        """Return the body with the axes of a trial; errors as of `encode_within`."""
        tiles = self._tiles(trial.axes)
        if not tiles or is_together(self._shape):
            body, step = self._fit_step(budget, trial, tiles)
        elif len(tiles) == 1:
            body, step = self._fit_streams(budget, trial, tiles[0])
        else:
            body, step = self._fit_multipliers(budget, trial, tiles)
        return body, {"step": step, "planes": float(len(trial.axes.scales_j))}

    def _collect(self, streams: list[bytes], tile: Tile, coded: Sequence[bytes]) -> None:
        """Put a tile's streams among those of the image."""
        for t, stream in zip(tile.streams, coded, strict=True):
            streams[t] = stream
        self._progress(tile.bottom, self._shape[1])

    def _pack(self, axes: Axes, step: float, streams: list[bytes]) -> bytes:
        whitening = self._whitening
        count, basis, fineness = len(axes.scales_j), self._pixels.basis, self._mean(step)[0]
        head = Head(whitening.exponent, step, count, self._transfer, 0, basis, fineness=fineness)
        return pack_body(head, self._tables(axes, step), streams if count else [])

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
        """Return the body of a map of one stream, at the step where it fits the budget best, and that step."""
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

        search_step(count, float(np.log2(likely_step(trial, budget))), self._bounds(), budget, _USED)
        if not fitting:
            raise _NoRoomError(
                f"klt needs {least} bytes for this map even at its coarsest step, the budget is {budget}"
            )
        _, body, step = max(fitting, key=lambda each: each[0])
        return body, step

    def _fit_streams(self, budget: int, trial: Trial, tile: Tile) -> tuple[bytes, float]:
        """Return the body of a map that is one tile of many streams, and its step."""
        axes, planes, exact, is_steered = trial.axes, self._whitening.solved(trial.axes), 0.0, True
        self._pieces, self._prepared = {}, 0  # their memory is that of the tile now
        part, streams = self.take_part(tile.window, tile, planes, lent=True), [b""] * count_streams(self._shape)

        def count(place: float) -> float:
            nonlocal exact
            exact = float(np.float32(2.0**place))
            last = LastHere(self, part, exact)
            if is_steered:
                room = _STEERED * budget - self._table_bytes(axes, exact)
                coded: Sequence[bytes] = steer(
                    last.again,
                    tile.units,
                    samples_of(part.layout),
                    MULTIPLIER,
                    lambda size_t: room - float(size_t.sum()) - index_bytes(size_t.astype(np.int64).tolist()),
                )
            else:
                coded = last.code(MULTIPLIER).streams
            self._collect(streams, tile, coded)
            return self._used_bytes(axes, exact, streams)

        step = self._bounded(likely_step(trial, budget))
        self._tables(axes, step)  # while the device makes planes
        for aims in (NEAR, _USED):
            is_steered = aims is NEAR
            place = search_step(count, float(np.log2(step)), self._bounds(), budget, aims)
            step = float(np.float32(2.0**place))
            if step != exact:
                count(place)
            if self._used_bytes(axes, step, streams) > aims[0] * budget:  # else there is no finer step
                self._fill(budget, axes, step, streams, (tile, LastHere(self, part, step), MULTIPLIER))
            if _LEAST_FILLED * budget <= self._used_bytes(axes, step, streams) <= budget:
                break  # multipliers do little where there are few bytes
        if len(body := self._pack(axes, step, streams)) > budget:
            raise _NoRoomError(f"klt needs {len(body)} bytes for this map at step {step:.3g}, the budget is {budget}")
        return body, step

    def _fit_multipliers(self, budget: int, trial: Trial, tiles: list[Tile]) -> tuple[bytes, float]:
        """Return the body of a map of many tiles, and its step; the multiplier saves what tiles take too much."""
        step = self._bounded(trial.step)
        foretold, usual = foretell(trial.rows, trial.of_pixel, tiles), np.full(len(tiles), MULTIPLIER)
        best: tuple[bytes, float] | None = None
        least, power, wanted, fine, coarse = 0, STEP_POWER, 0.0, 0.0, STEP_RANGE[1]
        for number in range(_ENOUGH[-1][0] - 1):
            body, taken, usual = self._pass_tiles(budget, step, trial.axes, tiles, foretold, usual)
            least, used = len(body), len(body) / max(budget, 1)
            if used <= 1.0 and (best is None or len(body) > len(best[0])):
                best = body, step
            enough = next(part for passes, part in _ENOUGH if number + 1 < passes)
            if (best is not None and len(best[0]) >= enough * budget) or (used > 1.0 and step >= STEP_RANGE[1]):
                break
            fine, coarse = (max(fine, step), coarse) if used > 1.0 else (fine, min(coarse, step))
            # How bytes hang on the multiplier is another thing for each map: now it is to be as it was.
            more, before = float(np.log(taken.sum() / (_AIM * budget))), step
            if wanted and wanted != more:
                power = min(max(power * wanted / (wanted - more), STEP_POWER / 2.0), 4.0 * STEP_POWER)
            step, wanted = step * float(np.exp(power * more)), more
            if number + 1 >= _ENOUGH[0][0] or not fine <= step <= coarse:  # some bytes fall faster than any power
                between = fine > 0.0 and coarse < STEP_RANGE[1]
                step = float(np.sqrt(fine * coarse)) if between else step * _CHANGE ** (1 if used > 1.0 else -1)
            step = self._bounded(step)
            foretold = taken * (before / step) ** (1.0 / power)
        if best is None:
            raise _NoRoomError(f"klt needs {least} bytes for this map at step {step:.3g}, the budget is {budget}")
        return best

    def _pass_tiles(
        self,
        budget: int,
        step: float,
        axes: Axes,
        tiles: list[Tile],
        foretold: NDArray[np.float64],
        usual: NDArray[np.float64],
    ) -> tuple[bytes, NDArray[np.float64], NDArray[np.float64]]:
        """Return a body, the bytes of each tile and the multiplier; at the `usual` ones they would be as foretold."""
        planes, streams = self._whitening.solved(axes), [b""] * count_streams(self._shape)
        self._pieces, self._prepared = {}, 0  # their memory is that of tiles now
        fixed, strips = self._fixed_bytes(axes, step, float(budget)), self._strips(planes, tiles)
        taken, likely, multiplier_i = np.zeros(len(tiles)), np.zeros(len(tiles)), usual.copy()
        for number, tile in enumerate(tiles):
            # What has come so far tells how the trials err.
            trust = float(likely.sum() / foretold[:number].sum()) if number else 1.0
            ratio = max(budget - fixed - taken.sum(), 1.0) / (float(foretold[number:].sum()) * trust)
            multiplier = multiplier_i[number] = change_multiplier(float(usual[number]), ratio)
            if number + 1 == len(tiles):
                strips = None
                last = self._take_last(tile, planes, step)
                coded = last.code(multiplier)
            else:
                coded = self._encode_tile(tile, planes, step, multiplier, strips)
            taken[number] = coded.size
            likely[number] = coded.size * (multiplier / usual[number]) ** MULTIPLIER_POWER
            self._collect(streams, tile, coded.streams)
        self._fill(budget, axes, step, streams, (tile, last, multiplier))
        return self._pack(axes, step, streams), taken, multiplier_i

    def _take_last(self, tile: Tile, planes: Planes, step: float) -> Last:
        """Return what codes the tile that comes last, here or elsewhere."""
        coder = self._pixels.elsewhere
        if coder is not None:
            return LastElsewhere(coder, tile, (self._shape[1], self._shape[2]), planes, self._pixels.transfer, step)
        self.forget()  # indices of this one take as much again as its values
        return LastHere(self, self.take_part(tile.window, tile, planes, lent=True), step)

    def _fill(self, budget: int, axes: Axes, step: float, streams: list[bytes], last: tuple[Tile, Last, float]) -> None:
        """Code streams of the tile that came last, at some multiplier, anew: the body fills a budget then."""
        tile, coder, usual = last

        def spare(coded: Sequence[bytes]) -> int:
            self._collect(streams, tile, coded)
            return budget - self._used_bytes(axes, step, streams)

        first = [streams[t] for t in tile.streams]
        self._collect(streams, tile, fill(coder.again, tile.units, first, usual, spare, _SLACK * budget))

    def _used_bytes(self, axes: Axes, step: float, streams: Sequence[bytes]) -> int:
        """Return the bytes of a body of streams."""
        sizes = [len(stream) for stream in streams]
        return self._table_bytes(axes, step) + index_bytes(sizes) + sum(sizes)
