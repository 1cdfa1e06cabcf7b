"""Large stacks in tiles: of rows, each a task that writes a shard, and one that joins them; or as a job goes."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from clrelight.batch.farmed import run_farmed, shards_of
from clrelight.batch.run import JOURNAL, Batch, run_batch
from clrelight.batch.summary import write_summary
from clrelight.batch.task import Outcome, Task
from clrelight.batch.verbs import VERBS
from clrelight.codec.entropy.units import PRECINCT
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.report import Report, report_for
from clrelight.store import open_fitted, open_stack
from clrelight.store.schemas import ENCODED
from clrelight.store.shards import MOST_SHARDS, shard_name
from clrelight.store.writing import IN_MEMORY_BYTES

FARMED = ("pack", "fit", "unpack", "relight", "psnr", "transfer", "bench")
"""Jobs that go their own way, and have parts done."""
_ROWS_OF = {"fit-join": "fit-rows", "decode-join": "decode-rows"}
_NOT_OF_ROWS = ("store", "confidence", "basis", "measure")
_AUTO_DEGREE = 9
"""Degree that shards are sized for where a fit chooses its own."""


def run_tiles(
    tasks: Sequence[Task],
    out: str | os.PathLike[str],
    *,
    rows: int | None = None,
    virtual: bool = False,
    shards: Callable[[Task], str] = shards_of,
    report: Report | None = None,
    **given: Any,
) -> Batch:
    """Do a job in tiles, so that several workers share one stack; else as `run.run_batch`.

    A stack's shards lie in ``NAME.shards`` beside its result, which is the file that a fit of the whole stack writes.
    They are removed when it stands, unless it is `virtual`: then it only points to them (``tiles/1``). Jobs of `FARMED`
    are done one stack after the other, as `farmed.run_farmed` says.

    Parameters
    ----------
    tasks : sequence of Task
        Of the job ``fit`` or ``decode``, or one of `FARMED`.
    out : path
    rows : int, optional
        Of a tile; default: as many as a shard that is built in memory holds.
    virtual : bool
    shards : callable
        Returns the folder of a task's shards.
    report : Report, optional
    **given
        As of `run.run_batch`.

    Raises
    ------
    InputError
        As of `run.run_batch`; or if the job is another one, or an option is not for tiles.
    """
    told = report_for(report)
    if tasks and tasks[0].job in FARMED and not (tasks[0].job in _JOINS and (rows or virtual)):
        if rows or virtual:
            raise InputError(
                f"rows of tiles, and leaving them, are for the jobs fit and decode, not for {tasks[0].job}"
            )
        return run_farmed(tasks, out, report=told, shards=shards, **given)
    joins, unreadable = [], []
    for task in tasks:
        if task.job not in _JOINS:
            shared = [name for name in dict.fromkeys((*_JOINS, *FARMED)) if name in VERBS]
            raise InputError(f"tiles are for the jobs {', '.join(shared)}, not for {task.job}")
        refused = _NOT_OF_ROWS[:3] if task.job == "fit" else ("region", "level", "salvage")
        if other := [name for name in refused if name in task.options]:
            raise InputError(f"{other[0]} is not for a {task.job} that several workers share: let one process do it")
        try:
            joins.append(_JOINS[task.job](task, rows, virtual, shards(task)))
        except InputError:
            unreadable.append(task)  # fails as it does alone, with its line
    kept = run_batch(joins, out, report=told, only_kept=True, **given) if joins else Batch(())
    given = {**given, "anew": False}  # what was to be forgotten is
    pending = [join for join in joins if join.name not in kept.kept]
    tiles = {join.name: _tiles_of(join) for join in pending}
    every = [*(tile for each in tiles.values() for tile in each), *unreadable]
    fitted = run_batch(every, out, report=told, **given) if every else Batch(())
    whole = {each.name for each in fitted.outcomes if each.is_done}
    _tell(told, fitted.outcomes)
    ready = [join for join in pending if all(tile.name in whole for tile in tiles[join.name])]
    last = [join for join in joins if join in ready or join.name in kept.kept]
    done = run_batch(last, out, report=told, **given) if last else Batch(())
    for join in last:
        if not virtual and any(each.name == join.name and each.is_done for each in done.outcomes):
            shutil.rmtree(join.options["shards"], ignore_errors=True)
    _tell(told, done.outcomes)
    outcomes = (*fitted.failed, *done.outcomes)
    left = (*(join.name for join in pending if join not in ready), *done.left)
    files = write_summary(Path(os.path.abspath(out)), outcomes, done.kept, len(left))
    return Batch(outcomes, kept.kept & done.kept, left, (str(Path(os.path.abspath(out), JOURNAL)), *files))


def _tell(report: Report, outcomes: Sequence[Outcome]) -> None:
    """Add the seconds that tasks took together, and a device that did some."""
    for each in outcomes:
        report.device = report.device or each.device or None
        for name, seconds in each.stages.items():
            report.seconds[name] = report.seconds.get(name, 0.0) + seconds


def _join_of_fit(task: Task, rows: int | None, virtual: bool, shards: str) -> Task:
    with open_stack(task.source) as stack:
        height, width, channels = stack.image_shape
    degree = task.options.get("degree", 6)
    row_bytes = 4 * (coefficient_count(degree if isinstance(degree, int) else _AUTO_DEGREE) + 1) * width * channels
    step = rows or max(1, IN_MEMORY_BYTES * 3 // 4 // row_bytes, -(-height // MOST_SHARDS))
    ends = [*range(step, height, step), height]
    fit = {name: value for name, value in task.options.items() if name not in _NOT_OF_ROWS}
    measured = task.options.get("measure", True) is not False
    options = {"shards": shards, "ends": ends, "virtual": virtual, "measured": measured, "fit": fit}
    return replace(task, job="fit-join", options=options)


def _join_of_decode(task: Task, rows: int | None, virtual: bool, shards: str) -> Task:
    with open_fitted(task.source, ENCODED.kind) as opened:
        height = opened.parts()[0].shape[1]
    # Whole precincts: of one that two tiles share, both decode all.
    least = max(rows or PRECINCT, -(-height // MOST_SHARDS))
    step = -(-least // PRECINCT) * PRECINCT
    ends = [*range(step, height, step), height]
    options = {"shards": shards, "ends": ends, "virtual": virtual, "measured": False, "fit": task.options}
    return replace(task, job="decode-join", options=options)


_JOINS = {"fit": _join_of_fit, "decode": _join_of_decode}
"""Jobs whose tiles are known beforehand: what makes the last task, which joins them."""


def _tiles_of(join: Task) -> list[Task]:
    ends = join.options["ends"]
    return [
        Task(
            f"{join.name}@{first:06d}",
            _ROWS_OF[join.job],
            join.source,
            os.path.join(join.options["shards"], shard_name(first, end)),
            {**join.options["fit"], "rows": [first, end]},
            join.inputs,
        )
        for first, end in zip([0, *ends], ends, strict=False)
    ]
