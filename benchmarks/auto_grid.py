"""Compare what ``--method auto --degree auto`` takes with every degree and method at held-out lights.

Usage: ``python -m benchmarks.auto_grid STACK.h5 ...`` prints one table for each stack. Auto sees the fitted lights
only, the grid is measured at the others: its best is what nobody could know beforehand.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import PreparedFit, collect_fit, prepare_fit
from clrelight.fit.selection import DEGREES, METHODS
from clrelight.holdout import split_chosen
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.store import open_stack

HOLDOUT = 5


def measure_held_out(prepared: PreparedFit, held: LightStack) -> float:
    return summarize_errors(measure_errors(collect_fit(prepared), held, device=prepared.device)).psnr_pooled


def measure_cell(seen: LightStack, held: LightStack, method: str, degree: int) -> float:
    try:
        return measure_held_out(prepare_fit(seen, method, degree), held)
    except InputError:  # fewer lights than coefficients
        return np.nan


def compare(stack: LightStack) -> None:
    fitted, held_out = split_chosen(stack.directions_i3, HOLDOUT)
    seen, held = stack.select(fitted), stack.select(held_out)
    start = time.perf_counter()
    prepared = prepare_fit(seen, "auto", "auto")
    seconds = time.perf_counter() - start
    automatic = measure_held_out(prepared, held)
    print(f"\n{stack.name}: {len(fitted)} lights fitted, pooled PSNR in dB at {len(held_out)} held out")
    print("degree " + "".join(f"{method:>8}" for method in METHODS))
    best = -np.inf
    for degree in DEGREES:
        row = [measure_cell(seen, held, method, degree) for method in METHODS]
        best = max(best, np.nanmax(row))
        print(f"{degree:>6} " + "".join("       –" if np.isnan(v) else f"{v:8.2f}" for v in row), flush=True)
    print(f"auto: {prepared.method.id} at degree {prepared.degree}, {automatic:.2f} dB, {best - automatic:.2f} below")
    print(f"the best of the grid; it took {seconds:.1f} s to choose", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stacks", nargs="+", metavar="STACK.h5")
    for path in parser.parse_args().stacks:
        with open_stack(path) as stack:
            compare(stack)


if __name__ == "__main__":
    main()
