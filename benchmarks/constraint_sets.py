"""Several constraints at once: compared with a solver of cone programmes in float64, and timed beside CLS.

    python -m benchmarks.constraint_sets --columns 1000 --markdown docs/fitting.md

Needs Clarabel (extra ``dev``), and the checkout's tests. Ends with exit code 1 where a limit is not kept.
"""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

import clrelight as cr
from benchmarks.pages import check_markdown, replace_block
from clrelight.dataset import LightStack
from clrelight.fit import collect_fit, prepare_fit
from clrelight.fit.value_bounds import bound_directions
from clrelight.harmonics.basis import evaluate_basis
from clrelight.reproduction.parts import table
from clrelight.threads import on_one_thread
from datasets_synth.ring import render_ring

BEGIN, END = "<!-- constraint sets -->", "<!-- /constraint sets -->"
DEGREE, LIGHTS = 6, 256
CERTAIN = 1e-9
"""The solver's answer counts where it meets the optimality conditions to this, in units of sqrt(E_c)."""
LIMITS = {"coefficients": 1e-6, "energy": 1e-5, "values": 1e-6, "time": 20.0}
SETS: dict[str, dict[str, Any]] = {
    "not negative, grid of 98": {"lower": 0.0, "at": "grid"},
    "not negative, horizon of 52": {"lower": 0.0, "at": "ring"},
    "0 to 0.9, grid of 98": {"lower": 0.0, "upper": 0.9, "at": "grid"},
}


@dataclass(frozen=True)
class Compared:
    """How far a fit is from the solver's: coefficients and image in units of sqrt(E_c), constraints in their own."""

    columns: int
    certain: int
    coefficients: float
    image: float
    energy: float
    values: float


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--only", type=click.Choice(["compare", "time"]), help="One of the two tables; default: both.")
@click.option(
    "--columns", type=int, default=1000, show_default=True, help="Pixels and channels to compare, of each set."
)
@click.option("--rounds", type=int, default=5, show_default=True, help="Interleaved rounds of timing.")
@click.option("--size", type=int, default=128, show_default=True, help="Side of the ring scene that is timed.")
@click.option("--markdown", type=click.Path(path_type=Path), metavar="FILE", help="Page whose block is replaced.")
def main(only: str | None, columns: int, rounds: int, size: int, markdown: Path | None) -> None:
    """Print the tables; exit code 1 where a limit is not kept."""
    if markdown is not None:
        check_markdown(markdown, BEGIN, END)
    made = [] if only == "time" else [_compared(columns)]
    if only != "compare":
        made.append(_timed(rounds, size))
    block = "\n\n".join(text for text, _ in made)
    click.echo(block)
    if markdown is not None:
        replace_block(markdown, block, BEGIN, END)
    sys.exit(0 if all(kept for _, kept in made) else 1)


def _compared(columns: int) -> tuple[str, bool]:
    lines, kept = [], True
    for name in SETS:
        for precision in ("double", "mixed"):
            found = compare(columns, name, precision)
            holds = all(getattr(found, each) <= LIMITS[each] for each in ("coefficients", "energy", "values"))
            kept &= holds
            shown = (found.coefficients, found.image, found.energy, found.values)
            cells = [name, precision, f"{found.certain} of {found.columns}", *(f"{value:.1e}" for value in shown)]
            lines.append([*cells, "yes" if holds else "no"])
    headers = [
        "constraints",
        "precision",
        "columns",
        "coefficients",
        "image",
        "energy above E_c",
        "bounds missed",
        "kept",
    ]
    return table(headers, lines), kept


def _timed(rounds: int, size: int) -> tuple[str, bool]:
    lines, kept = [], True
    for name, (wall, used, ratio) in timed(rounds, size).items():
        kept &= ratio <= LIMITS["time"]
        lines.append([name, f"{wall:.0f}", f"{used:.0f}", f"{ratio:.1f}"])
    return table(["fit", "ns a column", "of processors", "processors' time, times that of cls"], lines), kept


def compare(columns: int, name: str, precision: str) -> Compared:
    """Return how far the fit of so many columns of the ring is from the solver's answer."""
    options, stack = SETS[name], _ring_columns(columns)
    fitted = collect_fit(prepare_fit(stack, "constrained", DEGREE, options=options, precision=precision))
    coeffs_kp = fitted.coeffs_khwc.reshape(fitted.n_coeff, -1).astype(np.float64)
    samples_ip = stack.images_ihwc.reshape(stack.n_light, -1) / stack.peak
    energy_p = 4.0 * np.pi * np.mean(samples_ip**2, axis=0)
    exact_kp, certain_p, rows_jk, limit_j = _solve_exactly(columns, name)
    away_kp = ((exact_kp - coeffs_kp) / np.sqrt(energy_p))[:, certain_p]
    image = np.abs(evaluate_basis(stack.directions_i3, DEGREE) @ away_kp).max()
    over = float(np.max(np.sum(coeffs_kp**2, axis=0) / energy_p)) - 1.0
    missed = float((rows_jk @ coeffs_kp - limit_j[:, None]).max())
    apart = float(np.abs(away_kp).max())
    return Compared(len(energy_p), int(certain_p.sum()), apart, float(image), max(over, 0.0), max(missed, 0.0))


@functools.cache
def _solve_exactly(columns: int, name: str) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray, NDArray]:
    """Return the solver's coefficients, which of them are certain, and the constraints as ``rows c <= limit``."""
    from tests.reference.constrained import solve_column

    options, stack = SETS[name], _ring_columns(columns)
    samples_ip = stack.images_ihwc.reshape(stack.n_light, -1) / stack.peak
    energy_p = 4.0 * np.pi * np.mean(samples_ip**2, axis=0)
    at_j3 = bound_directions(options["at"], DEGREE, stack.directions_i3, sphere=False)
    rows_jk, limit_j = _signed(evaluate_basis(at_j3, DEGREE), options)
    basis_ik, weight_i = evaluate_basis(stack.directions_i3, DEGREE), np.ones(stack.n_light)
    with on_one_thread():
        solved = [
            solve_column(basis_ik, samples_ip[:, p], weight_i, energy_p[p], rows_jk, limit_j)
            for p in range(len(energy_p))
        ]
    certain_p = np.array([missed <= CERTAIN for _, missed in solved])
    return np.stack([c for c, _ in solved], axis=1), certain_p, rows_jk, limit_j


def _ring_columns(columns: int) -> LightStack:
    """Return a stack of one row of pixels from all over the ring scene that are not black."""
    stack = render_ring(size=96, lights=LIGHTS)
    samples_ipc = stack.images_ihwc.reshape(LIGHTS, -1, 3)
    bright = np.flatnonzero(samples_ipc.max(axis=0).min(axis=1) > 0)
    picked = bright[np.linspace(0, len(bright) - 1, -(-columns // 3)).astype(int)]
    images_ihwc = np.ascontiguousarray(samples_ipc[:, None, picked])
    return LightStack(images_ihwc, stack.directions_i3, stack.peak, stack.transfer)


def _signed(values_jk: NDArray[np.float64], options: Mapping[str, Any]) -> tuple[NDArray, NDArray]:
    rows, limits = [], []
    for sign, name in ((-1.0, "lower"), (1.0, "upper")):
        if name in options:
            rows.append(sign * values_jk)
            limits.append(np.full(len(values_jk), sign * options[name]))
    return np.vstack(rows), np.concatenate(limits)


def timed(rounds: int, size: int) -> dict[str, tuple[float, float, float]]:
    """Return ns a column of whole fits, on the clock and of processors, and the ratio of the latter to that of cls."""
    stack = render_ring(size=size, lights=LIGHTS)
    ways = {"cls": ("cls", {}), **{name: ("constrained", options) for name, options in SETS.items()}}
    best = {name: [np.inf, np.inf] for name in ways}
    for round_ in range(rounds + 1):  # the first builds the kernels
        for name, (method, options) in ways.items():
            prepared = prepare_fit(stack, method, DEGREE, options=options)
            since, used = time.perf_counter(), time.process_time()
            collect_fit(prepared)
            spent = time.perf_counter() - since, time.process_time() - used
            if round_:
                best[name] = [min(pair) for pair in zip(best[name], spent, strict=True)]
    columns = size * size * 3
    plain = best["cls"][1]
    return {name: (1e9 * a / columns, 1e9 * b / columns, b / plain) for name, (a, b) in best.items()}


if __name__ == "__main__":
    cr.open_device()
    main()
