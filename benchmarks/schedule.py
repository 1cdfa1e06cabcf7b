"""How long batches take, by workers: ``python -m benchmarks.schedule --markdown docs/scale.md``.

What a driver and an engine cost for each task is measured, a schedule is simulated from that, and a real run is
compared with what the simulation says of it. Then the simulation is asked about batches that nobody can run here.
"""

from __future__ import annotations

import heapq
import os
import resource
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import click
import numpy as np

from benchmarks.pages import replace_block
from clrelight.batch import Task, make_tasks, read_listing, run_batch
from clrelight.batch.engine import Ended, Work, usable_cores
from clrelight.batch.fingerprint import code_digest
from clrelight.batch.perform import perform
from clrelight.batch.task import Outcome
from clrelight.dataset import LightStack
from clrelight.jobs.report import Report
from clrelight.sampling import make_pattern
from clrelight.speed.tables import markdown_table
from clrelight.store import write_stack

BEGIN, END = "<!-- schedule -->", "<!-- /schedule -->"
OPTIONS = {"degree": 4}
_PILOTS = 12
SECONDS, READ, WRITTEN = 38.4, 455e6, 45e6
"""Of `pack` of 60 JPEGs of 24 megapixels on two hardware threads: benchmarks.photographs, in docs/performance.md."""


def simulate(
    seconds: Iterable[float],
    workers: int,
    *,
    ahead: int = 0,
    driver: float = 0.0,
    start: float = 0.0,
    deaths: float = 0.0,
    again: float = 0.0,
    seed: int = 0,
) -> float:
    """Return the seconds that a batch takes.

    Parameters
    ----------
    seconds : iterable of float
        Of each task at its worker, in the order in which they are begun.
    workers : int
        Tasks that are done at a time.
    ahead : int
        Tasks that wait at workers.
    driver : float
        Seconds of the one driver for each task; half before it begins, half when it has ended.
    start : float
        Seconds until the first task can begin.
    deaths : float
        Of workers, for each second of work.
    again : float
        Seconds until a worker that died is there again.
    """
    rng = np.random.default_rng(seed)
    free = [start] * workers
    flying: list[tuple[float, float]] = []
    waiting, now = deque((each, each) for each in seconds), start
    while waiting or flying:
        while waiting and len(flying) < workers + ahead:
            now += driver / 2
            length, whole = waiting.popleft()
            begin = max(now, heapq.heappop(free))
            life = rng.exponential(1.0 / deaths) if deaths else np.inf
            dies = life < length
            end = begin + (life if dies else length)
            heapq.heappush(free, end + (again if dies else 0.0))
            heapq.heappush(flying, (end, whole if dies else 0.0))
        end, left = heapq.heappop(flying)
        now = max(now, end) + driver / 2
        if left:
            waiting.append((left, left))
    return now


class Nothing:
    """An engine whose tasks end at once: what is left is the driver."""

    label, workers, ahead, isolates = "nothing", 1, 0, True

    def __init__(self) -> None:
        self._held: list[Work] = []

    def submit(self, work: Work) -> None:
        """Keep a task."""
        self._held.append(work)

    def collect(self, seconds: float) -> list[Ended]:
        """Say that it is done."""
        work = self._held.pop()
        files = {"/data/in.h5": {"bytes": 1, "files": 1, "stat": "0" * 32, "content": "0" * 32}}
        told = Outcome(work.name, "done", work.key, inputs=files, outputs=files, seconds=1.0, psnr={"pooled": 30.0})
        return [Ended(work.name, told.to_json())]

    def doing(self) -> str:
        """Say nothing."""
        return ""

    def avoid(self, worker: str) -> bool:
        """Say that there is no other."""
        return False

    def close(self) -> None:
        """Do nothing."""


def measure_driver(folder: Path, count: int) -> float:
    """Return the seconds of a driver for each task: the journal's flush and the tables are among them."""
    tasks = [Task(f"t{i}", "fit", f"/none/{i}.h5", str(folder / f"{i}.h5"), OPTIONS) for i in range(count)]
    since = time.perf_counter()
    run_batch(tasks, folder, engine=lambda lock: Nothing(), report=Report())
    return (time.perf_counter() - since) / count


@dataclass(frozen=True)
class Cost:
    """What an engine costs: seconds until it has done its first task, and for each task more."""

    start: float
    task: float


@dataclass(frozen=True)
class Run:
    """A batch that was run: its seconds, those of processors, and those of each task at its worker, in order."""

    seconds: float
    cpu: float
    lengths: list[float]


def _processor_seconds() -> float:
    """Return what this process has taken of processors, and its children that have ended."""
    return sum(each.ru_utime + each.ru_stime for each in map(resource.getrusage, _WHOSE))


_WHOSE = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)


def measure_single(name: str, workers: int, count: int) -> float:
    """Return an engine's seconds for each task where it gives them out one at a time, as it does large ones."""
    with mock.patch("clrelight.batch.pace._MOST_TASKS", 1):
        return measure_engine(name, workers, count).task


def measure_engine(name: str, workers: int, count: int) -> Cost:
    """Return what an engine takes for tasks that its workers refuse at once, as they come from another program."""
    from clrelight.batch.cluster import DaskEngine
    from clrelight.batch.local import LocalEngine

    since = time.perf_counter()
    engine = LocalEngine(workers) if name == "local" else DaskEngine(workers=workers)
    try:
        ends = []
        task = Task("t", "fit", "/none.h5", "/none/t.h5")
        waiting = [Work(f"t{i}", task.to_json(), "", "other", None) for i in range(count + workers)]
        flying = 0
        while waiting or flying:
            while waiting and flying < engine.workers + engine.ahead:
                engine.submit(waiting.pop())
                flying += 1
            ended = engine.collect(1.0)
            flying -= len(ended)
            ends += [time.perf_counter()] * len(ended)
    finally:
        engine.close()
    # Each worker's first task waits for its process.
    return Cost(ends[0] - since, (ends[-1] - ends[workers]) / count)


def make_stacks(folder: Path, count: int, size: int) -> Path:
    """Write stacks of noise."""
    directions = make_pattern("uniform", 48)
    folder.mkdir()
    for i in range(count):
        images = np.random.default_rng(i).integers(0, 256, (48, size, size, 3), np.uint8)
        write_stack(folder / f"{i:04d}.h5", LightStack(images, directions, 255.0))
    return folder


def run_real(stacks: Path, out: Path, name: str, workers: int) -> Run:
    """Fit all stacks with an engine."""
    tasks = make_tasks(read_listing(stacks, "fit"), out, job="fit", options=OPTIONS)
    since, before = time.perf_counter(), _processor_seconds()
    batch = run_batch(tasks, out, engine=name, workers=workers, report=Report())
    assert not batch.failed
    spent, cpu = time.perf_counter() - since, _processor_seconds() - before
    return Run(spent, cpu, [each.seconds for each in batch.outcomes])


def run_alone(stacks: Path, out: Path) -> Run:
    """Fit all stacks in this process, one after the other, as if the first took what the others do."""
    tasks = make_tasks(read_listing(stacks, "fit"), out, job="fit", options=OPTIONS)
    lengths, cpu = [], 0.0
    for task in tasks:
        before = _processor_seconds()
        told = perform(task.to_json(), "", code_digest(), None)
        assert told["state"] == "done"
        lengths.append(told["seconds"])
        cpu += (_processor_seconds() - before) * (len(lengths) > 1)
    whole = len(tasks) / (len(tasks) - 1)
    return Run(sum(lengths[1:]) * whole, cpu * whole, lengths)


@dataclass(frozen=True)
class Check:
    """A real run beside what was said of it, in seconds; `start` holds what its first tasks took beyond the others."""

    engine: str
    workers: int
    start: float
    run: Run
    simulated: float
    foretold: float
    alone: Run
    cost: Cost

    @property
    def net(self) -> float:
        """Seconds without those of the start."""
        return self.run.seconds - self.start


def check(folder: Path, count: int, size: int, driver: float, engines: Sequence[tuple[str, int]]) -> list[Check]:
    """Compare real runs with simulations: of the tasks' own seconds, and of those of a few pilots."""
    stacks = make_stacks(folder / "in", count, size)
    alone = run_alone(stacks, folder / "alone")
    pilots = folder / "pilots"
    pilots.mkdir()
    for path in sorted(stacks.iterdir())[:_PILOTS]:
        os.link(path, pilots / path.name)
    rows = []
    for name, workers in engines:
        cost = measure_engine(name, workers, 100)
        lengths = run_real(pilots, folder / f"p-{name}-{workers}", name, workers).lengths
        # The first task of each worker loads what the others have.
        first, rest = float(np.median(lengths[:workers])), float(np.mean(lengths[workers:]))
        ahead = workers if name == "dask" else 0
        each = max(driver, cost.task)
        foretold = simulate(
            [first] * workers + [rest] * (count - workers), workers, ahead=ahead, driver=each, start=cost.start
        )
        run = run_real(stacks, folder / f"r-{name}-{workers}", name, workers)
        simulated = simulate(run.lengths, workers, ahead=ahead, driver=each, start=cost.start)
        loading = max(0.0, float(np.mean(run.lengths[:workers]) - np.median(run.lengths[workers:])))
        rows.append(Check(name, workers, cost.start + loading, run, simulated, foretold, alone, cost))
    return rows


def scale_rows(stacks: int, seconds: float, read: float, written: float, driver: float, disk: float) -> list[list[str]]:
    """Return a row for each number of workers: hours, and what stops more.

    Parameters
    ----------
    stacks : int
    seconds : float
        Of a stack at a worker.
    read, written : float
        Bytes of a stack.
    driver : float
        Seconds for each task.
    disk : float
        Bytes per second that the file system gives to all.
    """
    rows = []
    for workers in (1, 10, 100, 1000, 10000):
        # Twenty times as many tasks as workers show the slope, and the rest of a large batch is like them.
        some = min(stacks, 20 * workers)
        lengths = np.random.default_rng(1).normal(seconds, seconds / 5, some).clip(seconds / 3)
        rate = some / simulate(lengths, workers, ahead=workers, driver=driver)
        fastest = disk / (read + written)
        hours = stacks / min(rate, fastest) / 3600
        stops = "the file system" if fastest < rate else "the driver" if rate < 0.7 * workers / seconds else ""
        traffic = min(rate, fastest) * (read + written) / 1e9
        rows.append([f"{workers}", f"{hours:,.1f}", f"{min(rate, fastest):.2f}", f"{traffic:.2f}", stops])
    return rows


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--tasks", type=click.IntRange(min=20), default=200, show_default=True, help="Of the real runs.")
@click.option("--size", type=click.IntRange(min=8), default=192, show_default=True, help="Of their stacks.")
@click.option("--seconds", type=float, default=SECONDS, show_default=True, help="Of a large stack at a worker.")
@click.option("--disk", type=float, default=5e9, show_default=True, help="Bytes per second of the shared file system.")
@click.option("--markdown", type=click.Path(path_type=Path), help="Page whose block is renewed.")
def main(tasks: int, size: int, seconds: float, disk: float, markdown: Path | None) -> None:
    """Measure, simulate, compare."""
    os.environ["POCL_MAX_PTHREAD_COUNT"] = "1"  # one core each, so that two workers are twice one
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        driver = measure_driver(folder / "driver", 500)
        checks = check(folder, tasks, size, driver, [("local", 1), ("local", 2), ("dask", 1), ("dask", 2)])
        # Other programs on the machine can only add to it.
        single = min(measure_single("dask", 1, 100) for _ in range(2))
    block = "\n".join([*_measured(checks, driver, tasks), *_scaled(single, driver, seconds, disk)])
    click.echo(block)
    if markdown is not None:
        replace_block(markdown, block, BEGIN, END)


def _measured(checks: Sequence[Check], driver: float, tasks: int) -> list[str]:
    rows = [
        [
            *(each.engine, str(each.workers), f"{each.start:.1f}", f"{1e3 * max(driver, each.cost.task):.1f}"),
            *(f"{each.run.seconds:.1f}", f"{each.simulated:.1f}", f"{each.foretold:.1f}"),
            f"{each.net / each.alone.seconds:.2f}",
            f"{each.run.cpu:.1f}",
        ]
        for each in checks
    ]
    load = os.getloadavg()[0]
    pairs = [(one, two) for one in checks for two in checks if one.engine == two.engine and one.workers < two.workers]
    return [
        f"- command: python -m benchmarks.schedule, {tasks} stacks",
        f"- driver: {1e3 * driver:.1f} ms a task, its journal flushed each time",
        f"- one process: {checks[0].alone.seconds:.1f} s, {checks[0].alone.cpu:.1f} s of a processor",
        *(f"- two workers beside one, net of the start: {one.engine} {one.net / two.net:.2f}" for one, two in pairs),
        f"- load: {load:.1f} processes in the minute before its end, on {usable_cores()} processors",
        "",
        markdown_table(_HEADERS, rows),
        "",
    ]


_HEADERS = [
    *("engine", "workers", "start s", "ms a task", "real s", "simulated s", "from pilots s", "of one process"),
    "CPU s",
]


def _scaled(single: float, driver: float, seconds: float, disk: float) -> list[str]:
    slowest = max(driver, single)
    lines = []
    for title, count in (("100 000 stacks", 100_000), ("10¹² pixels", round(1e12 / 24e6))):
        total = count * (READ + WRITTEN) / 1e12
        rows = scale_rows(count, seconds, READ, WRITTEN, slowest, disk)
        lines += [
            f"{title}: {count} tasks of {seconds:g} s, {total:.0f} TB, {1e3 * slowest:.1f} ms of the driver for each",
            "",
            markdown_table(["workers", "hours", "stacks/s", "GB/s", "what stops more"], rows),
            "",
        ]
    return lines[:-1]


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.schedule")
