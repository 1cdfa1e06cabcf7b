"""Print what a command costs before it works: ``python -m benchmarks.startup``.

``clrelight --help``, and the second ``clrelight fit`` of a 64 × 64 stack, whose kernels the first one has left in the
cache: seconds of the whole process, and the imports that take longest in it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click
import numpy as np

from clrelight.cli.output import print_facts
from clrelight.cli.tables import print_table
from clrelight.dataset import LightStack
from clrelight.sampling import make_pattern
from clrelight.speed.timing import quartiles
from clrelight.store import write_stack

SIZE, LIGHTS = 64, 64
HELP_GOAL, FIT_GOAL = 0.3, 1.5
_LISTED = 8


def run(*arguments: str) -> tuple[float, float]:
    """Return seconds of wall clock and of all processors that a command took."""
    start, before = time.perf_counter(), os.times()
    subprocess.run([sys.executable, "-m", "clrelight", *arguments], check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - start, os.times()
    return wall, after.children_user + after.children_system - before.children_user - before.children_system


def slow_imports(*arguments: str) -> list[list[str]]:
    """Return the packages whose own modules take longest to import in a command, with milliseconds."""
    words = [sys.executable, "-X", "importtime", "-m", "clrelight", *arguments]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    total: dict[str, float] = {}
    for line in done.stderr.splitlines():
        own, _, name = line.removeprefix("import time:").split("|") if line.count("|") == 2 else ("", "", "")
        if own.strip().isdigit():
            package = ".".join(name.strip().split(".")[:2])
            total[package] = total.get(package, 0.0) + int(own) / 1e3
    return [[name, f"{total[name]:.0f}"] for name in sorted(total, key=lambda name: -total[name])[:_LISTED]]


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--rounds", type=click.IntRange(min=1), default=10, show_default=True, help="Runs of each command.")
def main(rounds: int) -> None:
    """Time both commands, one after the other in turns."""
    with tempfile.TemporaryDirectory() as folder:
        stack, out = str(Path(folder) / "stack.h5"), str(Path(folder) / "fit.h5")
        images = np.random.default_rng(0).integers(0, 256, (LIGHTS, SIZE, SIZE, 3), np.uint8)
        write_stack(stack, LightStack(images, make_pattern("uniform", LIGHTS), 255.0))
        fit = ["fit", stack, out]
        commands = {"clrelight --help": (["--help"], HELP_GOAL), "second clrelight fit": (fit, FIT_GOAL)}
        run(*fit)
        samples: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
        for _ in range(rounds):
            for name, (words, _) in commands.items():
                samples[name].append(run(*words))
        rows = []
        for name, (_, goal) in commands.items():
            wall, processors = np.array(samples[name]).T
            low, middle, high = quartiles(wall)
            times = [f"{seconds:.3f}" for seconds in (wall.min(), low, middle, high, processors.min())]
            rows.append([name, *times, f"{goal:.1f} {'✓' if wall.min() < goal else '✗'}"])
        print_table(["command", "least s", "lower quartile", "median", "upper quartile", "least CPU s", "goal"], rows)
        click.echo()
        print_table(["imports of the fit", "ms"], slow_imports(*fit))
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    print_facts({"runs": rounds, "load": load})


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.startup")
