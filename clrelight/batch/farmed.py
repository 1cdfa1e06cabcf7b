"""Jobs that go their own way and have parts done by workers: one stack after the other, all workers for each."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace

from clrelight.batch.cluster import is_address
from clrelight.batch.driver import Driver
from clrelight.batch.engine import Engine
from clrelight.batch.farm import TaskFarm, Workers
from clrelight.batch.fingerprint import code_digest, take_seal
from clrelight.batch.leftovers import sweep
from clrelight.batch.perform import outputs_of, perform
from clrelight.batch.run import Batch, open_engine, opened_folder
from clrelight.batch.summary import write_summary
from clrelight.batch.task import Outcome, Task
from clrelight.jobs.report import Progress, Report, report_for

FOLDER = ".shards"
"""Behind the name of a stack: where shards of its parts lie, until all is done."""


def run_farmed(
    tasks: Sequence[Task],
    out: str | os.PathLike[str],
    *,
    engine: str | Callable[[int], Engine] = "local",
    workers: int | None = None,
    device: str | None = None,
    keep_going: bool = False,
    retries: int = 1,
    timeout: float | None = None,
    memory_limit: str = "auto",
    verify: bool = False,
    anew: bool = False,
    progress: Progress | None = None,
    report: Report | None = None,
    reports: dict[str, Report] | None = None,
    shards: Callable[[Task], str] | None = None,
    redo: bool = False,
) -> Batch:
    """Do jobs whose parts are tasks: this process decides and writes, the workers do what takes long.

    The result of each is the file that the job alone would write, byte for byte, and what a batch without tiles has
    done is kept.

    Parameters
    ----------
    tasks : sequence of Task
        Of jobs that take a farm.
    out, engine, workers, device, keep_going, retries, timeout, memory_limit, verify, anew, progress, report
        As of `run.run_batch`.
    reports : dict, optional
        Has, or gets, the report of each task that was done, by its name.
    shards : callable, optional
        Returns the folder of a task's shards; default: ``NAME.shards`` beside its result.
    redo : bool
        Do the jobs themselves again also where an earlier run has done them, but not their parts.

    Raises
    ------
    InputError
        As of `run.run_batch`.
    """
    with opened_folder(out, anew, report_for(report)) as (folder, journal, told):
        hands = Workers(
            lambda: open_engine(engine, workers, timeout, memory_limit, journal.descriptor),
            *(journal, folder, device, keep_going, retries),
        )
        try:
            if isinstance(engine, str) and is_address(engine):
                hands.opened()  # one that does not answer is told of before the work
            return _run(
                tasks, hands, verify, progress, told, {} if reports is None else reports, shards or shards_of, redo
            )
        finally:
            hands.close()


def _run(
    tasks: Sequence[Task],
    workers: Workers,
    verify: bool,
    progress: Progress | None,
    report: Report,
    reports: dict[str, Report],
    shards: Callable[[Task], str],
    redo: bool,
) -> Batch:
    journal = workers.journal
    driver = Driver(
        tasks, workers.root, journal, workers.device, workers.keep_going, workers.retries, verify, progress, report
    )
    sweep(path for task in tasks for path in outputs_of(task))
    kept: frozenset[str] = frozenset() if redo else driver.find_kept()
    left: list[str] = []
    waiting = [task for task in tasks if task.name not in kept]
    if waiting:
        journal.begin_run({"job": waiting[0].job, "stacks": len(waiting), "tiles": True})
    failures = 0
    try:
        for number, task in enumerate(waiting):
            if failures and not workers.keep_going:
                left = [each.name for each in waiting[number:]]
                break
            place = shards(task) if task.out else str(workers.root / f"{task.name}{FOLDER}")  # a job that only measures
            outcome = _do(task, driver.key_of(task), workers, progress, report, reports, place)
            journal.add(outcome)
            if not outcome.is_done:
                failures += 1
                report.note(f"{task.name}: {outcome.error}")
    finally:
        files = write_summary(workers.root, driver.outcomes(), kept, len(left))
    return Batch(driver.outcomes(), kept, tuple(left), (str(journal.path), *files))


def _do(
    task: Task,
    key: str,
    workers: Workers,
    progress: Progress | None,
    report: Report,
    reports: dict[str, Report],
    shards: str,
) -> Outcome:
    filled = reports.setdefault(task.name, Report(tell=report.note))
    farm = TaskFarm(task.name, shards, workers, progress, report)
    known = {path: take_seal(path) for path in task.inputs if os.path.isfile(path)}
    told = perform(replace(task, known=known).to_json(), key, code_digest(), workers.device, progress, farm, filled)
    outcome = Outcome.from_json(told)
    if outcome.is_done:
        shutil.rmtree(shards, ignore_errors=True)
    return outcome


def shards_of(task: Task) -> str:
    """Return the folder of a task's shards, beside its result."""
    return os.path.splitext(task.out)[0] + FOLDER
