"""What `pack` hands to other processes: trials, tiles and windows of a view whose fit is prepared."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import Encoded
from clrelight.codec.entropy.units import Tile, Window
from clrelight.codec.formats.klt_pieces import Tried
from clrelight.codec.formats.klt_tiles import sides_of
from clrelight.codec.transforms.whitening import Planes
from clrelight.codec.views import Region
from clrelight.fit import PreparedFit
from clrelight.jobs.farm import Chore, Farm
from clrelight.jobs.measure_parts import Sums
from clrelight.jobs.shared_fits import share_fit
from clrelight.store import write_encoded

_TRIED_TOGETHER = 6
_MEASURED_TOGETHER = 4
CODE_TILE, TRY_PIECES, MEASURE_WINDOWS = "pack-tile", "pack-try", "measure-windows"


@dataclass(frozen=True)
class PackingFarm:
    """A farm, and what its processes have to know of a fit: see `clrelight.jobs.packing_chores`.

    Attributes
    ----------
    farm : Farm
    source : str
        The stack file.
    plan : str
        The file of the fit's plan.
    memory : int
        Bytes that each process may take for parts.
    """

    farm: Farm
    source: str
    plan: str
    memory: int

    @classmethod
    def of(cls, farm: Farm, source: str, prepared: PreparedFit, lights: NDArray[np.intp], memory: int) -> PackingFarm:
        """Return what packs a stack file, of which some lights are fitted."""
        return cls(farm, source, share_fit(farm, prepared, lights), memory)

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
        """See `clrelight.codec.formats.klt_tiles.TileCoder`."""
        asked: list[dict[str, Any]] = [{"last": True} if last else {} for _ in tiles]
        return self._code(tiles, asked, planes, transfer, step, multiplier)

    def code_again(
        self,
        chosen: Sequence[tuple[Tile, list[int]]],
        planes: Planes,
        transfer: str,
        step: float,
        multiplier: float,
        again: float,
    ) -> Iterator[list[bytes]]:
        """See `clrelight.codec.formats.klt_tiles.TileCoder`."""
        asked = [{"last": True, "chosen": numbers, "again": again} for _, numbers in chosen]
        return self._code([tile for tile, _ in chosen], asked, planes, transfer, step, multiplier)

    def _code(
        self,
        tiles: Sequence[Tile],
        asked: Sequence[dict[str, Any]],
        planes: Planes,
        transfer: str,
        step: float,
        multiplier: float,
    ) -> Iterator[list[bytes]]:
        axes = self._axes(planes)
        given = {"axes": axes, "transfer": transfer, "step": step, "multiplier": multiplier}
        chores = []
        for tile, more in zip(tiles, asked, strict=True):
            sides = list(sides_of(tile))
            chore = self._chore(CODE_TILE, {**given, **more, "sides": sides}, axes)
            chores.append(replace(chore, near=str(sides) if more else ""))
        for made in self.farm.do(chores, "coding"):
            ends = np.cumsum(made["sizes"]).tolist()
            content = made["streams"].tobytes()
            yield [content[first:end] for first, end in zip([0, *ends], ends, strict=False)]

    def try_pieces(
        self, windows: Sequence[Window], planes: Planes, transfer: str, step: float, count: int
    ) -> list[Tried]:
        """See `clrelight.codec.formats.klt_tiles.TileCoder`."""
        axes = self._axes(planes)
        given = {"axes": axes, "transfer": transfer, "step": step, "count": count}
        places = [list(each.sides) for each in windows]
        chores = [
            self._chore(TRY_PIECES, {**given, "windows": group}, axes) for group in even_groups(places, _TRIED_TOGETHER)
        ]
        return [
            Tried(int(size), bits_j, error_j, energy_j)
            for made in self.farm.do(chores, "looking for the step")
            for size, bits_j, error_j, energy_j in zip(
                made["size_n"], made["bits_nj"], made["error_nj"], made["energy_nj"], strict=True
            )
        ]

    def measure(self, encoded: Encoded, windows: Sequence[Region]) -> Sums:
        """Return what `clrelight.jobs.measure_parts.measure_windows` does of an encoding."""
        path = os.path.join(self.farm.folder, "coded.h5")
        write_encoded(path, encoded)
        return measure_elsewhere(self.farm, self.source, path, windows)

    def _axes(self, planes: Planes) -> str:
        return self.farm.share("axes", {"operator_jq": planes[0], "offset_j": planes[1]})

    def _chore(self, job: str, options: dict[str, Any], *reads: str) -> Chore:
        return Chore(job, self.source, {"plan": self.plan, "memory": self.memory, **options}, (self.plan, *reads))


def measure_elsewhere(farm: Farm, stack: str, coded: str, windows: Sequence[Region]) -> Sums:
    """Return what `clrelight.jobs.measure_parts.measure_windows` does of an encoded file beside a stack file."""
    places = [list(each.sides) for each in windows]
    chores = [
        Chore(MEASURE_WINDOWS, stack, {"coded": coded, "windows": group}, (coded,))
        for group in even_groups(places, _MEASURED_TOGETHER)
    ]
    found = list(farm.do(chores, "measuring"))
    return np.concatenate([each["sums_wi"] for each in found]), np.concatenate([each["counts_w"] for each in found])


def even_groups(places: list[list[int]], most: int) -> list[list[list[int]]]:
    """Return places in groups of so many at most, of about one size and even in number: two workers end together."""
    count = -(-len(places) // most)
    count = min(count + count % 2, len(places))
    ends = [number * len(places) // count for number in range(count + 1)] if count else [0]
    return [places[first:end] for first, end in itertools.pairwise(ends)]
