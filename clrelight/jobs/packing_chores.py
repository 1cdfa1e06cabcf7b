"""The parts of `pack` as jobs: a process does one after the other, of one view, and keeps what they share."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.units import Tile, Window, tile_of
from clrelight.codec.formats.klt_last import CodedPart
from clrelight.codec.formats.klt_pieces import Pieces
from clrelight.codec.formats.klt_tiles import TileEncoder
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.whitening import Planes
from clrelight.codec.views import Region
from clrelight.codec.workspace import BoundedWorkspace
from clrelight.device import Device
from clrelight.jobs.farm import read_arrays, write_arrays
from clrelight.jobs.fitted_source import FittedSource, fitted_source
from clrelight.jobs.held import Held, look_of
from clrelight.jobs.inputs import lend_encoded, lend_stack, opened_on
from clrelight.jobs.measure_parts import measure_windows
from clrelight.jobs.report import Report, report_for
from clrelight.jobs.shared_fits import shared_fit

_MOST_PIECES = 64
_held = Held()
Kept = TypeVar("Kept")


def code_tile(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    plan: str,
    axes: str,
    transfer: str,
    sides: Sequence[int],
    step: float,
    multiplier: float,
    memory: int,
    last: bool = False,
    chosen: Sequence[int] = (),
    again: float | None = None,
    device: Device | str | None = None,
    report: Report | None = None,
) -> Report:
    """Code a tile of a view whose fit is prepared.

    Parameters
    ----------
    source : path
        The stack.
    out : path
        Gets ``sizes`` of the streams, and them one after another as ``streams``.
    plan, axes : path
        Of `clrelight.jobs.packing_farm.PackingFarm`: the fit, and what makes planes.
    transfer : str
        The curve behind which coefficients are coded.
    sides : top, left, bottom, right
        Of the tile; multiples of a precinct.
    step, multiplier : float
        Of the quantiser, and what a bit must save.
    memory : int
        Bytes for parts.
    last : bool
        Whether some of its streams may be asked for again: what they are made of is held.
    chosen, again : sequence of int, float, optional
        Which ones are, by their numbers, and at which multiplier; all others have been coded at the first.
    device, report
        As of `clrelight.jobs.fit.fit`.

    Raises
    ------
    InputError
        If a file is not what it should be, or a sample cannot be fitted.
    """
    kept = report_for(report)
    with opened_on(device, kept) as opened:
        view = _view_of(source, plan, memory, opened, kept)
        encoder, planes = view.encoder(transfer), view.planes(axes)
        tile = tile_of(*view.source.shape[1:3], Window(*sides).sides)
        if last:
            coded = view.last(encoder, tile, planes, (axes, transfer, step, multiplier), memory)
            streams = coded.streams if again is None else coded.again(list(chosen), again)
        else:
            streams = encoder.encode_here(tile, planes, step, multiplier).streams
    content = np.frombuffer(b"".join(streams), np.uint8)
    write_arrays(out, {"sizes": np.array([len(each) for each in streams], np.int64), "streams": content})
    return kept


def try_pieces(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    plan: str,
    axes: str,
    transfer: str,
    windows: Sequence[Sequence[int]],
    step: float,
    count: int,
    memory: int,
    device: Device | str | None = None,
    report: Report | None = None,
) -> Report:
    """Find out what the first planes of pieces of a view take at a step; else as `code_tile`.

    Parameters
    ----------
    windows : sequence of (top, left, bottom, right)
    count : int
        Of planes.
    """
    kept = report_for(report)
    with opened_on(device, kept) as opened:
        view = _view_of(source, plan, memory, opened, kept)
        encoder = view.encoder(transfer)
        pieces = [view.piece(encoder, axes, transfer, Window(*window)) for window in windows]
        tried = [each for piece in pieces for each in encoder.try_pieces(piece, step, count)]
    write_arrays(
        out,
        {
            "size_n": np.array([each.size for each in tried], np.int64),
            "bits_nj": np.array([each.bits_j for each in tried]),
            "error_nj": np.array([each.error_j for each in tried]),
            "energy_nj": np.array([each.energy_j for each in tried]),
        },
    )
    return kept


def measure_coded(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    coded: str,
    windows: Sequence[Sequence[int]],
    device: Device | str | None = None,
    report: Report | None = None,
) -> Report:
    """Measure windows of what was coded beside the photographs.

    Parameters
    ----------
    source : path
        The stack.
    out : path
        Gets ``sums_wi`` and ``counts_w`` of `clrelight.jobs.measure_parts.measure_windows`.
    coded : path
        The encoded file.
    windows : sequence of (top, left, bottom, right)
    device, report
        As of `clrelight.jobs.fit.fit`.

    Raises
    ------
    InputError
        If a file is not what it should be.
    """
    kept = report_for(report)
    with (
        opened_on(device, kept) as opened,
        lend_stack(source, kept) as stack,
        lend_encoded(coded, kept, parts=True) as packed,
    ):
        regions = packed.regions_of(coded)
        places = [Region(*window) for window in windows]
        sums_wi, counts_w = measure_windows(regions, packed.record, stack, places, opened)
    write_arrays(out, {"sums_wi": sums_wi, "counts_w": counts_w})
    return kept


@dataclass
class _View:
    """A stack that is open, the source of its coefficients, and what chores of it have made."""

    source: FittedSource
    encoders: dict[str, TileEncoder] = field(default_factory=dict)
    axes: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = field(default_factory=dict)
    pieces: dict[tuple[Any, ...], Pieces] = field(default_factory=dict)
    lasts: dict[tuple[Any, ...], CodedPart] = field(default_factory=dict)

    def encoder(self, transfer: str) -> TileEncoder:
        return _remember(self.encoders, transfer, lambda: TileEncoder(Pixels(self.source, transfer)), 2)

    def planes(self, path: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        def read() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            found = read_arrays(path)
            return found["operator_jq"], found["offset_j"]

        return _remember(self.axes, path, read, 4)

    def last(
        self,
        encoder: TileEncoder,
        tile: Tile,
        planes: Planes,
        how: tuple[str, str, float, float],
        memory: int,
    ) -> CodedPart:
        """Return a part of the last tile, coded, of which as many are held as memory is for."""
        key = (*how, tile.window)
        if key not in self.lasts:
            self.pieces.clear()  # their memory is for these now
            for old in [old for old in self.lasts if old[:4] != how]:
                del self.lasts[old]
            made = CodedPart.of(encoder, tile, planes, *how[2:])
            while self.lasts and made.n_bytes + sum(each.n_bytes for each in self.lasts.values()) > memory:
                del self.lasts[next(iter(self.lasts))]
            self.lasts[key] = made
        return self.lasts[key]

    def piece(self, encoder: TileEncoder, axes: str, transfer: str, window: Window) -> Pieces:
        """Return a piece's wavelet coefficients, which one step after another is tried on."""
        if self.pieces and next(iter(self.pieces))[:2] != (axes, transfer):
            self.pieces.clear()  # their planes are others now
        key = (axes, transfer, window)
        return _remember(self.pieces, key, lambda: encoder.take_pieces([window], self.planes(axes)), _MOST_PIECES)


def _remember(held: dict[Any, Kept], key: Any, make: Callable[[], Kept], most: int) -> Kept:
    """Return what is held under a key, made where it is not; the oldest goes where there are too many."""
    if key not in held:
        while len(held) >= most:
            del held[next(iter(held))]
        held[key] = make()
    return held[key]


def _view_of(source: str | os.PathLike[str], plan: str, memory: int, device: Device, report: Report) -> _View:
    """Return a view, ready for chores: the last one's where it is the same."""
    path = os.path.abspath(os.fsdecode(source))

    def make(opened: ExitStack) -> _View:
        prepared = shared_fit(opened.enter_context(lend_stack(path, report)), plan, device)
        return _View(opened.enter_context(fitted_source(prepared, BoundedWorkspace(memory))))

    found: _View = _held.get((look_of(path, plan), memory, id(device)), make)
    return found
