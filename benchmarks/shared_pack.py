"""How much faster two workers of one core each pack one stack than one: ``python -m benchmarks.shared_pack``.

``--account`` packs once by two workers, and counts seconds of the processor instead of the clock's, which other
programs do not change: what the command does alone, what parts take one after another, and what they take of two
workers, each beginning the next part when it has ended one.
"""

from __future__ import annotations

import heapq
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click

from clrelight.batch.engine import Ended, Work, usable_cores
from clrelight.batch.local import LocalEngine
from clrelight.batch.single import run_single
from clrelight.cli.tables import print_table
from clrelight.device import open_device
from clrelight.jobs.report import Report

WORDS = ("--method", "spline", "--degree", "6", "--rate", "0.1", "--holdout", "5")
_ONE_CORE = ("POCL_MAX_PTHREAD_COUNT", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "PYTHON_CPU_COUNT")


def run_pack(stack: Path, out: Path, words: list[str]) -> float:
    """Return the seconds of a pack in processes of one core each."""
    command = [sys.executable, "-m", "clrelight", "pack", str(stack), str(out), *WORDS, *words, "--json"]
    since = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, **dict.fromkeys(_ONE_CORE, "1")})
    return time.perf_counter() - since


def start_seconds() -> float:
    """Return the seconds until a process of ours has a device."""
    code = "from clrelight.device import open_device; open_device()"
    since = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True)
    return time.perf_counter() - since


@dataclass
class Account:
    """Seconds of the processor, net of workers' starts: of the command alone, and of lots of parts done together."""

    start: float
    alone: float = 0.0
    lots: list[tuple[str, list[float]]] = field(default_factory=list)

    def seconds(self, workers: int) -> float:
        """Return how long so many workers of a core each would take."""
        return self.alone + sum(_makespan(parts, workers) for _, parts in self.lots)


def _makespan(parts: list[float], workers: int) -> float:
    ends = [0.0] * workers
    for seconds in parts:
        heapq.heapreplace(ends, ends[0] + seconds)
    return max(ends)


class CountedEngine(LocalEngine):
    """Counts what each part takes."""

    def __init__(self, account: Account, lock: int) -> None:
        super().__init__(2, lock=lock)
        self._account = account
        self._began: dict[str, tuple[Any, float]] = {}
        self._taken: dict[int, float] = {}

    def submit(self, work: Work) -> None:
        """See `Engine`; a lot begins where nothing was being done."""
        if not self._busy:
            self._account.lots.append((work.name.partition("@")[2].rpartition("-")[0], []))
        super().submit(work)
        worker = self._busy[work.name]
        # What a process takes before its first part is what any takes that opens a device.
        self._began[work.name] = worker, self._taken.get(id(worker), self._account.start)

    def collect(self, seconds: float) -> list[Ended]:
        """See `Engine`."""
        ended = super().collect(seconds)
        for each in ended:
            worker, before = self._began.pop(each.name)
            self._taken[id(worker)] = cpu_seconds(worker)
            self._account.lots[-1][1].append(max(self._taken[id(worker)] - before, 0.0))
        return ended


def cpu_seconds(worker: Any) -> float:
    """Return what a worker's process has taken of the processor."""
    told = Path(f"/proc/{worker._process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(told[11]) + int(told[12])) / os.sysconf("SC_CLK_TCK")


def take_account(stack: Path, out: Path) -> Account:
    """Return the account of a pack by two workers."""
    os.environ |= dict.fromkeys(_ONE_CORE, "1")
    open_device()
    before = os.times().children_user + os.times().children_system
    start_seconds()
    account, since = Account(os.times().children_user + os.times().children_system - before), time.process_time()
    options = {"method": "spline", "degree": 6, "rate": 0.1, "holdout": 5}
    run_single("pack", stack, out, options=options, engine=lambda lock: CountedEngine(account, lock), report=Report())
    account.alone = time.process_time() - since
    return account


def print_account(account: Account) -> None:
    """Print what is done alone and what by parts, and how many times one worker two and four are."""
    kinds: dict[str, list[float]] = {}
    for kind, parts in account.lots:
        kinds.setdefault(kind, []).extend(parts)
    rows = [["the command alone", "", f"{account.alone:.2f}"]]
    rows += [[kind, str(len(parts)), f"{sum(parts):.2f}"] for kind, parts in kinds.items()]
    print_table(("seconds of the processor", "parts", "in all"), rows)
    one = account.seconds(1)
    for workers in (1, 2, 4):
        seconds = account.seconds(workers)
        click.echo(f"{workers} workers of one core: {seconds:.2f} s, {one / seconds:.2f} times one")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--stack", type=click.Path(exists=True, path_type=Path), required=True, help="A stack file.")
@click.option("--rounds", type=click.IntRange(min=1), default=3, show_default=True, help="Of which the best counts.")
@click.option("--account", is_flag=True, help="Pack once, and count seconds of the processor.")
def main(stack: Path, rounds: int, account: bool) -> None:
    """Pack alone, with one worker and with two; compare seconds, and the files."""
    if account:
        with tempfile.TemporaryDirectory(dir=stack.parent) as place:
            print_account(take_account(stack, Path(place, "two.h5")))
        return
    ways = (("one process", []), ("one worker", ["--jobs", "1"]), ("two workers", ["--jobs", "2"]))
    with tempfile.TemporaryDirectory(dir=stack.parent) as place:
        start = min(start_seconds() for _ in range(3))
        seconds = {}
        for number, (name, words) in enumerate(ways):
            out = Path(place, f"{number}.h5")
            # Workers start while the command plans: what they take longer counts.
            seconds[name] = min(run_pack(stack, out, words) for _ in range(rounds)) - start
            if out.read_bytes() != Path(place, "0.h5").read_bytes():
                raise SystemExit(f"{name} gives another file than one process")
    rows = [
        [name, f"{each:.1f}", f"{seconds['one worker'] / each:.2f}", f"{each / seconds['one process']:.2f}"]
        for name, each in seconds.items()
    ]
    print_table(("way", "seconds net of start", "times one worker", "of one process"), rows)
    click.echo(f"load: {os.getloadavg()[0]:.1f} processes in the minute before, on {usable_cores()} processors")


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.shared_pack")
