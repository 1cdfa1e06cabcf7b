"""The tile of the codec `klt` that is coded last: some of its streams are coded anew, so that a budget is filled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from clrelight.codec.entropy.unit_streams import Coded
from clrelight.codec.entropy.units import Tile
from clrelight.codec.formats.klt_tiles import TileCoder, TileEncoder, cut_tile, encode_elsewhere
from clrelight.codec.formats.klt_trials import Part
from clrelight.codec.transforms.whitening import Planes
from clrelight.opencl.arguments import DeviceArray


class Last(Protocol):
    """Codes a tile, and some of its streams once more."""

    def code(self, multiplier: float) -> Coded:
        """Return all streams."""

    def again(self, chosen: Sequence[int], multiplier: float) -> list[bytes]:
        """Return some streams, by their numbers, at another multiplier; others are as they were coded."""


@dataclass(frozen=True)
class LastHere:
    """The same by this process, of planes that it has."""

    encoder: TileEncoder
    part: Part
    step: float

    def code(self, multiplier: float) -> Coded:
        """See `Last`."""
        return self.encoder.encode_part(self.part, self.step, multiplier, keep=True)

    def again(self, chosen: Sequence[int], multiplier: float) -> list[bytes]:
        """See `Last`."""
        return self.encoder.encode_part(self.part.of_streams(chosen), self.step, multiplier, keep=True).streams


@dataclass
class LastElsewhere:
    """The same by other processes, each of which has a part."""

    coder: TileCoder
    tile: Tile
    sides: tuple[int, int]
    planes: Planes
    transfer: str
    step: float
    usual: float = 0.0

    def code(self, multiplier: float) -> Coded:
        """See `Last`."""
        self.usual = multiplier
        given = (self.planes, self.transfer, self.step, multiplier)
        return next(encode_elsewhere(self.coder, [self.tile], self.sides, *given, last=True))

    def again(self, chosen: Sequence[int], multiplier: float) -> list[bytes]:
        """See `Last`."""
        wanted = [self.tile.streams[n] for n in chosen]
        among = set(wanted)
        parts = [
            (part, numbers)
            for part in cut_tile(self.tile, *self.sides)
            if (numbers := [n for n, t in enumerate(part.streams) if t in among])
        ]
        made = self.coder.code_again(parts, self.planes, self.transfer, self.step, self.usual, multiplier)
        found: dict[int, bytes] = {}
        for (part, numbers), streams in zip(parts, made, strict=True):
            found |= zip((part.streams[n] for n in numbers), streams, strict=True)
        return [found[t] for t in wanted]


@dataclass
class CodedPart:
    """A part of the last tile in the process that has coded it: planes, indices and streams, in memory of its own.

    What lies below in the tree hangs on indices above it, so streams that were not chosen keep theirs.
    """

    encoder: TileEncoder
    part: Part
    index: DeviceArray
    step: float
    multiplier: float
    streams: list[bytes]
    chosen: list[int] | None = None

    @classmethod
    def of(cls, encoder: TileEncoder, tile: Tile, planes: Planes, step: float, multiplier: float) -> CodedPart:
        """Code a part of the last tile."""
        encoder.forget()
        part = encoder.take_part(tile.window, tile, planes)
        index = encoder.device.empty(part.values.shape, np.int32)
        streams = encoder.encode_part(part, step, multiplier, index=index).streams
        return cls(encoder, part, index, step, multiplier, streams)

    @property
    def n_bytes(self) -> int:
        """Memory that it takes."""
        return 2 * 4 * math.prod(self.index.shape)

    def again(self, chosen: list[int], multiplier: float) -> list[bytes]:
        """Return some streams, by their numbers, at another multiplier."""
        if self.chosen not in (None, chosen):  # whose indices are of another multiplier
            self.encoder.encode_part(self.part, self.step, self.multiplier, index=self.index)
        self.chosen = chosen
        return self.encoder.encode_part(self.part.of_streams(chosen), self.step, multiplier, index=self.index).streams
