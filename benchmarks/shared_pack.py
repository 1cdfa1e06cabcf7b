"""How much faster two workers of one core each pack one stack than one: ``python -m benchmarks.shared_pack``."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click

from clrelight.batch.engine import usable_cores
from clrelight.cli.tables import print_table

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


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--stack", type=click.Path(exists=True, path_type=Path), required=True, help="A stack file.")
@click.option("--rounds", type=click.IntRange(min=1), default=3, show_default=True, help="Of which the best counts.")
def main(stack: Path, rounds: int) -> None:
    """Pack alone, with one worker and with two; compare seconds, and the files."""
    ways = (("one process", []), ("one worker", ["--jobs", "1"]), ("two workers", ["--jobs", "2"]))
    with tempfile.TemporaryDirectory(dir=stack.parent) as place:
        start = min(start_seconds() for _ in range(3))
        seconds = {}
        for number, (name, words) in enumerate(ways):
            out = Path(place, f"{number}.h5")
            # A worker's start comes on top of that of the command.
            starts = start * (2 if words else 1)
            seconds[name] = min(run_pack(stack, out, words) for _ in range(rounds)) - starts
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
