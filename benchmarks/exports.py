"""Export a fit of many megapixels in every format: ``python -m benchmarks.exports``."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.pages import check_markdown, replace_block
from benchmarks.photographs import _fractal
from clrelight.cli.options import whole_number
from clrelight.cli.tables import print_table
from clrelight.dataset import CoefficientMap
from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.sampling import make_pattern
from clrelight.speed.environment import describe_environment
from clrelight.speed.tables import markdown_table
from clrelight.store import write_fit

BEGIN, END = "<!-- exports -->", "<!-- /exports -->"
HEADERS = ["export", "seconds", "of processors", "MiB at most", "MB written"]
_SIDE = (1000, 1500)
"""Of the picture that is repeated, by what the megapixels ask for."""
_URL = ("--url", "https://example.org/view")
FORMATS = {
    "relight": ("view", "--format", "relight"),
    "relight, deepzoom": ("view", "--format", "relight", "--tiles", "deepzoom"),
    "relight, google": ("view", "--format", "relight", "--tiles", "google"),
    "relight, zoomify": ("view", "--format", "relight", "--tiles", "zoomify"),
    "relight, itarzoom, mycc": ("view", "--format", "relight", "--tiles", "itarzoom", "--colorspace", "mycc"),
    "relight, iiif": ("view", "--format", "relight", "--tiles", "iiif", *_URL),
    "deepzoom": ("view", "--format", "deepzoom"),
    "iiif": ("view", "--format", "iiif", *_URL),
    "ptm": ("view.ptm",),
    "ptm, quality 90": ("view.ptm", "--quality", "90"),
    "rti": ("view.rti",),
    "channels": ("view.exr",),
    "channels-half": ("view.exr", "--format", "channels-half"),
    "exr": ("view", "--format", "exr"),
    "exr-half": ("view", "--format", "exr-half"),
    "dds": ("view",),
    "dds, array": ("view.dds",),
    "ktx2": ("view.ktx2",),
}


def make_fit(repeats: int) -> CoefficientMap:
    """Return coefficients of degree 2 of a painted relief under the sRGB curve, with the noise of a sensor."""
    rng, (height, width) = np.random.default_rng(1), _SIDE
    paint = np.stack([0.45 + 0.12 * _fractal(rng, height, width) for _ in range(3)], axis=-1)
    paint *= 1.0 + 0.06 * rng.standard_normal((height, width, 1)).astype(np.float32)
    paint = np.clip(paint, 0.03, 1.2)
    coeffs = np.empty((9, height, width, 3), np.float32)
    for k in range(9):
        flat = {0: 2.0, 2: 0.9}.get(k, 0.0)
        coeffs[k] = 0.5 * paint * (flat + 0.4 * _fractal(rng, height, width))[..., None]
        coeffs[k] += 0.004 * rng.standard_normal((height, width, 3))
    tiled: NDArray[np.float32] = np.tile(coeffs, (1, repeats, repeats, 1))
    return CoefficientMap(tiled, 2, "spline", 1.0, "srgb", make_pattern("uniform", 60))


def write_made(fit: Path, megapixels: str) -> None:
    """Write a fit of so many megapixels."""
    write_fit(fit, make_fit(round((float(megapixels) / 1.5) ** 0.5)))


def measure(fit: Path, words: tuple[str, ...]) -> tuple[float, float, float, float]:
    """Return the seconds of a process that exports, those of its processors, its MiB at most, and the MB it writes."""
    with tempfile.TemporaryDirectory(dir=fit.parent) as folder:
        out = Path(folder) / words[0]
        command = [sys.executable, "-m", "clrelight", "export", str(fit), str(out), *words[1:], "--json"]
        since = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        if status:
            raise InputError(f"export {' '.join(words)} ended with {os.waitstatus_to_exitcode(status)}")
        seconds = time.perf_counter() - since
        size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
    return seconds, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, size / 1e6


def rows_of(fit: Path, names: list[str]) -> Iterator[list[str]]:
    """Yield the row of each format, as text."""
    for name in names:
        seconds, processors, memory, size = measure(fit, FORMATS[name])
        row = [f"`{name}`", f"{seconds:.0f}", f"{processors:.0f}", f"{memory:.0f}", f"{size:.0f}"]
        click.echo(" | ".join(row), err=True)
        yield row


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--megapixels", type=click.Choice(["1.5", "6", "24"]), default="24", show_default=True)
@click.option("--folder", type=click.Path(path_type=Path), help="Where the fit stays, for the next run.")
@click.option("--only", type=click.Choice(list(FORMATS)), multiple=True, help="Of these formats; may be repeated.")
@click.option("--times", type=whole_number(1, 20), default=1, show_default=True, help="Rounds; the fastest counts.")
@click.option("--markdown", type=click.Path(path_type=Path), help="Page whose table between two markers is replaced.")
def main(megapixels: str, folder: Path | None, only: tuple[str, ...], times: int, markdown: Path | None) -> None:
    """Export a fit of 27 planes in every format, and print what it took.

    \b
    Example:
      python -m benchmarks.exports --megapixels 24 --markdown docs/textures.md
    """
    place = Path(tempfile.mkdtemp(prefix="exports.")) if folder is None else folder
    if markdown is not None:
        check_markdown(markdown, BEGIN, END)
    try:
        fit = place / f"fit{megapixels}.h5"
        if not fit.exists():
            # In a process of its own: what this one held at most would count for those that it starts.
            making = multiprocessing.get_context("spawn").Process(target=write_made, args=(fit, megapixels))
            making.start()
            making.join()
        rounds = [list(rows_of(fit, list(only or FORMATS))) for _ in range(times)]
    finally:
        if folder is None:
            shutil.rmtree(place)
    rows = [min(same, key=lambda row: float(row[2])) for same in zip(*rounds, strict=True)]
    print_table(HEADERS, rows)
    if markdown is not None:
        command = f"python -m benchmarks.exports --megapixels {megapixels}"
        facts = {"command": command, **describe_environment(open_device())}
        lines = [f"- {name}: {value}" for name, value in facts.items()]
        replace_block(markdown, "\n".join([*lines, "", markdown_table(HEADERS, rows)]), BEGIN, END)


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.exports")
    except InputError as error:
        sys.exit(f"benchmarks.exports: {error}")
