"""The driver: gives tasks to an engine, keeps what became of them, and tries again what deserves it."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from clrelight.batch.engine import Ended, Engine, Work
from clrelight.batch.fingerprint import code_digest, is_unchanged, task_key
from clrelight.batch.journal import Journal
from clrelight.batch.leftovers import sweep
from clrelight.batch.perform import outputs_of
from clrelight.batch.summary import write_summary
from clrelight.batch.task import FAILED, Outcome, Task
from clrelight.durable import claiming, naming, no_locks
from clrelight.errors import InputError
from clrelight.jobs.report import Progress, Report, report_for

JOURNAL = "journal.jsonl"
_LOOK_SECONDS = 0.5
_LOOK_EVERY = 100
"""Tasks of which an earlier run's result is looked at before that is told."""


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
    told, folder = report_for(report), Path(os.path.abspath(os.fsdecode(out)))
    if retries < 0:
        raise InputError(f"retries must be at least 0, got {retries}")
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with claiming(folder) as is_claimed:
        if not is_claimed:
            told.note(no_locks(folder))
        journal = Journal(folder / JOURNAL, anew=anew)
        try:
            if journal.damaged:
                told.note(f"{journal.path}: {journal.damaged} lines are damaged or torn; their stacks are done again")
            if only_kept:
                known = _Driver(tasks, folder, journal, device, keep_going, retries, verify, progress, told)
                return Batch((), known.find_kept())
            driver = _Driver(tasks, folder, journal, device, keep_going, retries, verify, progress, told)
            return driver.run(lambda: _open(engine, workers, timeout, memory_limit, journal.descriptor))
        finally:
            journal.close()


def _open(
    engine: str | Callable[[int], Engine],
    workers: int | None,
    timeout: float | None,
    memory_limit: str,
    lock: int,
) -> Engine:
    if callable(engine):
        return engine(lock)
    if engine == "local":
        from clrelight.batch.local import LocalEngine

        return LocalEngine(workers or 1, timeout=timeout, lock=lock)
    from clrelight.batch.cluster import DaskEngine, is_address

    if engine != "dask" and not is_address(engine):
        raise InputError(f"there is no engine {engine!r}; there are local, dask, and addresses such as tcp://host:8786")
    if timeout is not None:
        raise InputError("a time limit is for the engine local; those of Dask have none")
    if is_address(engine) and workers is not None:
        raise InputError(f"{engine} has as many workers as were started there: leave the number out")
    return DaskEngine(engine if is_address(engine) else None, workers=workers, memory=memory_limit)


@dataclass
class _Driver:
    """A run of a batch: what waits, what is being done, what died once and waits for its last tries."""

    tasks: Sequence[Task]
    folder: Path
    journal: Journal
    device: str | None
    keep_going: bool
    retries: int
    verify: bool
    progress: Progress | None
    report: Report
    tries: dict[str, int] = field(default_factory=dict)
    deaths: dict[str, int] = field(default_factory=dict)
    doubted: set[str] = field(default_factory=set)
    waiting: deque[Task] = field(default_factory=deque)
    suspects: deque[Task] = field(default_factory=deque)
    keys: dict[str, str] = field(default_factory=dict)
    failures: int = 0
    total: int = 0
    done: int = 0

    def run(self, open_engine: Callable[[], Engine]) -> Batch:
        """Do what is not done; write the tables, however it ends."""
        wanted = {task.name: task for task in self.tasks}
        sweep(path for task in self.tasks for path in outputs_of(task))
        kept = self.find_kept()
        self.waiting = deque(task for name, task in wanted.items() if name not in kept)
        self.total = len(self.waiting)
        try:
            if self.waiting:
                engine = open_engine()
                try:
                    self.journal.begin_run({"job": self.waiting[0].job, "stacks": self.total, "engine": engine.label})
                    self._drive(engine, wanted)
                finally:
                    engine.close()
                    sweep(path for task in self.tasks for path in outputs_of(task))
        finally:
            outcomes = self._outcomes(wanted)
            files = write_summary(self.folder, outcomes, kept, len(self.waiting) + len(self.suspects))
        left = tuple(task.name for task in (*self.waiting, *self.suspects))
        return Batch(outcomes, kept, left, (str(self.journal.path), *files))

    def _key(self, task: Task) -> str:
        if task.name not in self.keys:
            self.keys[task.name] = task_key(task, self.folder)
        return self.keys[task.name]

    def _outcomes(self, wanted: dict[str, Task]) -> tuple[Outcome, ...]:
        """Return what became of the tasks as they are now: outcomes of others are of another batch in this folder."""
        known = (self.journal.outcomes.get(name) for name in wanted)
        return tuple(each for each in known if each is not None and each.key == self._key(wanted[each.name]))

    def find_kept(self) -> frozenset[str]:
        """Return the names of tasks that an earlier run has done, and that nothing has changed since."""
        kept = set()
        for count, task in enumerate(self.tasks):
            if self.progress is not None and count % _LOOK_EVERY == 0:
                self.progress(count, len(self.tasks), "looking at what is done")
            if self._is_kept(task):
                kept.add(task.name)
        return frozenset(kept)

    def _is_kept(self, task: Task) -> bool:
        before = self.journal.outcomes.get(task.name)
        if before is None or not before.is_done or before.key != self._key(task):
            return False
        if [*before.inputs] != [*task.inputs] or [*before.outputs] != outputs_of(task):
            return False
        every = (*before.inputs.items(), *before.outputs.items())
        return all(is_unchanged(path, known, verify=self.verify) for path, known in every)

    def _drive(self, engine: Engine, wanted: dict[str, Task]) -> None:
        flying: set[str] = set()
        while self.waiting or self.suspects or flying:
            stopping = self.failures and not self.keep_going
            while not stopping and (task := self._next(engine, len(flying))) is not None:
                self.tries[task.name] = self.tries.get(task.name, 0) + 1
                engine.submit(Work(task.name, task.to_json(), self._key(task), code_digest(), self.device))
                flying.add(task.name)
            if not flying:
                return
            self._tell(engine)
            is_alone = engine.isolates or len(flying) == 1
            for ended in engine.collect(_LOOK_SECONDS):
                flying.discard(ended.name)
                self._settle(engine, wanted[ended.name], ended, is_alone)

    def _next(self, engine: Engine, flying: int) -> Task | None:
        """Return the next task to begin; None where there is none, or all workers have enough."""
        if self.waiting:
            return self.waiting.popleft() if flying < engine.workers + engine.ahead else None
        # What died with its worker is tried last: where workers hold several tasks, one alone, so that an innocent one
        # does not die twice of its neighbour.
        most = engine.workers if engine.isolates else 1
        return self.suspects.popleft() if self.suspects and flying < most else None

    def _settle(self, engine: Engine, task: Task, ended: Ended, is_alone: bool) -> None:
        tries = self.tries[task.name]
        if ended.outcome is None:
            alone, deaths = self._count_death(task.name, is_alone)
            if ended.kind == "died" and (not alone or deaths <= self.retries):
                # What was given out first was most likely being done: so it comes last, and those who only waited
                # behind it find a worker that has not to be started anew.
                (self.suspects.append if alone else self.suspects.appendleft)(task)
                return
            times = f", {deaths} times" if deaths > 1 else ""
            outcome = Outcome(task.name, FAILED, self._key(task), f"{ended.fault}{times}", ended.kind, tries=tries)
        else:
            outcome = replace(Outcome.from_json(ended.outcome), tries=tries)
            if outcome.kind == "device" and engine.avoid(outcome.worker):
                self.report.note(f"{outcome.worker} gets no more stacks: {outcome.error}")
                self.waiting.appendleft(task)
                return
        self.journal.add(outcome)
        self.done += 1
        if not outcome.is_done:
            self.failures += 1
            self.report.note(f"{task.name}: {outcome.error}")

    def _count_death(self, name: str, is_alone: bool) -> tuple[int, int]:
        """Return how often a task ended a worker that it had for itself, and how often in all.

        A worker that had several tasks ended for one of them. So that death fails nobody; but who then does it alone
        has done it before, and all of them together count once, however many neighbours died.
        """
        self.deaths[name] = self.deaths.get(name, 0) + is_alone
        if not is_alone:
            self.doubted.add(name)
        return self.deaths[name], self.deaths[name] + (name in self.doubted)

    def _tell(self, engine: Engine) -> None:
        if self.progress is not None:
            failed = f", {self.failures} failed" if self.failures else ""
            self.progress(self.done, self.total, f"{engine.doing()}{failed}")
