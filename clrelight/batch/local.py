"""The engine of one machine: processes that are started anew, so that a task which ends its process ends alone."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import asdict
from typing import IO, Any

from clrelight.batch.engine import Ended, Work, usable_cores, worker_environment
from clrelight.errors import InputError
from clrelight.interrupts import at_end, forget, holding
from clrelight.opencl.child import describe_end

_CODE = "from clrelight.batch.child import main; main()"
_END_SECONDS = 4.0
_MOST_COMPLAINT = 1 << 16


class LocalEngine:
    """Workers on this machine, each a process of its own that does one task after the other.

    Parameters
    ----------
    workers : int
        How many tasks are done at a time, each with its share of the processors.
    timeout : float, optional
        Seconds after which a task is given up, and its process ended.
    lock : int, optional
        A descriptor that workers inherit, and with it the lock it holds.
    """

    isolates = True
    ahead = 0

    def __init__(self, workers: int = 1, *, timeout: float | None = None, lock: int | None = None) -> None:
        if not 1 <= workers <= 1024:
            raise InputError(f"a batch has from 1 to 1024 workers, got {workers}")
        self.workers = workers
        cores = usable_cores()
        self.label = f"local, {workers} worker{'s' * (workers > 1)} of {max(1, cores // workers)} cores"
        self._timeout, self._lock = timeout, lock
        self._idle: list[_Worker] = []
        self._busy: dict[str, _Worker] = {}

    def begin(self) -> None:
        """Start all workers: what they load they have when the first task comes."""
        while len(self._idle) + len(self._busy) < self.workers:
            self._idle.append(_Worker(self.workers, self._lock))

    def submit(self, work: Work) -> None:
        """Begin a task in an idle process, or in a new one."""
        near = str(work.task.get("near", ""))
        mine = [worker for worker in self._idle if near and near in worker.near]
        others = [worker for worker in self._idle if not (near and worker.near)]  # who keeps another one's last
        worker = (mine or others or self._idle or [_Worker(self.workers, self._lock)])[-1]
        if worker in self._idle:
            self._idle.remove(worker)
        if near:
            worker.near.add(near)
        self._busy[work.name] = worker
        worker.begin(work, self._timeout)

    def collect(self, seconds: float) -> list[Ended]:
        """Return what has ended, after waiting for the first so long at most."""
        end = time.monotonic() + seconds
        while True:
            ended = [found for worker in [*self._busy.values()] if (found := worker.look()) is not None]
            for each in ended:
                worker = self._busy.pop(each.name)
                if worker.is_alive:
                    self._idle.append(worker)
                else:
                    worker.close()
            left = min([end, *(worker.deadline for worker in self._busy.values())]) - time.monotonic()
            if ended or not self._busy or time.monotonic() >= end:
                return ended
            _await([worker.output for worker in self._busy.values()], max(left, 0.0))

    def doing(self) -> str:
        """Return names of the tasks that are being done, and of one how far it is."""
        names = [*self._busy]
        at = self._busy[names[0]].at if len(names) == 1 else ""
        return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "") + (at and f": {at}")

    def avoid(self, worker: str) -> bool:
        """Return that there is no other machine."""
        return False

    def close(self) -> None:
        """End all processes: at once those that are idle, with a grace those that have files to remove."""
        workers = [*self._idle, *self._busy.values()]
        self._idle, self._busy = [], {}
        for worker in workers:
            worker.ask_to_end()
        end = time.monotonic() + _END_SECONDS
        for worker in workers:
            worker.close(max(0.0, end - time.monotonic()))


def _await(streams: list[IO[bytes]], seconds: float) -> None:
    with selectors.DefaultSelector() as selector:
        for stream in streams:
            selector.register(stream, selectors.EVENT_READ)
        selector.select(seconds)


class _Worker:
    """A process that does tasks, and the task that it has."""

    def __init__(self, workers: int, lock: int | None) -> None:
        self._complaints = tempfile.TemporaryFile()  # noqa: SIM115, closed with the worker
        with holding():  # or an interrupt leaves a process of which nobody knows
            self._process = subprocess.Popen(
                [sys.executable, "-c", f"import sys; sys.path[:] = {sys.path!r}; {_CODE}"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._complaints,
                env={**os.environ, **worker_environment(workers)},
                pass_fds=[] if lock is None else [lock],
                start_new_session=True,  # Ctrl-C is for the driver, which ends its workers
            )
            self._key = at_end(self._kill)
        self.output: IO[bytes] = self._process.stdout  # type: ignore[assignment]
        os.set_blocking(self.output.fileno(), False)
        self._rest = b""
        self.at, self.name, self.deadline, self.is_alive = "", "", float("inf"), True
        self.near: set[str] = set()
        self._timeout: float | None = None

    def begin(self, work: Work, timeout: float | None) -> None:
        self._complaints.seek(0)
        self._complaints.truncate()
        self.name, self.at, self._timeout = work.name, "", timeout
        self.deadline = time.monotonic() + timeout if timeout else float("inf")
        with suppress(BrokenPipeError):  # it has ended: `look` tells
            assert self._process.stdin is not None
            self._process.stdin.write(json.dumps(asdict(work)).encode("ascii") + b"\n")
            self._process.stdin.flush()

    def look(self) -> Ended | None:
        """Return how the task has ended; None where it has not."""
        while True:
            try:
                piece = os.read(self.output.fileno(), 1 << 16)
            except BlockingIOError:
                break
            if not piece:
                return self._ended()
            *lines, self._rest = (self._rest + piece).split(b"\n")
            for line in lines:
                message: dict[str, Any] = json.loads(line)
                if "outcome" in message:
                    self.deadline = float("inf")
                    return Ended(self.name, message["outcome"])
                self.at = message["at"]
        if time.monotonic() < self.deadline:
            return None
        self._kill()
        self.is_alive = False
        return Ended(self.name, None, f"took longer than {self._timeout:g} s", "late")

    def _ended(self) -> Ended:
        self.is_alive = False
        code = self._process.wait()
        size = self._complaints.seek(0, os.SEEK_END)
        self._complaints.seek(max(0, size - _MOST_COMPLAINT))
        complaint = self._complaints.read().decode("utf-8", "replace")
        return Ended(self.name, None, describe_end(code, complaint, 0.0), "died")

    def ask_to_end(self) -> None:
        with suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        if self._process.poll() is None and self.name:
            with suppress(OSError):
                self._process.send_signal(signal.SIGTERM)

    def close(self, seconds: float = 0.0) -> None:
        self.ask_to_end()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        self._kill()
        forget(self._key)
        self.output.close()
        self._complaints.close()

    def _kill(self) -> None:
        if self._process.poll() is None:
            with suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
