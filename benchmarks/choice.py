"""What `auto` takes and reaches at unseen lights: ``CLRELIGHT_DATA=... python -m benchmarks.choice``.

Splits: loewenkopf fitted to n of its lights, evenly chosen, tested at the rest; SynthRTI, Dome fitted, Test tested;
RealRTI, every fifth light held out. A sample of the pixels is fitted, the same for all.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import collect_fit, prepare_fit
from clrelight.fit.samples import Samples
from clrelight.fit.selection import Choice
from clrelight.ingest import ingest_folder
from clrelight.metrics import measure_errors
from clrelight.store import open_stack

COUNTS = (4, 5, 6, 8, 9, 12, 16, 25, 36, 49, 96, 120, 192, 240)
COLUMNS = 20_000
SPLINES = (3e-4, 1e-3)


def thin_folder(folder: Path, scratch: Path) -> LightStack:
    """Return a sample of the pixels of a folder's images, in memory."""
    made = scratch / "stack.h5"
    made.unlink(missing_ok=True)
    ingest_folder(folder, made)
    with open_stack(made) as stack:
        return Samples(stack, COLUMNS).stack


def list_splits(data: Path, scratch: Path, only: str) -> Iterator[tuple[str, LightStack, LightStack]]:
    """Yield name, lights to fit, and lights to test."""
    stacks = data / "stacks"
    if only in ("", "lion"):
        lion = thin_folder(stacks / "loewenkopf", scratch)
        for count in COUNTS:
            kept = np.unique(np.round(np.linspace(0, lion.n_light - 1, min(count, lion.n_light))).astype(np.intp))
            rest = np.setdiff1d(np.arange(lion.n_light), kept)
            yield f"loewenkopf {count}", lion.select(kept), lion.select(rest if len(rest) else kept)
    if only in ("", "synth"):
        for dome in sorted(stacks.glob("synthrti/**/Dome")):
            name = str(dome.parent.relative_to(stacks / "synthrti"))
            yield name, thin_folder(dome, scratch), thin_folder(dome.parent / "Test", scratch)
    if only in ("", "real"):
        for folder in sorted(path.parent for path in stacks.glob("realrti/*/*.lp")):
            stack = thin_folder(folder, scratch)
            held = np.arange(stack.n_light) % 5 == 4
            yield folder.name, stack.select(np.flatnonzero(~held)), stack.select(np.flatnonzero(held))


def mean_psnr(fitted_to: LightStack, tested: LightStack, method: str, degree: int | str, **options: float) -> tuple:
    """Return the mean PSNR at the lights tested, the fit, and the seconds of its choice."""
    prepared = prepare_fit(fitted_to, method, degree, options=options)
    seconds = prepared.report.seconds.get("choose", 0.0)
    errors = measure_errors(collect_fit(prepared), tested)
    return float(np.mean(-10.0 * np.log10(np.maximum(errors, 1e-13)))), prepared, seconds


def tell_prediction(choice: Choice | None) -> str:
    """Return what a choice predicts, and how far it may be off."""
    if choice is None or choice.chosen.predicted is None:
        return "unknown"
    return f"{choice.chosen.predicted:.2f} ± {choice.spread:.2f}"


def main() -> None:
    """Print a row of a Markdown table for each split."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("lion", "synth", "real"), default="")
    parser.add_argument("--scratch", type=Path, default=Path("build"))
    given = parser.parse_args()
    given.scratch.mkdir(exist_ok=True)
    print(
        "| stack | lights | `auto` took | PSNR | predicted | for these | spline 15, λ 3e-4 | λ 1e-3 | choosing |\n"
        + "|---" * 9
        + "|"
    )
    for name, fitted_to, tested in list_splits(Path(os.environ["CLRELIGHT_DATA"]), given.scratch, given.only):
        try:
            reached, prepared, seconds = mean_psnr(fitted_to, tested, "auto", "auto")
        except InputError as error:
            print(f"| {name} | {error} |")
            continue
        splines = [f"{mean_psnr(fitted_to, tested, 'spline', 15, lam=lam)[0]:.2f}" for lam in SPLINES]
        there = prepare_fit(fitted_to, "auto", "auto", unseen_t3=tested.directions_i3)
        predicted = " | ".join(tell_prediction(made.choice) for made in (prepared, there))
        print(
            f"| {name} | {fitted_to.n_light} | {prepared.method.id} {prepared.degree} | {reached:.2f} | {predicted} | "
            f"{' | '.join(splines)} | {seconds:.1f} s |",
            flush=True,
        )


if __name__ == "__main__":
    main()
