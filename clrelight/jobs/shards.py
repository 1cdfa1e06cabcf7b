"""A large fit in tiles of rows: each a job of its own that writes a shard, and what makes one fit of them."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import Any

import numpy as np

from clrelight.dataset import FitRecord
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.fit import PreparedFit, fit_tiles, prepare_fit
from clrelight.fit.precision import MIXED
from clrelight.fit.selection import WITHIN
from clrelight.holdout import HoldoutRule
from clrelight.jobs.held import Held, look_of
from clrelight.jobs.inputs import lend_stack, opened_on, whole
from clrelight.jobs.measure import measure
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import create_fit, open_fit
from clrelight.store.shards import shard_name
from clrelight.store.tiling import write_tiles
from clrelight.tiles import row_tiles

_held = Held()


def fit_rows(
    source: str | os.PathLike[str],
    rows: Sequence[int],
    *,
    out: str | os.PathLike[str],
    method: str = "cls",
    degree: int | str = 6,
    holdout: int | None = None,
    holdout_by: str = "index",
    lights: int | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    precision: str = MIXED,
    within: float = WITHIN,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> Report:
    """Fit some rows of a stack, as `fit.fit` fits them of all, into a fit file of theirs: a shard.

    What is the same for all rows (the choice of a model, its matrices) is kept for the next rows of the same stack in
    this thread.

    Parameters
    ----------
    source : path
        A stack.
    rows : (first, end)
    out : path
        The shard to write; build it in memory by making it smaller than `store.writing.IN_MEMORY_BYTES`.
    method, degree, holdout, holdout_by, lights, weights, sampling, precision, within, memory, device, progress, report
        As of `fit.fit`.

    Raises
    ------
    InputError
        As of `fit.fit`; or if there are no such rows.
    """
    kept, budget = report_for(report), count_bytes(memory)
    rule = HoldoutRule(
        None if holdout is None else whole(holdout, "holdout"),
        None if lights is None else whole(lights, "lights"),
        holdout_by,
    )
    wanted = degree if isinstance(degree, str) else whole(degree, "degree")
    asked = {"weights": weights, "sampling": sampling, "precision": precision, "within": within}
    given = {name: value for name, value in options.items() if value is not None}
    with claimed([out], [source], kept), opened_on(device, kept) as opened:
        prepared = _prepared(source, rule, opened, kept, (method, wanted, given), asked)
        first, end = _checked(rows, prepared)
        if prepared.stack.surface is not None:
            raise InputError("a fit of a surface is not made in tiles: its pixels are vertices")
        kept.facts |= {"method": prepared.method.id, "degree": prepared.degree, "config": dict(prepared.config)}
        shape = (end - first, *prepared.stack.image_shape[1:])
        has_lambda, has_rank = prepared.method.has_lambda, prepared.method.has_rank
        since = time.perf_counter()
        with create_fit(out, prepared.record, shape, has_lambda=has_lambda, has_rank=has_rank) as sink:
            step = sink.coeffs_khwc.chunks[1]
            tiles = fit_tiles(prepared, memory_bytes=budget, row_step=step, rows=(first, end))
            with stage(progress, f"fitting {prepared.method.title}") as tell, closing(tiles):
                for tile in tiles:
                    sink.write_rows(tile.first - first, tile.coeffs_khwc, tile.lambda_hwc, tile.rank_hwc)
                    tell(tile.end - first, end - first)
        kept.add("fit", since)
    return kept


def _checked(rows: Sequence[int], prepared: PreparedFit) -> tuple[int, int]:
    first, end = (whole(each, "rows") for each in rows)
    if not 0 <= first < end <= prepared.stack.image_shape[0]:
        raise InputError(f"there are no rows {first} to {end} of {prepared.stack.image_shape[0]}")
    return first, end


def _prepared(
    source: str | os.PathLike[str],
    rule: HoldoutRule,
    device: Device,
    report: Report,
    model: tuple[str, int | str, dict[str, Any]],
    asked: dict[str, Any],
) -> PreparedFit:
    """Return the fit of a stack, ready to run: the last one's where it is the same."""
    path = os.path.abspath(os.fsdecode(source))

    def make(opened: ExitStack) -> PreparedFit:
        stack = opened.enter_context(lend_stack(path, report))
        fitted, unseen = rule.split(stack.directions_i3)
        prepared = prepare_fit(
            stack if len(fitted) == stack.n_light else stack.select(fitted),
            *model[:2],
            options=model[2],
            device=device,
            unseen_t3=stack.directions_i3[unseen] if len(unseen) else None,
            **asked,
        )
        return replace(prepared, config={**prepared.config, **rule.to_config()})

    found: PreparedFit = _held.get(repr((look_of(path), rule, model, asked, id(device))), make)
    report.note(*found.report.notes)
    return found


def join_rows(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    shards: str | os.PathLike[str],
    ends: Sequence[int],
    virtual: bool = False,
    measured: bool = True,
    fit: Mapping[str, Any] | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Make one fit of the shards of its rows.

    Parameters
    ----------
    source : path
        The stack, which the fit is measured against.
    out : path
    shards : path
        The folder of the shards; where `virtual`, beside `out`.
    ends : sequence of int
        Behind the last row of each shard, from top to bottom.
    virtual : bool
        Write a file that points to the shards (``tiles/1``), instead of one that holds their rows: the file that
        `fit.fit` writes.
    measured : bool
        Whether to measure PSNR at all lights.
    fit : mapping, optional
        What was asked of the fit: by which a batch knows whether it would do the same.
    memory, device, progress, report
        As of `fit.fit`.

    Raises
    ------
    InputError
        If a shard is missing, not sound, or of another fit; or `out` cannot be written.
    """
    kept, budget = report_for(report), count_bytes(memory)
    paths = [os.path.join(os.fsdecode(shards), shard_name(*rows)) for rows in zip([0, *ends], ends, strict=False)]
    with claimed([out], [source, *paths], kept):
        since = time.perf_counter()
        with open_fit(paths[0]) as top:
            record, shape = FitRecord.of(top), (ends[-1], *top.image_shape[1:])
            has_lambda, has_rank, dtype = top.lambda_hwc is not None, top.rank_hwc is not None, top.coeffs_khwc.dtype
        if virtual:
            write_tiles(out, record, shards, ends)
        else:
            with (
                create_fit(out, record, shape, has_lambda=has_lambda, has_rank=has_rank, dtype=dtype) as sink,
                stage(progress, "joining") as tell,
            ):
                for path, first, end in zip(paths, [0, *ends], ends, strict=False):
                    with open_fit(path) as part:
                        if not _is_same(FitRecord.of(part), record):
                            raise InputError(f"{path} is of another fit than {paths[0]}")
                        _copy(part, sink, first, budget)
                    tell(end, ends[-1])
        kept.add("join", since)
    if measured:
        since = time.perf_counter()
        kept.psnr = measure(out, source, device=device, progress=progress)
        kept.add("measure", since)
    kept.facts = {"file": os.fsdecode(out), **kept.facts, "bytes_on_disk": os.stat(out).st_size}
    return kept


def _is_same(one: Any, other: Any) -> bool:
    same = ("degree", "method", "peak", "transfer", "name", "config")
    return all(getattr(one, name) == getattr(other, name) for name in same) and np.array_equal(
        one.directions_i3, other.directions_i3
    )


def _copy(part: Any, sink: Any, first: int, budget: int) -> None:
    n_coeff, (height, width, channel) = part.n_coeff, part.image_shape
    step = max(1, min(height, budget // (8 * n_coeff * width * channel)))
    for row, end in row_tiles((0, height), step):
        rows = slice(row, end)
        coeffs_khwc = part.read_rows(row, end, np.empty((n_coeff, end - row, width, channel), np.float32))
        maps = [None if each is None else each[rows] for each in (part.lambda_hwc, part.rank_hwc)]
        sink.write_rows(first + row, coeffs_khwc, *maps)
