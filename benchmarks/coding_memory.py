"""Print what encode and decode hold and take, in parts and in memory: ``python -m benchmarks.coding_memory``."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.commands import run_command
from clrelight.cli.options import ByteCount, Names, Numbers, whole_number
from clrelight.cli.tables import print_table
from clrelight.dataset import FitRecord
from clrelight.errors import InputError
from clrelight.jobs.fit import fit
from clrelight.jobs.memory import peak_memory
from clrelight.store import create_fit
from datasets_synth.ring import render_ring

_TILE, _LIGHTS = 128, 64
_ALL = "1000GiB"
"""A budget that holds every map whole."""
_CODECS = {
    "half": ["--codec", "half"],
    "s3tc": ["--codec", "s3tc"],
    "bc6h": ["--codec", "bc6h"],
    "uniform": ["--codec", "uniform"],
    "whitened-half": ["--codec", "half", "--basis", "whitened"],
    "principal-s3tc": ["--codec", "s3tc", "--basis", "klt"],
    "jpeg2000": ["--codec", "jpeg2000", "--rate", "1"],
    "wavelet": ["--codec", "wavelet", "--rate", "0.5"],
    "klt": ["--codec", "klt", "--step", "0.1"],
    "vq": ["--codec", "vq"],
    "cpca": ["--codec", "cpca", "--clusters", "4"],
}
_HEADERS = ("codec", "pixels", "map (MiB)", "encode (MiB)", "decode (MiB)", "encode / in memory", "decode / in memory")


def write_tiled_fit(path: Path, size: int, degree: int) -> None:
    """Write a fit of a small rendering, tiled to a large view."""
    small = fit(render_ring(size=_TILE, lights=_LIGHTS), "cls", degree)
    wide_khwc = np.tile(small.coeffs_khwc, (1, 1, -(-size // _TILE), 1))[:, :, :size]
    with create_fit(path, replace(FitRecord.of(small), name="tiled"), (size, size, 3)) as sink:
        for first in range(0, size, _TILE):
            rows_khwc = np.ascontiguousarray(wide_khwc[:, : min(_TILE, size - first)])
            sink.write_rows(first, rows_khwc, None, None)


def run_child(words: list[str]) -> dict[str, Any]:
    """Run one command in a process of its own; return its seconds and the most memory that was resident."""
    command = [sys.executable, "-m", "benchmarks.coding_memory", "--child", json.dumps(words), "."]
    found: dict[str, Any] = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)
    return found


def measure(fitted: Path, codec: str, memory: int, rounds: int) -> dict[str, list[dict[str, Any]]]:
    """Return what encoding and decoding took within the budget, and in turns with it in memory."""
    folder, taken = fitted.parent, {"encode": [], "decode": [], "encode whole": [], "decode whole": []}
    for _ in range(rounds):
        for suffix, budget in (("", str(memory)), (" whole", _ALL)):
            # The default budget is no wish that a codec could refuse.
            limit = [] if not suffix and memory == 256 << 20 else ["--memory", budget]
            coded, decoded = str(folder / "coded.h5"), str(folder / "decoded.h5")
            taken["encode" + suffix].append(run_child(["encode", str(fitted), coded, *_CODECS[codec], *limit]))
            taken["decode" + suffix].append(run_child(["decode", coded, decoded, *limit]))
            for path in (coded, decoded):
                Path(path).unlink()
    return taken


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--sizes", type=Numbers(int, "512,2048"), default="512,2048", show_default=True, help="Sides of views.")
@click.option("--codecs", type=Names(), default=",".join(_CODECS), show_default=True)
@click.option("--degree", type=whole_number(0), default=6, show_default=True)
@click.option("--memory", type=ByteCount(), default="256MiB", show_default=True)
@click.option("--rounds", type=whole_number(1), default=1, show_default=True)
@click.option("--child", hidden=True)
def main(
    folder: Path, sizes: tuple[int, ...], codecs: tuple[str, ...], degree: int, memory: int, rounds: int, child: str
) -> None:
    """Encode and decode fits of a tiled rendering in FOLDER, by codec: resident memory, and time over that in memory.

    Each command has a process of its own, and the kernels of an earlier one. Times are processor time.

    \b
    Example:
      python -m benchmarks.coding_memory scratch --sizes 512,2048 --rounds 3
    """
    if child:
        since = time.process_time()
        run_command(json.loads(child))
        click.echo(json.dumps({"seconds": time.process_time() - since, "peak": peak_memory()}))
        return
    unknown = [name for name in codecs if name not in _CODECS]
    if unknown:
        raise InputError(f"unknown codec {unknown[0]}; known are {', '.join(_CODECS)}")
    folder.mkdir(exist_ok=True)
    tiny = folder / "tiny.h5"
    write_tiled_fit(tiny, _TILE, degree)
    for codec in codecs:  # builds kernels, which takes more memory than running them
        measure(tiny, codec, memory, 1)
    rows = []
    for size in sizes:
        fitted = folder / f"tiled{size}.h5"
        write_tiled_fit(fitted, size, degree)
        for codec in codecs:
            taken = measure(fitted, codec, memory, rounds)
            peaks = [max(run["peak"] for run in taken[verb]) for verb in ("encode", "decode")]
            ratios = [
                np.median(
                    [a["seconds"] / b["seconds"] for a, b in zip(taken[verb], taken[f"{verb} whole"], strict=True)]
                )
                for verb in ("encode", "decode")
            ]
            map_bytes = 4 * (degree + 1) ** 2 * size * size * 3
            rows.append(
                [
                    codec,
                    f"{size}²",
                    f"{map_bytes / 2**20:.0f}",
                    *(f"{peak / 2**20:.0f}" for peak in peaks),
                    *(f"{ratio:.2f}" for ratio in ratios),
                ]
            )
            click.echo(" ".join(rows[-1]), err=True)
    print_table(_HEADERS, rows)


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.coding_memory")
    except InputError as error:
        sys.exit(f"benchmarks.coding_memory: {error}")
