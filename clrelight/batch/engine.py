"""What an engine is: something that does tasks elsewhere, a few at a time, and tells how they ended."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol


@dataclass(frozen=True)
class Work:
    """A task as it goes to a worker: all that `perform.perform` takes, as JSON."""

    name: str
    task: Mapping[str, Any]
    key: str
    code: str
    device: str | None


@dataclass(frozen=True)
class Ended:
    """How a task ended.

    Attributes
    ----------
    name : str
    outcome : mapping, optional
        What the worker says, `Outcome.to_json`; None where it could say nothing.
    fault : str
        How the worker ended instead, in words.
    kind : str
        ``"died"``, or ``"late"`` where the time was up.
    """

    name: str
    outcome: Mapping[str, Any] | None
    fault: str = ""
    kind: str = ""


class Engine(Protocol):
    """Does tasks in other processes.

    Attributes
    ----------
    label : str
        What it is, for people.
    workers : int
        How many tasks are done at a time.
    ahead : int
        How many more may wait at the workers, so that none is idle while the driver is told.
    isolates : bool
        Whether the end of a worker is the fault of one task, since it had no other.
    """

    label: str
    isolates: bool

    @property
    def workers(self) -> int:
        """How many tasks are done at a time."""

    @property
    def ahead(self) -> int:
        """How many more may wait at the workers."""

    def submit(self, work: Work) -> None:
        """Begin a task, or have it wait at a worker."""

    def collect(self, seconds: float) -> list[Ended]:
        """Return what has ended, after waiting for the first so long at most."""

    def doing(self) -> str:
        """Return what is being done, in words, as far as it is known."""

    def avoid(self, worker: str) -> bool:
        """Give no more tasks to a worker whose device is not sound; return whether there are others."""

    def close(self) -> None:
        """End all workers; what they have not finished is discarded."""


def usable_cores() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def worker_environment(workers: int, given: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return variables that give each of some workers its share of the processors, unless the user has set them.

    A worker alone has all of them, as any command has.
    """
    if workers < 2:
        return {}
    share = str(max(1, usable_cores() // workers))
    names = ("POCL_MAX_PTHREAD_COUNT", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "PYTHON_CPU_COUNT")
    return {name: share for name in names if name not in given}
