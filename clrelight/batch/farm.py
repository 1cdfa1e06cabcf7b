"""A farm of an engine's workers: chores of one job as tasks, their arrays as shards, all of it in a batch's journal."""

from __future__ import annotations

import hashlib
import json
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clrelight.batch.driver import Driver
from clrelight.batch.engine import Engine
from clrelight.batch.fingerprint import content_of, read_content, take_seal
from clrelight.batch.journal import Journal
from clrelight.batch.leftovers import sweep
from clrelight.batch.local import LocalEngine
from clrelight.batch.task import Outcome, Task
from clrelight.durable import naming, replacing
from clrelight.errors import InputError
from clrelight.jobs.farm import Arrays, Chore, ChoreError, StoredArrays, pack_arrays, unpack_arrays
from clrelight.jobs.held import look_of
from clrelight.jobs.report import Progress, Report
from clrelight.memory import PIECE_BYTES

_DIGITS = 16


@dataclass
class Workers:
    """An engine that is opened when there is something to do, and how it is driven.

    Attributes
    ----------
    open_engine : callable
    journal : Journal
        Of the batch; tasks of farms stand in it beside whole jobs.
    root : Path
        The batch's folder.
    device : str or None
    keep_going : bool
    retries : int
    """

    open_engine: Callable[[], Engine]
    journal: Journal
    root: Path
    device: str | None = None
    keep_going: bool = False
    retries: int = 1
    engine: Engine | None = None

    def opened(self) -> Engine:
        """Return the engine."""
        if self.engine is None:
            self.engine = self.open_engine()
        return self.engine

    def close(self) -> None:
        """End all workers."""
        if self.engine is not None:
            self.engine.close()
            self.engine = None


@dataclass
class TaskFarm:
    """The farm of one job: see `clrelight.jobs.farm.Farm`.

    Attributes
    ----------
    name : str
        Of the job's stack, by which the journal knows its tasks.
    folder : str
        Where shards and shared files lie.
    workers : Workers
    progress : callable or None
    report : Report
        Gets notes of failures.
    """

    name: str
    folder: str
    workers: Workers
    progress: Progress | None
    report: Report
    known: dict[str, Any] = field(default_factory=dict)

    def do(self, chores: Sequence[Chore], what: str) -> Iterator[Arrays]:
        """See `Farm`."""
        tasks = [self._task(chore) for chore in chores]
        self._run(tasks, what)
        return (self._arrays(task) for task in tasks)

    def begin(self) -> None:
        """See `Farm`."""
        engine = self.workers.opened()
        if isinstance(engine, LocalEngine):
            engine.begin()

    def write(self, chores: Sequence[tuple[Chore, str]], what: str) -> list[str]:
        """See `Farm`."""
        tasks = [self._task(chore, out) for chore, out in chores]
        self._run(tasks, what)
        return [note for task in tasks for note in self._outcome(task).notes]

    def share(self, name: str, arrays: Arrays) -> str:
        """See `Farm`."""
        content = pack_arrays(arrays)
        path = os.path.join(self.folder, f"{name}-{hashlib.sha256(content).hexdigest()[:_DIGITS]}.npz")
        self._make_folder()
        try:
            if Path(path).read_bytes() == content:
                return path
        except OSError:
            pass
        with replacing(path) as part:
            part.write(content)
        return path

    def _make_folder(self) -> None:
        with naming(self.folder):
            os.makedirs(self.folder, exist_ok=True)

    def _task(self, chore: Chore, out: str | None = None) -> Task:
        """Return a chore as a task, whose name hangs on all that it is, so that no other has its shard."""
        options = {
            name: os.path.relpath(value, self.folder) if isinstance(value, str) and os.path.isabs(value) else value
            for name, value in chore.options.items()
        }
        said = json.dumps([chore.job, options], sort_keys=True).encode("ascii")
        digest = hashlib.sha256(said).hexdigest()[:_DIGITS]
        inputs = (chore.source, *chore.reads)
        place = out or os.path.join(self.folder, f"{chore.job}-{digest}.npz")
        known = {path: self._known(path) for path in inputs if not os.path.isdir(path)}
        name = f"{self.name}@{chore.job}-{digest}"
        return Task(name, chore.job, chore.source, place, chore.options, inputs, known, chore.near)

    def _known(self, path: str) -> Any:
        """Return the fingerprint of a file, taken once for all workers as long as it looks the same."""
        key = look_of(path)
        if self.known.get(path, (None,))[0] != key:
            self.known[path] = key, take_seal(path)
        return self.known[path][1]

    def _run(self, tasks: Sequence[Task], what: str) -> None:
        self._make_folder()
        workers = self.workers
        wanted = list({task.name: task for task in tasks}.values())
        driver = Driver(
            wanted,
            workers.root,
            workers.journal,
            workers.device,
            workers.keep_going,
            workers.retries,
            verify=False,
            progress=None,
            report=self.report,
        )
        kept = driver.find_kept()  # of which there is nothing to tell
        driver.progress = self._teller(what)
        waiting = deque(task for task in wanted if task.name not in kept or not self._is_whole(task))
        if not waiting:
            return
        try:
            driver.drive(workers.opened(), waiting)
        finally:
            sweep(task.out for task in wanted)
        failed = [outcome for outcome in driver.outcomes() if not outcome.is_done]
        if failed:
            more = f" (and {len(failed) - 1} more parts)" if len(failed) > 1 else ""
            raise ChoreError(f"{failed[0].name}: {failed[0].error}{more}", failed[0].kind)

    def _teller(self, what: str) -> Progress | None:
        progress = self.progress
        if progress is None:
            return None
        return lambda done, total, doing: progress(done, total, what)

    def _outcome(self, task: Task) -> Outcome:
        return self.workers.journal.outcomes[task.name]

    def _is_whole(self, task: Task) -> bool:
        """Return whether a shard of an earlier run holds what was written, bit for bit: nothing else looks at it."""
        try:
            return not task.out.endswith(".npz") or bool(self._content(task))
        except InputError:
            return False

    def _arrays(self, task: Task) -> Arrays:
        """Return the arrays of a shard that is what was written; of a large one each when it is asked for."""
        known = self._outcome(task).outputs[task.out]
        if known["bytes"] <= PIECE_BYTES:
            return unpack_arrays(self._content(task))
        if read_content(task.out) != known["content"]:
            raise _changed(task)
        return StoredArrays(task.out)

    def _content(self, task: Task) -> bytes:
        try:
            content = Path(task.out).read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {task.out}: {error.strerror or error}") from error
        if content_of(content) != self._outcome(task).outputs[task.out]["content"]:
            raise _changed(task)
        return content


def _changed(task: Task) -> InputError:
    return InputError(f"{task.out} is not what was written: run the same again, which makes it anew")
