"""Print what reading and writing add to a fit, and how it grows with the view: ``python -m benchmarks.streaming``."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.commands import run_command
from clrelight.cli.options import ByteCount, whole_number
from clrelight.cli.tables import print_table
from clrelight.errors import InputError
from clrelight.fit import fit_tiles, prepare_fit
from clrelight.jobs.memory import peak_memory
from clrelight.store import StoredArray, open_stack
from clrelight.tiles import Rectangle

_HEADERS = ("pixels", "compute (s)", "end to end (s)", "ratio", "CPU ratio", "ns per column", "peak (MiB)")


class Resident:
    """Images of which the first tiles are read, and then taken for all others: a fit of them only computes."""

    def __init__(self, stored: StoredArray) -> None:
        self.shape, self.dtype, self.chunks = stored.shape, stored.dtype, stored.chunks
        self._stored, self._filled = stored, 0

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray | None = None) -> None:
        """Fill each of the two buffers of a fit once."""
        if self._filled < 2:
            self._stored.read_into(tile, out, picked_n)
            self._filled += 1

    def __getitem__(self, key: Any) -> NDArray:
        return self._stored[key]


def measure(path: Path, out: Path, degree: int, memory: int, rounds: int, store: str) -> dict[str, float]:
    """Time fits of one stack, computing only and from file to file in turns; return medians."""
    fit_words = ["fit", str(path), str(out), "--degree", str(degree), "--memory", str(memory), "--no-measure"]
    fit_words += ["--store", store]
    peak, seconds = 0, np.empty((rounds + 1, 2, 2))
    with open_stack(path) as stack:
        columns = int(np.prod(stack.image_shape))
        for taken in seconds:
            out.unlink(missing_ok=True)  # to give a large file's room back takes a tenth of the time
            wall, cpu = time.perf_counter(), time.process_time()
            run_command(fit_words)
            taken[1] = time.perf_counter() - wall, time.process_time() - cpu
            peak = peak or peak_memory()
            prepared = prepare_fit(replace(stack, images_ihwc=Resident(stack.images_ihwc)), "cls", degree)
            wall, cpu = time.perf_counter(), time.process_time()
            with closing(fit_tiles(prepared, memory_bytes=memory, held=2)) as tiles:
                for _ in tiles:
                    pass
            taken[0] = time.perf_counter() - wall, time.process_time() - cpu
    ratio = np.median(seconds[1:, 1] / seconds[1:, 0], axis=0)
    compute, whole = np.median(seconds[1:, :, 0], axis=0)
    return {
        "columns": columns,
        "compute": compute,
        "whole": whole,
        "ratio": ratio[0],
        "cpu_ratio": ratio[1],
        "peak": peak,
    }


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("stacks", nargs=-1, required=True, type=click.Path(dir_okay=False, path_type=Path))
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="Fit file to write anew.")
@click.option("--degree", type=whole_number(0), default=6, show_default=True)
@click.option("--memory", type=ByteCount(), default="256MiB", show_default=True)
@click.option("--rounds", type=whole_number(1), default=3, show_default=True, help="Runs that count, after one more.")
@click.option("--store", default="float32", show_default=True, help="Type that coefficients are stored in, or float16.")
@click.option("--child", is_flag=True, hidden=True)
def main(stacks: tuple[Path, ...], out: Path, degree: int, memory: int, rounds: int, store: str, child: bool) -> None:
    """Fit stacks with cls: time from file to file over time of computing alone, and the most memory ever resident.

    Each stack has a process of its own. Make stacks by benchmarks.big_stack.

    \b
    Example:
      python -m benchmarks.streaming s512.h5 s4096.h5 --out fit.h5
    """
    if child:
        click.echo(json.dumps(measure(stacks[0], out, degree, memory, rounds, store)))
        return
    rows = []
    for path in stacks:
        words = ["--out", str(out), "--degree", str(degree), "--memory", str(memory), "--rounds", str(rounds)]
        words += ["--store", store]
        command = [sys.executable, "-m", "benchmarks.streaming", str(path), *words, "--child"]
        found = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)
        rows.append(
            [
                str(found["columns"] // 3),
                f"{found['compute']:.2f}",
                f"{found['whole']:.2f}",
                f"{found['ratio']:.2f}",
                f"{found['cpu_ratio']:.2f}",
                f"{1e9 * found['whole'] / found['columns']:.0f}",
                f"{found['peak'] / 2**20:.0f}",
            ]
        )
    print_table(_HEADERS, rows)


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.streaming")
    except InputError as error:
        sys.exit(f"benchmarks.streaming: {error}")
