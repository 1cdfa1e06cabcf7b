"""What `auto` reaches in the gaps between lights, beside a grid: ``CLRELIGHT_DATA=... python -m benchmarks.auto_grid``.

The grid has all methods at degrees 0 to 25, and `spline` with both lambda; nobody could know its best beforehand. Auto
sees the fitted lights only. Tested is at lights that are half a typical gap's radius or more from all fitted ones.
Scenes: loewenkopf, fitted to n of its lights, evenly chosen; the ring; and domes of `benchmarks.auto_domes`.
A sample of the pixels is fitted, the same for all. Rows take minutes each under many lights; what runs have printed
is summed up by ``python -m benchmarks.auto_grid --rows printed.txt --markdown docs/fitting.md``.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.auto_domes import SPLINES, list_scenes, make_stack, mean_psnr
from benchmarks.choice import tell_prediction, thin_folder
from benchmarks.pages import replace_block
from clrelight.dataset import LightStack
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.fit import PreparedFit, prepare_fit
from clrelight.fit.places import find_gap_radii, nearest_angles
from clrelight.fit.samples import Samples
from clrelight.fit.selection import DEGREES, METHODS
from clrelight.sampling import make_pattern
from datasets_synth.ring import render_ring

COUNTS = (4, 5, 6, 8, 9, 12, 16, 25, 36, 49, 96, 192, 240)
COLUMNS = 1500
TESTS = 163
IN_GAPS = 0.5
"""Of a typical gap's radius: tested lights are at least so far from all others."""
LION = "loewenkopf"

BEGIN, END = "<!-- auto grid -->", "<!-- /auto grid -->"
HEADERS = "scene", "lights", "`auto` took", "PSNR", "predicted", "best of the grid", "PSNR", "behind", "choosing, s"

Split = tuple[LightStack, LightStack]


@cache
def read_lion() -> LightStack:
    """Return a sample of its pixels."""
    with tempfile.TemporaryDirectory() as scratch:
        return thin_folder(Path(os.environ["CLRELIGHT_DATA"]) / "stacks" / LION, Path(scratch))


def split_lion(count: int) -> Split | None:
    """Return so many of its lights, evenly chosen, and the others; None where there are no others."""
    lion = Samples(read_lion(), COLUMNS).stack
    if count >= lion.n_light:
        return None
    kept = np.unique(np.round(np.linspace(0, lion.n_light - 1, count)).astype(np.intp))
    return lion.select(kept), lion.select(np.setdiff1d(np.arange(lion.n_light), kept))


@cache
def split_ring(count: int) -> Split:
    """Return the ring under a pattern of so many lights, and under that of the tests."""
    seen, tested = (Samples(render_ring(size=64, lights=lights), COLUMNS).stack for lights in (count, TESTS))
    return seen, tested


def split_dome(name: str, count: int, floats: bool = False) -> Split:
    """Return a dome of `benchmarks.auto_domes` under so many lights, and under those that test it."""
    lights, tests = make_pattern("uniform", count), make_pattern("uniform", TESTS)
    _, *values = next(scene for scene in list_scenes(lights, tests) if scene[0] == name)
    seen, tested = (
        LightStack(value.astype(np.float32).reshape(len(value), 1, -1, 3), directions, 1.0)
        if floats
        else make_stack(value, directions)
        for value, directions in zip(values, (lights, tests), strict=True)
    )
    return seen, tested


def _as_srgb(split: Split | None) -> Split | None:
    return None if split is None else (replace(split[0], transfer="srgb"), replace(split[1], transfer="srgb"))


SCENES: dict[str, Callable[[int], Split | None]] = {
    LION: split_lion,
    "loewenkopf, sRGB": lambda count: _as_srgb(split_lion(count)),
    "ring": split_ring,
    "ring, sRGB": lambda count: _as_srgb(split_ring(count)),
    "cubic": lambda count: split_dome("cubic", count),
    "cubic, floats": lambda count: split_dome("cubic", count, floats=True),
    "Lambert": lambda count: split_dome("Lambert", count),
    "gloss": lambda count: split_dome("gloss", count),
}


def keep_gaps(seen: LightStack, tested: LightStack) -> LightStack:
    """Return the tested lights that are in gaps between those seen; all where that is none."""
    gap = float(np.median(find_gap_radii(seen.directions_i3)))
    far = np.flatnonzero(nearest_angles(tested.directions_i3, seen.directions_i3) >= IN_GAPS * gap)
    return tested.select(far) if len(far) else tested


def list_grid(seen: LightStack, device: Device) -> Iterator[tuple[str, int, PreparedFit]]:
    """Yield name, degree and prepared fit of each cell that these lights allow."""
    spectrum = prepare_fit(seen, "spectrum", max(DEGREES), device=device).method
    cells = [(spectrum if method == "spectrum" else method, degree, {}) for method in METHODS for degree in DEGREES]
    cells += [("spline", degree, {"lam": lam}) for degree in DEGREES for lam in SPLINES]
    for method, degree, options in cells:
        try:
            prepared = prepare_fit(seen, method, degree, options=options, device=device)
        except InputError:  # fewer lights than coefficients
            continue
        yield prepared.method.id + "".join(f" λ {value:g}" for value in options.values()), degree, prepared


def compare(name: str, count: int, device: Device) -> None:
    """Print a scene's row of the table."""
    split = SCENES[name](count)
    if split is None:
        return
    seen, tested = split[0], keep_gaps(*split)
    prepared = prepare_fit(seen, "auto", "auto", device=device)
    reached = mean_psnr(prepared, tested)
    best, whose = max((mean_psnr(fit, tested), f"{method} {degree}") for method, degree, fit in list_grid(seen, device))
    took = f"{prepared.method.id} {prepared.degree}"
    seconds = prepared.report.seconds["choose"]
    row = [name, count, took, f"{reached:.2f}", tell_prediction(prepared.choice), whose, f"{best:.2f}"]
    print("| " + " | ".join(map(str, [*row, f"{best - reached:+.2f}", f"{seconds:.1f}"])) + " |", flush=True)


def read_rows(paths: Sequence[Path]) -> list[list[str]]:
    """Return the rows of tables that were printed; of a scene and a count the last."""
    found = {}
    for path in paths:
        for line in path.read_text(encoding="utf-8").splitlines():
            row = [cell.strip() for cell in line.strip("| ").split("|")]
            if len(row) == len(HEADERS) and row[1].isdigit():
                found[row[0], int(row[1])] = row
    return list(found.values())


def sum_up(rows: Sequence[Sequence[str]]) -> str:
    """Return two tables, by scene and by the number of lights: how far `auto` is behind the best, and what it foretold.

    A figure that was foretold is within bounds where it is off by no more than 1.5 dB, 3 dB with fewer than 10 lights.
    """
    by_scene = _table("scene", [name for name in SCENES if any(row[0] == name for row in rows)], 0, 1, rows)
    counts = sorted({int(row[1]) for row in rows})
    by_count = _table("lights", [str(count) for count in counts], 1, 0, rows)
    told = [(float(row[4].split()[0]) - float(row[3]), int(row[1])) for row in rows if row[4] != "unknown"]
    kept = sum(abs(off) <= (3.0 if count < 10 else 1.5) for off, count in told)
    return (
        f"{by_scene}\n\n{by_count}\n\n{len(rows)} rows; {len(told)} figures were foretold, {kept} of them within "
        "bounds; the others were said to be unknown."
    )


def _table(title: str, names: Sequence[str], column: int, other: int, rows: Sequence[Sequence[str]]) -> str:
    lines = [f"| {title} | rows | behind, median | worst | at | foretold |", "|---" * 6 + "|"]
    for name in names:
        some = [row for row in rows if row[column] == name]
        behind = [float(row[7]) for row in some]
        worst = some[int(np.argmax(behind))]
        at = f"{worst[other]} lights" if other == 1 else worst[other]
        told = sum(row[4] != "unknown" for row in some)
        lines.append(f"| {name} | {len(some)} | {np.median(behind):.2f} | {max(behind):.2f} | {at} | {told} |")
    return "\n".join(lines)


def main() -> None:
    """Print a row of a Markdown table for each scene and count, or sum up what was printed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", action="append", choices=SCENES, help="Default: all.")
    parser.add_argument("--count", action="append", type=int, help=f"Lights; default: {COUNTS}.")
    parser.add_argument("--rows", action="append", type=Path, help="Measure nothing: sum up what was printed here.")
    parser.add_argument("--markdown", type=Path, help=f"Fill what stands between {BEGIN} and {END} with the sum.")
    given = parser.parse_args()
    if given.rows:
        summed = sum_up(read_rows(given.rows))
        print(summed)
        if given.markdown is not None:
            replace_block(given.markdown, summed, BEGIN, END)
        return
    warnings.simplefilter("ignore")
    device = open_device(None)
    print("| " + " | ".join(HEADERS) + " |\n" + "|---" * len(HEADERS) + "|")
    for count in given.count or COUNTS:
        for name in given.scene or SCENES:
            compare(name, count, device)


if __name__ == "__main__":
    main()
