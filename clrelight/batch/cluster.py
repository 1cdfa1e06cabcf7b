"""The engines of Dask: processes of this machine that it looks after, or a scheduler's workers, wherever they are.

Dask brings what a cluster needs: workers that come and go, and are started anew; limits on their memory; batch systems
such as SLURM. The driver gives tasks out, a few at a time, and decides itself what is tried again.
"""

from __future__ import annotations

import gc
import os
import queue
import signal
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from clrelight.batch.engine import Ended, Work, usable_cores, worker_environment
from clrelight.batch.perform import perform
from clrelight.errors import InputError

INSTALL = "the engines of Dask need it: pip install 'clrelight[cluster]'"
_SCHEMES = ("tcp://", "tls://", "ucx://", "ws://", "wss://")
_PATIENCE = "30s"
_EVERY_SECONDS = 1.0


def is_address(engine: str) -> bool:
    """Return whether the name of an engine is the address of a scheduler."""
    return engine.startswith(_SCHEMES)


class DaskEngine:
    """Tasks go to workers of Dask, one to each of their threads.

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
        If Dask is not installed, or the scheduler cannot be reached.
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
        self._ended: queue.Queue[tuple[str, Any]] = queue.Queue()
        self._waiting: dict[str, Any] = {}
        self._unsound: set[str] = set()
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
                **worker_environment(workers),
            },
            "distributed.admin.system-monitor.gil.enabled": False,
        }
        with dask.config.set(settings):
            return self._distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                memory_limit=memory,
                dashboard_address="127.0.0.1:0",
                host="127.0.0.1",
                silence_logs=50,
            )

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
        """How many more may wait at workers: one for each."""
        return self.workers

    def submit(self, work: Work) -> None:
        """Give a task to the scheduler."""
        only = {"workers": [*self._threads()], "allow_other_workers": False} if self._unsound else {}
        self._count += 1
        key = f"{work.name}-{work.key}-{self._count}"  # each try is another to the scheduler
        future = self._client.submit(_perform, work.task, work.key, work.code, work.device, key=key, pure=False, **only)
        self._waiting[work.name] = future
        future.add_done_callback(lambda ended, name=work.name: self._ended.put((name, ended)))

    def collect(self, seconds: float) -> list[Ended]:
        """Return what has ended, after waiting for the first so long at most."""
        ended = []
        with suppress(queue.Empty):
            name, future = self._ended.get(timeout=seconds)
            while True:
                if self._waiting.get(name) is future:
                    del self._waiting[name]
                    ended.append(self._told(name, future))
                name, future = self._ended.get_nowait()
        if not ended and self._client.status not in ("running", "connecting"):
            raise InputError(f"{self.label}: the scheduler is gone; run the batch again to go on")
        return ended

    def _told(self, name: str, future: Any) -> Ended:
        error = future.exception() if future.status == "error" else None
        if future.status == "finished":
            return Ended(name, future.result())
        future.release()
        if isinstance(error, self._distributed.KilledWorker):
            return Ended(name, None, f"ends the process of its worker {error.last_worker.address}", "died")
        if error is None:
            raise InputError(f"{self.label}: the scheduler is gone; run the batch again to go on")
        return Ended(name, None, f"{type(error).__name__}: {_line(error)}", "died")

    def doing(self) -> str:
        """Return how many tasks are being done or wait."""
        return f"{len(self._waiting)} at {self.workers} workers"

    def avoid(self, worker: str) -> bool:
        """Give no more tasks to a worker whose device is not sound; return whether there are others."""
        self._unsound.add(worker)
        return bool(self._threads())

    def close(self) -> None:
        """End all workers that were started here; the tasks that others have are cancelled."""
        with suppress(Exception):
            if self._waiting:
                self._client.cancel(list(self._waiting.values()), force=True)
                self._kill()
        for each in (self._client, self._cluster):
            with suppress(Exception):
                if each is not None:
                    each.close(timeout=3)
        # Semaphores of processes that have ended go with their owners; who ends without Python's exit leaves them.
        self._client = self._cluster = None
        gc.collect()

    def _kill(self) -> None:
        """End workers of this machine that are at work, for which Dask would wait."""
        for nanny in list(self._cluster.workers.values()) if self._cluster is not None else ():
            nanny.auto_restart = False
            if nanny.pid:
                os.kill(nanny.pid, signal.SIGKILL)


def _perform(task: Mapping[str, Any], key: str, code: str, device: str | None) -> dict[str, Any]:
    """Do a task at a worker, and name it as the scheduler does."""
    from distributed import get_worker

    return {**perform(task, key, code, device), "worker": get_worker().address}


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:500] or type(error).__name__
