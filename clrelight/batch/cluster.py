"""The engines of Dask: processes of this machine that it looks after, or a scheduler's workers, wherever they are.

Dask brings what a cluster needs: workers that come and go, and are started anew; limits on their memory; batch systems
such as SLURM. The driver gives tasks out, a few at a time, and decides itself what is tried again. What Dask does for
each task takes milliseconds of the scheduler and of the worker: small tasks go to a worker several at a time.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import queue
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any

from clrelight.batch.engine import Ended, Work, usable_cores, worker_environment
from clrelight.batch.pace import MOST_SECONDS, Pace
from clrelight.batch.perform import perform
from clrelight.errors import InputError

INSTALL = "the engines of Dask need it: pip install 'clrelight[cluster]'"
_SCHEMES = ("tcp://", "tls://", "ucx://", "ws://", "wss://")
_PATIENCE = "30s"
_EVERY_SECONDS = 1.0
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Of which Dask gives a worker one; one that is alone here has all, as any command has."""
_UNGUARDED = "a script keeps what starts workers of Dask under if __name__ == '__main__', since each of them imports it"


def is_address(engine: str) -> bool:
    """Return whether the name of an engine is the address of a scheduler."""
    return engine.startswith(_SCHEMES)


@dataclass
class _Parcel:
    """Tasks that a worker does one after the other: one task to Dask, with its future."""

    works: list[Work]
    future: Any = field(default=None, repr=False)


class DaskEngine:
    """Tasks go to workers of Dask, one to each of their threads, or a parcel of small ones.

    Parameters
    ----------
    address : str, optional
        Of a scheduler; without one, workers are started on this machine.
    workers : int, optional
        Of this machine; default: a worker to each two processors.
    memory : str
        Limit of each of these, as Dask takes it, after which it is started anew; ``"auto"``: its share.

    Raises
    ------
    InputError
        If Dask is not installed, no worker can be started, or the scheduler cannot be reached.
    """

    isolates = False

    def __init__(
        self,
        address: str | None = None,
        *,
        workers: int | None = None,
        memory: str = "auto",
    ) -> None:
        try:
            import dask
            import distributed
        except ImportError:
            raise InputError(INSTALL) from None
        self._distributed = distributed
        self._ended: queue.Queue[_Parcel] = queue.Queue()
        self._held: list[Work] = []
        self._flying: dict[int, _Parcel] = {}
        self._pace = Pace()
        self._unsound: set[str] = set()
        self._warm: set[str] = set()
        self._died: set[str] = set()
        self._known: dict[str, int] = {}
        self._asked, self._count = 0.0, 0
        self._cluster: Any = None
        if address is None:
            self._cluster = self._start(dask, workers or max(1, usable_cores() // 2), memory)
        try:
            with dask.config.set({"distributed.comm.timeouts.connect": _PATIENCE}):
                self._client = distributed.Client(self._cluster or address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"no scheduler answers at {address}: {_line(error)}") from error
        self.label = f"dask {address}" if address else f"dask, {self.workers} workers"
        if not self._threads():
            with suppress(Exception):
                self._client.wait_for_workers(1, timeout=_PATIENCE)
        if not self._threads():
            self.close()
            raise InputError(f"the scheduler at {address} has no workers: start some, such as dask worker {address}")

    def _start(self, dask: Any, workers: int, memory: str) -> Any:
        settings = {
            # The driver decides: of tasks that wait at a worker which dies, one is to blame and the others are not.
            "distributed.scheduler.allowed-failures": 0,
            "distributed.worker.multiprocessing-method": "spawn",
            "distributed.nanny.pre-spawn-environ": {
                **dask.config.get("distributed.nanny.pre-spawn-environ", {}),
                # With any threshold, memory of arrays that are gone is asked of the system again for the next: half of
                # what a worker did. Who takes too much of it is seen by the memory limit.
                "MALLOC_TRIM_THRESHOLD_": None,
                **(worker_environment(workers) if workers > 1 else dict.fromkeys(_THREADS)),
            },
            "distributed.worker.profile.enabled": False,
            "distributed.admin.tick.interval": "250ms",
            "distributed.admin.system-monitor.gil.enabled": False,
        }
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            raise InputError(_UNGUARDED)
        with dask.config.set(settings):
            try:
                return self._distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    memory_limit=memory,
                    dashboard_address="127.0.0.1:0",
                    host="127.0.0.1",
                    silence_logs=50,
                )
            except RuntimeError as error:
                raise InputError(f"no worker of Dask could be started: {_line(error)} ({_UNGUARDED})") from error

    def _threads(self) -> dict[str, int]:
        """Return how many tasks each sound worker does at a time; asked of the scheduler once in a while."""
        if time.monotonic() > self._asked + _EVERY_SECONDS or not self._known:
            self._known, self._asked = dict(self._client.nthreads()), time.monotonic()
        return {name: count for name, count in self._known.items() if name not in self._unsound}

    @property
    def workers(self) -> int:
        """How many tasks are done at a time by the workers that there are now."""
        return max(1, sum(self._threads().values()))

    @property
    def ahead(self) -> int:
        """How many more may wait at workers: one for each, or a parcel where tasks are small."""
        return self.workers * (2 * self._pace.size - 1)

    def submit(self, work: Work) -> None:
        """Give a task to the scheduler, or hold it until there is a parcel of them."""
        self._held.append(work)
        if len(self._held) >= self._pace.size:
            self._send()

    def _send(self) -> None:
        """Give to the scheduler what is held."""
        while self._held:
            parcel = _Parcel(self._held[: self._pace.size])
            del self._held[: len(parcel.works)]
            only = self._where(parcel)
            self._count += 1
            key = f"{parcel.works[0].name}-{len(parcel.works)}-{self._count}"  # each try is another to the scheduler
            told = [asdict(work) for work in parcel.works]
            parcel.future = self._client.submit(_perform, told, key=key, pure=False, **only)
            self._flying[id(parcel)] = parcel
            parcel.future.add_done_callback(lambda _, parcel=parcel: self._ended.put(parcel))

    def _where(self, parcel: _Parcel) -> dict[str, Any]:
        """Return which workers may do tasks: sound ones; what died is better tried where nothing is to be loaded."""
        if self._unsound:
            return {"workers": [*self._threads()], "allow_other_workers": False}
        warm = self._warm & self._threads().keys() if parcel.works[0].name in self._died else set()
        return {"workers": [*warm], "allow_other_workers": True} if warm else {}

    def collect(self, seconds: float) -> list[Ended]:
        """Return what has ended, after waiting for the first so long at most."""
        self._send()
        ended: list[Ended] = []
        with suppress(queue.Empty):
            parcel = self._ended.get(timeout=seconds)
            while True:
                if self._flying.pop(id(parcel), None) is not None:
                    ended += self._told(parcel)
                parcel = self._ended.get_nowait()
        if not ended and self._client.status not in ("running", "connecting"):
            raise InputError(self._gone())
        return ended

    def _gone(self) -> str:
        return f"{self.label}: the scheduler is gone; run the batch again to go on"

    def _told(self, parcel: _Parcel) -> list[Ended]:
        future, names = parcel.future, [work.name for work in parcel.works]
        if future.status == "finished":
            outcomes = future.result()
            self._pace.learn([outcome.get("seconds", 0.0) for outcome in outcomes])
            self._warm.update(outcome["worker"] for outcome in outcomes)
            self._held += parcel.works[len(outcomes) :]  # for which its worker took no time
            return [Ended(name, outcome) for name, outcome in zip(names, outcomes, strict=False)]
        error = future.exception() if future.status == "error" else None
        future.release()
        if error is None:
            raise InputError(self._gone())
        self._died.update(names)
        self._known = {}  # of workers, of which there is another now
        fault = f"{type(error).__name__}: {_line(error)}"
        if isinstance(error, self._distributed.KilledWorker):
            fault = f"ends the process of its worker {error.last_worker.address}"
        return [Ended(name, None, fault, "died") for name in names]

    def doing(self) -> str:
        """Return how many tasks are being done or wait."""
        count = sum(len(parcel.works) for parcel in self._flying.values()) + len(self._held)
        return f"{count} at {self.workers} workers"

    def avoid(self, worker: str) -> bool:
        """Give no more tasks to a worker whose device is not sound; return whether there are others."""
        self._unsound.add(worker)
        return bool(self._threads())

    def close(self) -> None:
        """End all workers that were started here; the tasks that others have are cancelled."""
        with suppress(Exception):
            if self._flying:
                self._client.cancel([parcel.future for parcel in self._flying.values()], force=True)
            self._kill()
        for each in (self._client, self._cluster):
            with suppress(Exception):
                if each is not None:
                    each.close(timeout=3)
        with suppress(Exception):
            self._kill()  # what was started anew meanwhile
            self._cluster.shutdown_on_close = False  # for which Dask waits again when Python ends
        # Semaphores of processes that have ended go with their owners; who ends without Python's exit leaves them.
        self._client = self._cluster = None
        gc.collect()

    def _kill(self) -> None:
        """End workers of this machine: Dask would wait for what they do, their end, and those that it starts anew."""
        for nanny in list(self._cluster.workers.values()) if self._cluster is not None else ():
            nanny.auto_restart = False
            with suppress(OSError, TypeError):  # one that has just died, or has no process yet
                os.kill(nanny.pid, signal.SIGKILL)


def _perform(works: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Do tasks at a worker, as many as there is time for, and name it as the scheduler does."""
    from distributed import get_worker

    worker, end = get_worker().address, time.monotonic() + MOST_SECONDS
    done: list[dict[str, Any]] = []
    for work in works:
        if done and time.monotonic() > end:  # these take longer than those before them: others may have time for them
            break
        done.append({**perform(work["task"], work["key"], work["code"], work["device"]), "worker": worker})
    return done


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:500] or type(error).__name__
