"""How the codec `wavelet` finds its steps, and what it writes: body 6."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.unit_index import Stored, index_bytes
from clrelight.codec.entropy.unit_streams import Coded, default_tables, encode_streams
from clrelight.codec.entropy.units import (
    LEVELS,
    Tile,
    Window,
    lay_out,
    list_tiles,
    list_units,
    whole_tile,
)
from clrelight.codec.formats.klt_trials import search_step
from clrelight.codec.formats.wavelet_draft import draft_tables
from clrelight.codec.formats.wavelet_planes import (
    PIECE,
    SQUARE,
    Part,
    PlaneMaker,
    lay_out_squares,
    list_squares,
    list_windows,
    mask_of,
    scan,
)
from clrelight.codec.formats.wavelet_rates import Steps
from clrelight.codec.formats.wavelet_units import (
    ABSENT,
    MOST_COARSE,
    Tables,
    count_streams,
    pack_body,
    step_of,
)
from clrelight.codec.streams import Source
from clrelight.opencl.arguments import DeviceArray

MULTIPLIER = 0.12
"""Lagrange multiplier of rate–distortion optimisation: squared steps of error that a bit must save."""
_MULTIPLIER_LOG, _MULTIPLIERS_LOG = math.log2(MULTIPLIER), (-5.0, -1.0)
_FURTHER = (0.0, -0.05, 0.05, -0.1)
"""Octaves of the steps beside which multipliers are looked for."""
_USED, _AIM = 0.9905, 0.9955
"""Parts of the budget where the search ends, and that it aims at."""
_TRIED, _TRIED_BITS = 1 << 20, 1 << 20
"""Samples, or bits, that a trial takes at the most."""
_TRIALS, _NEAR, _PASSES, _EVEN = 5, 0.06, 4, 0.06
"""Trials and passes at the most, and octaves of bits that maps may be off where they end."""
_COARSE_SIZE = 3.0
"""Mean magnitude above which contexts do without the last bit."""


class Encoder:
    """Maps ready to be encoded.

    Parameters
    ----------
    source : Source
    budget : int
        Bytes of the body at most.
    alike : bool
        Whether every map gets the same rate, or all have the same step.
    """

    def __init__(self, source: Source, budget: int, alike: bool) -> None:
        self._source, self._device, self._budget, self._alike = source, source.device, budget, alike
        _, self._height, self._width, self._channel = self._shape = source.shape
        self._known = source.remember("wavelet scan", lambda: scan(source))
        self._tables = draft_tables(self._known, self._shape, budget)
        self._present = self._tables.present_m
        self._place = self._tables.places(self._channel)
        self._place_md = self._place[self._present]
        self._maker = PlaneMaker(source, self._known, self._tables.rotations(self._channel), self._place)
        self._exponent_m = self._known.exponent_k[self._present]
        self._steps = Steps(self._exponent_m, self._channel, alike)
        self._groups = self._tables.spans(self._channel)
        self._n_value = self._height * self._width * self._channel
        self._best = b""
        self._whole: Part | None = None
        self._index: DeviceArray | None = None

    def encode(self) -> bytes:
        """Return the body that fills the budget best."""
        if not len(self._present):
            return pack_body(self._tables, [])
        self._find_steps()
        self._steps.forget_bracket()
        for _ in range(_PASSES):
            size, bits_m = self._code_all(self._steps.codes())
            bits_m *= 8.0 * size / max(bits_m.sum(), 1.0)
            even = self._steps.correct(bits_m, 8.0 * _AIM * self._budget, self._n_value) < _EVEN
            if self._is_filled(size) and even:
                break
        else:
            self._fill()
        return self._best or self._black()

    def _is_filled(self, size: int) -> bool:
        return _USED * self._budget <= size <= self._budget

    def _fill(self) -> None:
        """Fill the budget by steps that grow and shrink together, and where those are too coarse, by the multiplier."""
        if self._is_filled(len(self._best)):
            return
        known: dict[bytes, int] = {}

        def by_steps(shift: float) -> float:
            codes_m = self._steps.codes(shift)
            key = codes_m.tobytes()
            if key not in known:
                known[key] = self._code_all(codes_m)[0]
            return known[key]

        budget, aims = self._budget, (_USED, _AIM, 1.0)
        shift = search_step(by_steps, 0.0, self._steps.bounds(), budget, aims)
        if not self._best or shift <= self._steps.bounds()[0]:
            return
        for further in _FURTHER:
            if self._is_filled(len(self._best)):
                return
            codes_m = self._steps.codes(shift + further)
            by_multiplier = functools.partial(self._count_by_multiplier, codes_m)
            search_step(by_multiplier, _MULTIPLIER_LOG, _MULTIPLIERS_LOG, budget, aims)

    def _count_by_multiplier(self, codes_m: NDArray[np.int64], place: float) -> float:
        return self._code_all(codes_m, 2.0**place)[0]

    def expect(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return errors of some wavelet coefficients, (n_present, channel, n), and which maps they are of."""
        if not len(self._present):
            return np.zeros((0, self._channel, 1)), self._present
        part = self._find_steps()[0]
        index, codes_m = self._device.empty(part.values.shape, np.int32), self._steps.codes()
        self._encode_part(part, codes_m, index=index)
        chosen_yx = mask_of(part.layout, part.values.shape[1:])
        found_mdp = self._device.download(index)[:, chosen_yx][self._place_md]
        exact_mdp = self._device.download(part.values)[:, chosen_yx][self._place_md]
        step_m = step_of(codes_m)
        errors_mdp = found_mdp * step_m[:, None, None] - np.ldexp(
            exact_mdp.astype(np.float64), self._exponent_m[:, None, None]
        )
        rotation_kdc = self._tables.rotations(self._channel)
        if rotation_kdc is not None:
            errors_mdp = np.einsum("mdc,mdp->mcp", rotation_kdc[self._present], errors_mdp, optimize=True)
        return errors_mdp, self._present

    def _black(self) -> bytes:
        """Return the body of maps that no rate is left for."""
        nothing = np.full(self._shape[0], ABSENT, np.int64)
        return pack_body(Tables(nothing, np.zeros((0, 0), np.uint8), False, 1), [])

    # Trials.

    def _find_steps(self) -> list[Part]:
        """Find steps by trials, decide which bits contexts do without, and return what was tried."""
        parts, n_map = self._trial_parts(), len(self._present)
        target = max(8.0 * (_AIM * self._budget - len(self._tables.pack()) - self._overhead()), 1.0)
        of_maps = np.concatenate([part.samples(self._device) for part in parts], axis=1)[self._place_md].reshape(
            n_map, -1
        )
        tried = of_maps
        if parts[0] is not self._whole and self._whole is not None:
            tried = parts[0].samples(self._device, coded=True)[self._place_md].reshape(n_map, -1)
        share = sum(part.n_pixel for part in parts) / (self._height * self._width)
        self._steps.guess(of_maps, self._exponent_m, target / (self._n_value * n_map))
        for trial in range(_TRIALS):
            codes_m = self._steps.codes()
            if trial < 2:
                self._choose_coarse(parts[0], codes_m)
            coded = [self._encode_part(part, codes_m) for part in parts]
            bits_m = np.sum([self._of_maps(c.bits_j) for c in coded], axis=0)
            taken = 8.0 * sum(c.size - 16 * len(self._groups) for c in coded)
            bits_m *= max(taken, 1.0) / max(bits_m.sum(), 1.0) / share
            if tried is not of_maps:
                bits_m *= self._steps.proxies(of_maps, self._exponent_m) / self._steps.proxies(tried, self._exponent_m)
            if self._steps.correct(bits_m, target, self._n_value) < _NEAR:
                break
        return parts

    def _of_maps(self, bits_j: NDArray[np.float64]) -> NDArray[np.float64]:
        return bits_j[self._place_md].sum(axis=1)

    def _overhead(self) -> float:
        """Return about the bytes of an index, and of the states of streams."""
        count = count_streams(self._shape, self._tables)
        return 16 * count + index_bytes([self._budget // count] * count)

    def _trial_parts(self) -> list[Part]:
        """Return what is tried: all of a small map, squares of a larger one, pieces of one that is many tiles."""
        n_pixel, n_plane = self._height * self._width, len(self._present) * self._channel
        rate = 8.0 * self._budget / max(n_pixel * n_plane, 1)
        tried = max(_TRIED, int(_TRIED_BITS / max(rate, 0.01))) // n_plane
        if self._is_one_tile():
            whole = self._take(whole_tile(self._height, self._width, []))
            self._whole = whole
            squares = list_squares(self._height, self._width, tried // SQUARE**2)
            if not squares:
                return [whole]
            layout = lay_out_squares(squares, self._height, self._width, whole.values.shape[2], self._groups)
            return [replace(whole, layout=layout, n_pixel=len(squares) * SQUARE**2)]
        windows = list_windows(self._height, self._width, max(tried // PIECE**2, 4))
        return [self._take_piece(window) for window in windows]

    def _is_one_tile(self) -> bool:
        held = 4 * len(self._present) * self._channel * self._height * self._width
        return self._tables.together or 2 * held <= self._source.workspace.memory_bytes

    def _take(self, tile: Tile) -> Part:
        values = self._maker.values(tile.window)
        layout = lay_out(
            tile.units, (self._height, self._width), tile.window, values.shape[2], self._tables.together, self._groups
        )
        return Part(values, layout, tile.window.shape[1], tile.n_pixel)

    def _take_piece(self, window: Window) -> Part:
        values, sides = self._maker.values(window), window.shape
        layout = lay_out(list_units(*sides), sides, Window(0, 0, *sides), values.shape[2], True, self._groups)
        return Part(values, layout, sides[1], sides[0] * sides[1])

    def _choose_coarse(self, part: Part, codes_m: NDArray[np.int64]) -> None:
        """Leave low bits out of contexts where indices are large."""
        size_jl = part.sizes(self._device)
        scale_m = np.exp2(self._exponent_m.astype(np.float64)) / step_of(codes_m)
        size_mdl = size_jl[self._place_md] * scale_m[:, None, None]
        bits = np.floor(np.log2(np.maximum(size_mdl / _COARSE_SIZE, 1.0)))
        coarse_ml = np.minimum(bits, MOST_COARSE).astype(np.uint8)
        # What large numbers take too many bits without it, against a byte each in the table.
        samples_l = 3.0 * self._height * self._width * 0.25 ** np.arange(1.0, LEVELS + 1)
        kept = ((np.maximum(bits - 3.0, 0.0) + 0.02 * bits) * samples_l).sum() > 8.0 * bits.size
        self._tables = replace(self._tables, coarse_ml=coarse_ml if kept else None)

    # What is written.

    def _encode_part(
        self, part: Part, codes_m: NDArray[np.int64], multiplier: float = MULTIPLIER, index: DeviceArray | None = None
    ) -> Coded:
        scale_j = np.empty(part.values.shape[0], np.float32)
        scale_j[self._place_md] = (np.exp2(self._exponent_m.astype(np.float64)) / step_of(codes_m))[:, None]
        if index is None:
            if self._index is None or self._index.shape != part.values.shape:
                self._index = self._device.empty(part.values.shape, np.int32)
            index = self._index
        coarse_jl = self._tables.coarse(self._channel)
        return encode_streams(
            self._device, part.layout, part.values, index, default_tables(), multiplier, scale_j, coarse_jl
        )

    def _code_all(self, codes_m: NDArray[np.int64], multiplier: float = MULTIPLIER) -> tuple[int, NDArray[np.float64]]:
        """Return the bytes of the body at some steps, and about the bits of each map; the best body is kept."""
        body, bits_m = self._make_body(codes_m, multiplier)
        if self._is_filled(len(body)) or len(self._best) < len(body) <= self._budget:
            self._best = body
        return len(body), bits_m

    def _make_body(self, codes_m: NDArray[np.int64], multiplier: float) -> tuple[bytes, NDArray[np.float64]]:
        code_k = self._tables.code_k.copy()
        code_k[self._present] = codes_m
        tables = replace(self._tables, code_k=code_k)
        if self._whole is not None:
            coded = self._encode_part(self._whole, codes_m, multiplier)
            return pack_body(tables, coded.streams), self._of_maps(coded.bits_j)
        bits_m, streams = np.zeros(len(codes_m)), [b""] * count_streams(self._shape, tables)
        where = Stored("wavelet", False, self._groups, np.zeros(0, np.int64), np.zeros(0, np.uint16))
        units = list_units(self._height, self._width)
        memory = self._source.workspace.memory_bytes // 2
        for tile in list_tiles(self._height, self._width, len(self._present) * self._channel, memory):
            coded = self._encode_part(self._take(tile), codes_m, multiplier)
            bits_m += self._of_maps(coded.bits_j)
            for number, stream in zip(where.numbers(units, tile.streams), coded.streams, strict=True):
                streams[number] = stream
            self._source.workspace.tell(tile.bottom, self._height)
        return pack_body(tables, streams), bits_m
