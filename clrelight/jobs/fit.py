"""Fit coefficients to every pixel of a stack: to a file, piece by piece, or to a map in memory."""

from __future__ import annotations

import os
import time
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np

from clrelight.bases import SH
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.fit import FitMethod, FittedTile, PreparedFit, fit_tiles, prepare_fit
from clrelight.fit.precision import MIXED
from clrelight.fit.run import collect_tiles
from clrelight.fit.selection import AUTO, WITHIN
from clrelight.harmonics.index import coefficient_count
from clrelight.holdout import HoldoutRule, describe_duplicates, note_distance
from clrelight.jobs.confidence import write_confidence
from clrelight.jobs.half_tiles import WRITTEN, check_rows, float16_tiles
from clrelight.jobs.inputs import StackLike, lend_stack, opened_on, paths_among, whole
from clrelight.jobs.measure import measure_split
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.split_quality import Split
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import FitSink, create_fit
from clrelight.store.fits import coefficient_dtype
from clrelight.streaming import writing_behind


@overload
def fit(
    source: StackLike,
    method: str | FitMethod = "cls",
    degree: int | str = 6,
    *,
    out: None = None,
    holdout: int | None = None,
    holdout_by: str = "index",
    lights: int | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    basis: str = SH,
    precision: str = MIXED,
    within: float = WITHIN,
    store: str = "float32",
    measure: bool | None = None,
    confidence: str | os.PathLike[str] | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> CoefficientMap: ...


@overload
def fit(
    source: StackLike,
    method: str | FitMethod = "cls",
    degree: int | str = 6,
    *,
    out: str | os.PathLike[str],
    holdout: int | None = None,
    holdout_by: str = "index",
    lights: int | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    basis: str = SH,
    precision: str = MIXED,
    within: float = WITHIN,
    store: str = "float32",
    measure: bool | None = None,
    confidence: str | os.PathLike[str] | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> Report: ...


def fit(
    source: StackLike,
    method: str | FitMethod = "cls",
    degree: int | str = 6,
    *,
    out: str | os.PathLike[str] | None = None,
    holdout: int | None = None,
    holdout_by: str = "index",
    lights: int | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    basis: str = SH,
    precision: str = MIXED,
    within: float = WITHIN,
    store: str = "float32",
    measure: bool | None = None,
    confidence: str | os.PathLike[str] | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> CoefficientMap | Report:
    """Fit coefficients of spherical harmonics, or of another basis, to every pixel and channel of a stack.

    Parameters
    ----------
    source : path or LightStack
    method : str or FitMethod
        ``"project"``, ``"uls"``, ``"sloan"``, ``"cls"``, ``"ceb"``, ``"ceb-crossing"``, ``"spline"``,
        ``"spectrum"``, ``"constrained"``, or ``"auto"``: the best at unseen lights, as far as those to fit can tell.
    degree : int or str
        Largest degree, or ``"auto"``.
    out : path, optional
        A fit file to write, piece by piece; without it the map is returned.
    holdout : int, optional
        Keep every K-th light out of the fit, and measure there too.
    holdout_by : str
        Which ones: ``"index"``, every K-th direction in the order of the photographs, or ``"place"``, blocks as large
        as the gaps between lights (`clrelight.holdout.split_chosen`).
    lights : int, optional
        Fit so many well-spread lights only.
    weights : str
        ``"uniform"``, or ``"solid-angle"``: least squares and bound weighted by the lights' Voronoi cells.
    sampling : str
        ``"hemisphere"``, or ``"scattered"`` for samples that cover a part of it.
    basis : str
        ``"sh"``, or a hemispherical one of `clrelight.bases` (``uls`` and ``spline``): ``"hsh"``, ``"gram-schmidt"``...
    precision : str
        ``"mixed"``: float32, and float64 where lambda would be in doubt; ``"single"``; ``"double"``.
    within : float
        Decibels at unseen lights that ``"auto"`` may give for fewer coefficients.
    store : str
        ``"float32"`` or ``"float16"``: the type of the coefficients.
    measure : bool, optional
        Whether to measure PSNR; default: where `out` or `report` is given.
    confidence : path, optional
        A picture to write of the PSNR that is expected under each light direction (of ``spectrum``, also where auto
        takes it): decibels in a format of floats, 5 to a decibel in 8 bits (`clrelight.fit.confidence`).
    memory : int or str
        Bytes that tiles may take, such as ``"1GiB"``; a map that is returned comes on top.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).
    **options
        Of the method: ``energy``, ``iterations`` and ``solver`` (cls), ``energy`` (ceb), ``fill`` (project), ``lam``
        and ``per`` (spline), ``level``, ``slope``, ``edge``, ``heat``, ``noise``, ``azimuth``, ``tilt``, ``limit`` and
        ``share`` (spectrum), ``energy``, ``lower``, ``upper``, ``nonnegative`` and ``at`` (constrained). None means
        the default.

    Returns
    -------
    CoefficientMap
        Coefficients of linear radiance in units of the peak; with `out` instead the report.

    Raises
    ------
    InputError
        If the method cannot fit this degree to these lights, samples are negative or not finite, a row takes more
        than `memory`, the device cannot compute in this precision, or `out` cannot be written.
    """
    kept, budget, dtype = report_for(report), count_bytes(memory), coefficient_dtype(store)
    model = method if isinstance(method, str | FitMethod) else str(method)
    wanted = degree if isinstance(degree, str) else whole(degree, "degree")
    every, count = (None if n is None else whole(n, name) for n, name in ((holdout, "holdout"), (lights, "lights")))
    with (
        claimed([out, confidence], paths_among(source), kept),
        opened_on(device, kept) as opened,
        lend_stack(source, kept) as stack,
    ):
        rule = HoldoutRule(every, count, holdout_by)
        split = rule.split(stack.directions_i3)
        chosen = stack if len(split[0]) == stack.n_light else stack.select(split[0])
        with stage(progress, "choosing a model" if AUTO in (model, wanted) else "preparing"):
            prepared = prepare_fit(
                chosen,
                model,
                wanted,
                options={name: value for name, value in options.items() if value is not None},
                weights=weights,
                sampling=sampling,
                basis=basis,
                precision=precision,
                within=within,
                device=opened,
                unseen_t3=stack.directions_i3[split[1]] if len(split[1]) else None,
            )
        prepared = replace(prepared, config={**prepared.config, **rule.to_config()})
        job = _Fit(stack, split, prepared, dtype, budget, kept, progress)
        job.tell_facts()
        if out is not None:
            check_rows(prepared, dtype, budget)
        if confidence is not None:
            write_confidence(confidence, prepared, kept)
        if out is not None:
            job.to_file(out, True if measure is None else measure)
            return kept
        return job.to_map(report is not None if measure is None else measure)


@dataclass(frozen=True)
class _Fit:
    """A fit that is prepared, and how it shall run."""

    stack: LightStack
    split: Split
    prepared: PreparedFit
    dtype: np.dtype
    memory: int
    report: Report
    progress: Progress | None

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
            self._fill(sink)
            # Before the file stands: where measuring fails, or is interrupted, an old file stays.
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
        if self.dtype == np.float16:
            return float16_tiles(self.prepared, self.memory, row_step)
        return fit_tiles(self.prepared, memory_bytes=self.memory, held=held, row_step=row_step)

    def _fill(self, sink: FitSink) -> None:
        def write(tile: FittedTile) -> None:
            sink.write_rows(tile.first, tile.coeffs_khwc, tile.lambda_hwc, tile.rank_hwc)

        tiles = self._tiles(held=WRITTEN, row_step=sink.coeffs_khwc.chunks[1])
        with stage(self.progress, self._title) as tell, closing(tiles):
            with writing_behind(write) as put:
                for tile in tiles:
                    since = time.perf_counter()
                    put(tile)
                    since = self.report.add("write", since)
                    tell(tile.end, self.stack.image_shape[0])
            self.report.add("write", since)
