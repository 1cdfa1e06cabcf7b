"""Batches: one job on many stacks, in a folder of results with a journal and tables."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from clrelight.batch.driver import Driver
from clrelight.batch.engine import Engine
from clrelight.batch.journal import Journal
from clrelight.batch.leftovers import sweep
from clrelight.batch.perform import outputs_of
from clrelight.batch.summary import write_summary
from clrelight.batch.task import Outcome, Task
from clrelight.durable import claiming, naming, no_locks
from clrelight.errors import InputError
from clrelight.jobs.report import Progress, Report, report_for

JOURNAL = "journal.jsonl"


@dataclass(frozen=True)
class Batch:
    """What a batch came to.

    Attributes
    ----------
    outcomes : tuple of Outcome
        Of every stack that was reached, in the order of the tasks.
    kept : frozenset of str
        Names of those that an earlier run had done.
    left : tuple of str
        Names of those that were not begun, as one before them had failed.
    files : tuple of str
        The journal and the tables.
    """

    outcomes: tuple[Outcome, ...]
    kept: frozenset[str] = frozenset()
    left: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    @property
    def failed(self) -> tuple[Outcome, ...]:
        """Those that failed."""
        return tuple(each for each in self.outcomes if not each.is_done)


def run_batch(
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
    only_kept: bool = False,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Batch:
    """Do a job to many stacks; what an earlier run has done, and nothing has changed since, is kept.

    Parameters
    ----------
    tasks : sequence of Task
        Of `plan.make_tasks`.
    out : path
        Folder of the results, which is made; the journal and the tables lie in it too.
    engine : str or callable
        ``"local"``, ``"dask"``, or the address of a scheduler, such as ``"tcp://host:8786"``; or what makes one, given
        a descriptor that holds the journal's lock.
    workers : int, optional
        How many stacks are worked on at a time; by default one with all processors, of Dask's one to each two.
    device : str, optional
        As ``--device`` names it.
    keep_going : bool
        Go on after a failure; without, what is begun is finished, and no more is begun.
    retries : int
        How often a stack is begun again whose worker has died.
    timeout : float, optional
        Seconds after which a stack is given up (local).
    memory_limit : str
        Of a worker (dask), as Dask takes it.
    verify : bool
        Read the contents of what is there, instead of trusting names, sizes and times.
    anew : bool
        Do everything again.
    only_kept : bool
        Only say what is kept; do nothing.
    progress : callable, optional
        Told (done, total, what) of the stacks that are to be done.
    report : Report, optional
        Gets notes; without one they become warnings.

    Raises
    ------
    InputError
        If `out` cannot be written, another batch writes it, or the engine cannot be had.
    """
    if retries < 0:
        raise InputError(f"retries must be at least 0, got {retries}")
    if isinstance(engine, str):
        check_engine(engine, workers)  # before there is a folder
    with opened_folder(out, anew, report_for(report)) as (folder, journal, told):
        driver = Driver(tasks, folder, journal, device, keep_going, retries, verify, progress, told)
        if only_kept:
            return Batch((), driver.find_kept())
        return _run(driver, lambda: open_engine(engine, workers, timeout, memory_limit, journal.descriptor))


@contextmanager
def opened_folder(out: str | os.PathLike[str], anew: bool, report: Report) -> Iterator[tuple[Path, Journal, Report]]:
    """Lend a folder of results, which is made, and its journal, both for one driver; errors as of `run_batch`."""
    folder = Path(os.path.abspath(os.fsdecode(out)))
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with claiming(folder) as is_claimed:
        if not is_claimed:
            report.note(no_locks(folder))
        journal = Journal(folder / JOURNAL, anew=anew)
        try:
            if journal.damaged:
                report.note(f"{journal.path}: {journal.damaged} lines are damaged or torn; their stacks are done again")
            yield folder, journal, report
        finally:
            journal.close()


def open_engine(
    engine: str | Callable[[int], Engine],
    workers: int | None,
    timeout: float | None,
    memory_limit: str,
    lock: int,
) -> Engine:
    """Return the engine of a name, or what `engine` makes; InputError where it cannot be had."""
    if callable(engine):
        return engine(lock)
    if engine == "local":
        from clrelight.batch.local import LocalEngine

        return LocalEngine(workers or 1, timeout=timeout, lock=lock)
    from clrelight.batch.cluster import DaskEngine, is_address

    check_engine(engine, workers)
    if timeout is not None:
        raise InputError("a time limit is for the engine local; those of Dask have none")
    return DaskEngine(engine if is_address(engine) else None, workers=workers, memory=memory_limit)


def check_engine(engine: str, workers: int | None) -> None:
    """Raise InputError where there is no engine of a name, or it takes no number of workers."""
    from clrelight.batch.cluster import is_address

    if engine not in ("local", "dask") and not is_address(engine):
        raise InputError(f"there is no engine {engine!r}; there are local, dask, and addresses such as tcp://host:8786")
    if is_address(engine) and workers is not None:
        raise InputError(f"{engine} has as many workers as were started there: leave the number out")


def _run(driver: Driver, open_it: Callable[[], Engine]) -> Batch:
    """Do what is not done; write the tables, however it ends."""
    tasks, journal = driver.tasks, driver.journal
    wanted = {task.name: task for task in tasks}
    sweep(path for task in tasks for path in outputs_of(task))
    kept = driver.find_kept()
    waiting = deque(task for name, task in wanted.items() if name not in kept)
    try:
        if waiting:
            engine = open_it()
            try:
                journal.begin_run({"job": waiting[0].job, "stacks": len(waiting), "engine": engine.label})
                driver.drive(engine, waiting)
            finally:
                engine.close()
                sweep(path for task in tasks for path in outputs_of(task))
    finally:
        outcomes = driver.outcomes()
        files = write_summary(driver.folder, outcomes, kept, len(waiting) + len(driver.suspects))
    left = tuple(task.name for task in (*waiting, *driver.suspects))
    return Batch(outcomes, kept, left, (str(journal.path), *files))
