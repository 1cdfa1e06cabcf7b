"""What `auto` reaches in the gaps between lights, beside a grid: ``CLRELIGHT_DATA=... python -m benchmarks.auto_grid``.

The grid has all methods at degrees 0 to 25, and `spline` with both lambda; nobody could know its best beforehand. Auto
sees the fitted lights only. Tested is at lights that are half a typical gap's radius or more from all fitted ones.
Scenes: loewenkopf, fitted to n of its lights, evenly chosen; the ring; and domes of `benchmarks.auto_domes`.
A sample of the pixels is fitted, the same for all.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.auto_domes import SPLINES, list_scenes, make_stack, mean_psnr
from benchmarks.choice import tell_prediction, thin_folder
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


def main() -> None:
    """Print a row of a Markdown table for each scene and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", action="append", choices=SCENES, help="Default: all.")
    parser.add_argument("--count", action="append", type=int, help=f"Lights; default: {COUNTS}.")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    device = open_device(None)
    header = "scene", "lights", "`auto` took", "PSNR", "predicted", "best of the grid", "PSNR", "behind", "choosing, s"
    print("| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    for count in given.count or COUNTS:
        for name in given.scene or SCENES:
            compare(name, count, device)


if __name__ == "__main__":
    main()
