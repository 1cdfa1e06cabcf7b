"""A fit that is prepared: run to a file, by this process or by others, or to a map in memory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.fit import FittedTile, PreparedFit
from clrelight.fit.run import collect_tiles
from clrelight.harmonics.index import coefficient_count
from clrelight.holdout import describe_duplicates, note_distance
from clrelight.jobs.farm import Chore, Farm
from clrelight.jobs.half_tiles import WRITTEN, tiles_of
from clrelight.jobs.measure import measure_split
from clrelight.jobs.report import Progress, Report, stage
from clrelight.jobs.shared_fits import share_fit
from clrelight.jobs.split_quality import Split, summarize_split
from clrelight.metrics import count_values, rows_from_files
from clrelight.store import FitSink, create_fit
from clrelight.streaming import writing_behind
from clrelight.tiles import row_tiles

FIT_PART = "fit-part"
_PART_BYTES = 24 << 20
"""Of a part that another process fits: a second or so of work, and held in memory some times over."""


@dataclass(frozen=True)
class Fitting:
    """A fit of some lights of a stack, and how it shall run."""

    stack: LightStack
    split: Split
    prepared: PreparedFit
    dtype: np.dtype
    memory: int
    report: Report
    progress: Progress | None
    farm: Farm | None = None
    """What fits parts in other processes, of the stack's file."""
    source: str = ""

    def tell_facts(self) -> None:
        """Report what is known before the work."""
        prepared, facts = self.prepared, self.report.facts
        facts |= {
            "method": prepared.method.id,
            "degree": prepared.degree,
            "n_coeff": coefficient_count(prepared.degree),
            "n_light": len(self.split[0]),
            "n_holdout": len(self.split[1]),
            "config": dict(prepared.config),
            "dtype": self.dtype.name,
            "condition": prepared.report.condition,
        }
        if prepared.choice is not None:
            facts["choice"] = prepared.choice.to_config()
        self.report.seconds = prepared.report.seconds
        self.report.note(*prepared.report.notes)
        if (duplicates := describe_duplicates(self.stack)) is not None:
            facts["duplicates"] = duplicates[0]
            self.report.note(duplicates[1])
        if (near := note_distance(self.stack.directions_i3, *self.split)) is not None:
            self.report.note(near)

    def to_file(self, out: str | os.PathLike[str], measured: bool) -> None:
        """Write the fit tile by tile."""
        prepared = self.prepared
        has_lambda, has_rank = prepared.method.has_lambda, prepared.method.has_rank
        creating = create_fit(
            out, prepared.record, self.stack.image_shape, has_lambda=has_lambda, has_rank=has_rank, dtype=self.dtype
        )
        with creating as sink:
            # Measured before the file stands: where that fails, or is interrupted, an old file stays.
            if self.farm is not None:
                self._gather(sink, self.farm, measured)
            else:
                self._fill(sink)
                if measured:
                    self._measure(prepared.record.to_map(sink.coeffs_khwc))
            since = time.perf_counter()
        self.report.add("write", since)
        self.report.facts = {"file": os.fsdecode(out), **self.report.facts, "bytes_on_disk": os.stat(out).st_size}

    def to_map(self, measured: bool) -> CoefficientMap:
        """Return the fit."""
        with stage(self.progress, self._title) as tell, closing(self._tiles()) as tiles:
            fitted = collect_tiles(self.prepared, tiles, dtype=self.dtype, progress=tell)
        if measured:
            self._measure(fitted)
        return fitted

    def _measure(self, fitted: CoefficientMap) -> None:
        since = time.perf_counter()
        device = self.prepared.device
        self.report.psnr = measure_split(fitted, self.stack, device, self.split, progress=self.progress)
        self.report.add("measure", since)

    @property
    def _title(self) -> str:
        return f"fitting {self.prepared.method.title}"

    def _tiles(self, held: int = 1, row_step: int = 1) -> Generator[FittedTile, None, None]:
        return tiles_of(self.prepared, self.dtype, self.memory, held, row_step)

    def _fill(self, sink: FitSink) -> None:
        tiles = self._tiles(held=WRITTEN, row_step=sink.coeffs_khwc.chunks[1])
        with stage(self.progress, self._title) as tell, closing(tiles):
            with writing_behind(_writer(sink)) as put:
                for tile in tiles:
                    since = time.perf_counter()
                    put(tile)
                    since = self.report.add("write", since)
                    tell(tile.end, self.stack.image_shape[0])
            self.report.add("write", since)

    def _gather(self, sink: FitSink, farm: Farm, measured: bool) -> None:
        """Have parts fitted elsewhere, and write them; each is measured where it is made."""
        since, write = time.perf_counter(), _writer(sink)
        height, width, channel = self.stack.image_shape
        n_coeff, plan = coefficient_count(self.prepared.degree), share_fit(farm, self.prepared, self.split[0])
        # Of whole tiles as one process measures them: then sums are those of one process, bit for bit.
        together = rows_from_files(self.stack, n_coeff, self.dtype)
        most = _PART_BYTES // (n_coeff * width * channel * self.dtype.itemsize)
        parts = row_tiles((0, height), max(most // together, 1) * together)
        given = {"plan": plan, "memory": self.memory, "dtype": self.dtype.name, "measured": measured}
        chores = [Chore(FIT_PART, self.source, {**given, "rows": list(part)}, (plan,)) for part in parts]
        total_i = np.zeros(self.stack.n_light)
        for (first, end), made in zip(parts, farm.do(chores, self._title), strict=True):
            since = self.report.add("fit", since)
            write(FittedTile(first, end, made["coeffs_khwc"], made.get("lambda_hwc"), made.get("rank_hwc")))
            for sum_i in made["sums_ti"]:
                total_i += sum_i
            since = self.report.add("write", since)
        if measured:
            mse_i: NDArray[np.float64] = total_i / count_values(self.stack)
            self.report.psnr = summarize_split(mse_i, self.prepared.record.directions_i3, self.stack, self.split)


def _writer(sink: FitSink) -> Callable[[FittedTile], None]:
    def write(tile: FittedTile) -> None:
        sink.write_rows(tile.first, tile.coeffs_khwc, tile.lambda_hwc, tile.rank_hwc)

    return write
