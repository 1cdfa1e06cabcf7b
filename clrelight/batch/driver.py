"""The driver: gives tasks to an engine, keeps what became of them, and tries again what deserves it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from clrelight.batch.engine import Ended, Engine, Work
from clrelight.batch.fingerprint import code_digest, is_unchanged, task_key
from clrelight.batch.journal import Journal
from clrelight.batch.perform import outputs_of
from clrelight.batch.task import FAILED, Outcome, Task
from clrelight.jobs.report import Progress, Report

_LOOK_SECONDS = 0.5
_LOOK_EVERY = 100
"""Tasks of which an earlier run's result is looked at before that is told."""


@dataclass
class Driver:
    """A run of some tasks: what waits, what is being done, what died once and waits for its last tries.

    Attributes
    ----------
    tasks : sequence of Task
    folder : Path
        Of the results.
    journal : Journal
    device : str or None
        As ``--device`` names it.
    keep_going : bool
        Whether more is begun after a failure.
    retries : int
        How often a task is begun again whose worker has died.
    verify : bool
        Whether contents are read of what is there.
    progress : callable or None
        Told (done, total, what).
    report : Report
        Gets a note for each failure.
    suspects : deque of Task
        What died with its worker.
    """

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
    suspects: deque[Task] = field(default_factory=deque)
    keys: dict[str, str] = field(default_factory=dict)
    failures: int = 0
    total: int = 0
    done: int = 0

    def key_of(self, task: Task) -> str:
        """Return the digest by which a later run knows whether it would do the same."""
        if task.name not in self.keys:
            self.keys[task.name] = task_key(task, self.folder)
        return self.keys[task.name]

    def outcomes(self) -> tuple[Outcome, ...]:
        """Return what became of the tasks as they are now: outcomes of others are of another batch in this folder."""
        wanted = {task.name: task for task in self.tasks}
        known = (self.journal.outcomes.get(name) for name in wanted)
        return tuple(each for each in known if each is not None and each.key == self.key_of(wanted[each.name]))

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
        if before is None or not before.is_done or before.key != self.key_of(task):
            return False
        if [*before.inputs] != [*task.inputs] or [*before.outputs] != outputs_of(task):
            return False
        every = (*before.inputs.items(), *before.outputs.items())
        return all(is_unchanged(path, known, verify=self.verify) for path, known in every)

    def drive(self, engine: Engine, waiting: deque[Task]) -> None:
        """Do tasks, a few at a time; what was not begun after a failure stays in `waiting`."""
        wanted, self.total = {task.name: task for task in waiting}, len(waiting)
        flying: set[str] = set()
        while waiting or self.suspects or flying:
            stopping = self.failures and not self.keep_going
            while not stopping and (task := self._next(engine, waiting, len(flying))) is not None:
                self.tries[task.name] = self.tries.get(task.name, 0) + 1
                engine.submit(Work(task.name, task.to_json(), self.key_of(task), code_digest(), self.device))
                flying.add(task.name)
            if not flying:
                return
            self._tell(engine)
            is_alone = engine.isolates or len(flying) == 1
            for ended in engine.collect(_LOOK_SECONDS):
                flying.discard(ended.name)
                if self._is_refused(engine, ended):
                    waiting.appendleft(wanted[ended.name])
                else:
                    self._settle(wanted[ended.name], ended, is_alone)

    def _next(self, engine: Engine, waiting: deque[Task], flying: int) -> Task | None:
        """Return the next task to begin; None where there is none, or all workers have enough."""
        if waiting:
            return waiting.popleft() if flying < engine.workers + engine.ahead else None
        # What died with its worker is tried last: where workers hold several tasks, one alone, so that an innocent one
        # does not die twice of its neighbour.
        most = engine.workers if engine.isolates else 1
        return self.suspects.popleft() if self.suspects and flying < most else None

    def _is_refused(self, engine: Engine, ended: Ended) -> bool:
        """Return whether a worker has no sound device, and others go on without it."""
        if ended.outcome is None:
            return False
        outcome = Outcome.from_json(ended.outcome)
        if outcome.kind != "device" or not engine.avoid(outcome.worker):
            return False
        self.report.note(f"{outcome.worker} gets no more stacks: {outcome.error}")
        return True

    def _settle(self, task: Task, ended: Ended, is_alone: bool) -> None:
        tries = self.tries[task.name]
        if ended.outcome is None:
            alone, deaths = self._count_death(task.name, is_alone)
            if ended.kind == "died" and (not alone or deaths <= self.retries):
                # What was given out first was most likely being done: so it comes last, and those who only waited
                # behind it find a worker that has not to be started anew.
                (self.suspects.append if alone else self.suspects.appendleft)(task)
                return
            times = f", {deaths} times" if deaths > 1 else ""
            outcome = Outcome(task.name, FAILED, self.key_of(task), f"{ended.fault}{times}", ended.kind, tries=tries)
        else:
            outcome = replace(Outcome.from_json(ended.outcome), tries=tries)
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
