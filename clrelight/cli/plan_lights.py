"""``clrelight plan-lights``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.options import Names, Numbers, device_option, json_option, whole_number
from clrelight.cli.output import print_facts, print_json, print_notes
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


_METHODS = ("uls", "cls", "spline")
_PROPOSED = 64
_MOST = 4096
_HEADERS = ("lights", "pattern", "condition", "image noise", "(dB)", "coefficient noise")


@dataclass(frozen=True)
class _Lights:
    """Given lights to choose from, or, where `directions_i3` is None, all that could be."""

    degree: int
    seed: int
    sphere: bool
    names: tuple[str, ...] = ()
    directions_i3: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()

    def take(self, pattern: str, count: int) -> tuple[list[str], NDArray[np.float64]]:
        """Return names and directions of `count` lights."""
        from clrelight.plan_lights import choose_lights, propose_lights

        if self.directions_i3 is None:
            towards_i3 = propose_lights(pattern, count, self.degree, below=self.sphere, seed=self.seed)
            return _numbered(count), towards_i3
        chosen = choose_lights(
            pattern, self.directions_i3, count, self.degree, sphere=self.sphere, seed=self.seed
        ).tolist()
        return [self.names[i] for i in chosen], self.directions_i3[chosen]

    def default_patterns(self) -> tuple[str, ...]:
        """Return the ways to take lights that are compared where none is named."""
        from clrelight.plan_lights import CHOICES

        return ("greedy", "farthest", "uniform") if self.directions_i3 is None else CHOICES

    def default_count(self) -> int:
        """Return how many lights are taken where no number is asked for."""
        return _PROPOSED if self.directions_i3 is None else len(self.directions_i3)

    def default_counts(self, count: int) -> tuple[int, ...]:
        """Return `count`, and others beside it: from the fewest that the degree can be fitted to."""
        from clrelight.harmonics.index import coefficient_count

        fewest = coefficient_count(self.degree)
        if self.directions_i3 is not None:
            n_light = len(self.directions_i3)
            return tuple(sorted({min(fewest, n_light), -(-n_light // 2), count, n_light}))
        return tuple(sorted({fewest, count, 3 * count // 2, 2 * count, 4 * count}))


@click.command(name="plan-lights")
@click.argument("files", metavar="[STACK.h5] [OUT.lp]", type=click.Path(), nargs=-1)
@click.option(
    "--degree", type=whole_number(0, 15), default=6, show_default=True, help="Largest SH degree to be fitted."
)
@click.option("--count", type=whole_number(1, _MOST), help=f"Lights to take; default {_PROPOSED}, of given lights all.")
@click.option("--counts", type=Numbers(int, "32,64,128"), help="Numbers of lights in the table.")
@click.option(
    "--pattern",
    "patterns",
    type=Names(),
    help="Proposals: greedy, farthest, uniform, grid, scattered; of given lights: greedy, farthest, every, random. "
    "OUT.lp gets the first.",
)
@click.option("--lights", type=click.Path(), metavar="FILE", help="Given lights: .lp, or a table N×3 or 3×N.")
@click.option("--below", is_flag=True, help="Lights below the horizon too: relight from the whole sphere.")
@click.option("--seed", type=whole_number(0), default=0, show_default=True, help="Of scattered and random.")
@click.option("--measure", "measured", is_flag=True, help="Fit choices of the stack's lights, and measure PSNR.")
@click.option("--methods", type=Names(), help=f"Fits to measure; default {','.join(_METHODS)}.")
@click.option(
    "--holdout", type=whole_number(2), metavar="K", help="Measure at every K-th light, which no fit sees; default 5."
)
@click.option("--force", is_flag=True, help="Replace OUT.lp where it is there.")
@device_option
@json_option
def plan_lights(
    files: tuple[str, ...],
    degree: int,
    count: int | None,
    counts: tuple[int, ...] | None,
    patterns: tuple[str, ...] | None,
    lights: str | None,
    below: bool,
    seed: int,
    measured: bool,
    methods: tuple[str, ...] | None,
    holdout: int | None,
    force: bool,
    device: str | None,
    as_json: bool,
) -> None:
    """Propose light directions for a degree, or say what given ones are worth.

    Image noise is the variance in relit images, in the mean over all lights, for a variance of 1 in the photographs,
    by unconstrained least squares; coefficient noise is that of the coefficients, added up.

    \b
    Example:
      clrelight plan-lights --degree 6 --count 64 dome.lp
      clrelight plan-lights --lights dome.lp --degree 6 --count 40 fewer.lp
      clrelight plan-lights stack.h5 --degree 6 --counts 64,128 --measure
    """
    from clrelight.light_files import write_lp

    stack, out = _stack_and_out(files)
    if too_many := [n for n in counts or () if not 1 <= n <= _MOST]:
        raise InputError(f"this proposes 1 to {_MOST} lights, got {too_many[0]}")
    if stack is not None and lights is not None:
        raise InputError(f"the lights come from {stack} or from {lights}: give one of them")
    facts: dict[str, Any] = {"degree": degree}
    if measured:
        if below:
            raise InputError("--below is for lights to propose or to assess; --measure takes the stack as it is")
        if stack is None or out is not None or count is not None:
            raise InputError(
                "--measure takes a stack with --counts, and writes no lights: leave out --count and OUT.lp"
            )
        names, notes = methods or _METHODS, tuple[str, ...]()
        rows = _measure(stack, degree, counts, patterns, names, holdout, seed, device)
    else:
        for name, value in (("methods", methods), ("holdout", holdout), ("device", device)):
            if value is not None:
                raise InputError(f"--{name} is an option of --measure")
        if out is not None:
            claim_output(out, [file for file in (stack, lights) if file is not None])
        source, names = _open_lights(stack, lights, degree, seed, below), ()
        taken, wanted = patterns or source.default_patterns(), count or source.default_count()
        rows = _assess(source, counts or source.default_counts(wanted), taken, {wanted, *(counts or ())})
        if out is not None:
            # A list of lights is an input as often as an output.
            if Path(out).exists() and not force:
                raise InputError(f"{out} is there: --lights {out} says what it is worth, --force replaces it")
            write_lp(out, *source.take(taken[0], wanted))
            facts.update({"file": out, "lights": wanted, "pattern": taken[0]})
        notes = (*source.notes, *_few(rows, degree))
    if as_json:
        print_json({**facts, "rows": rows, "notes": notes})
        return
    print_notes(notes)
    print_table([*_HEADERS, *(f"{name} (dB)" for name in names)], [_cells(row, names) for row in rows])
    if out is not None:
        print_facts({"lights": f"{out}, {facts['lights']} of {facts['pattern']}"})


def _few(rows: Sequence[dict[str, Any]], degree: int) -> list[str]:
    """Return what to say where no choice has as many lights as the degree has coefficients."""
    most = max((int(row["n_light"]) for row in rows), default=0)
    if not most or most >= (degree + 1) ** 2:
        return []
    largest = math.isqrt(most) - 1
    return [
        f"{most} lights are fewer than the {(degree + 1) ** 2} coefficients of degree {degree}, too few for least "
        f"squares: see --degree {largest}; other methods of fit take more coefficients than lights"
    ]


def _stack_and_out(files: Sequence[str]) -> tuple[str | None, str | None]:
    """Tell the stack from the file to write, which ends with .lp."""
    outs = [file for file in files if file.lower().endswith(".lp")]
    stacks = [file for file in files if file not in outs]
    for found, what in ((outs, ".lp file to write"), (stacks, "stack")):
        if len(found) > 1:
            raise InputError(f"expected at most one {what}, got {' and '.join(found)}")
    return stacks[0] if stacks else None, outs[0] if outs else None


def _open_lights(stack: str | None, lights: str | None, degree: int, seed: int, below: bool) -> _Lights:
    from clrelight.directions import horizon_note, unit_directions
    from clrelight.fit.plan import is_sphere
    from clrelight.light_files import read_light_file
    from clrelight.store import open_stack

    if stack is not None:
        with open_stack(stack) as source:
            directions_i3 = source.directions_i3
        names, notes = tuple(_numbered(len(directions_i3))), []
    elif lights is None:
        return _Lights(degree, seed, below)
    else:
        file = read_light_file(Path(lights))
        names = file.names or tuple(_numbered(len(file.directions_i3)))
        directions_i3 = unit_directions(file.directions_i3, file.label, below, "--below")
        notes = [*file.notes, *file.count_notes(), *horizon_note(file.directions_i3, file.label, below)]
    return _Lights(degree, seed, below or is_sphere(directions_i3), names, directions_i3, tuple(notes))


def _assess(source: _Lights, counts: Sequence[int], patterns: Sequence[str], asked: set[int]) -> list[dict[str, Any]]:
    from clrelight.plan_lights import assess_lights

    rows = []
    with progress_bar("choosing lights") as bar:
        for done, count in enumerate(counts):
            for pattern in patterns:
                try:
                    towards_i3 = source.take(pattern, count)[1]
                except InputError:
                    if count in asked:
                        raise
                    continue  # a number of lights that only the table is curious about may make no grid
                quality = assess_lights(towards_i3, source.degree, sphere=source.sphere)
                rows.append({"pattern": pattern, **quality.to_config()})
            bar(done + 1, len(counts))
    return rows


def _measure(
    stack: str,
    degree: int,
    counts: tuple[int, ...] | None,
    patterns: tuple[str, ...] | None,
    methods: tuple[str, ...],
    holdout: int | None,
    seed: int,
    device: str | None,
) -> list[dict[str, Any]]:
    from clrelight.device import open_device
    from clrelight.experiment.light_counts import HOLDOUT, measure_choices
    from clrelight.plan_lights import CHOICES
    from clrelight.store import open_stack

    with open_stack(stack) as source, progress_bar("fitting choices of lights") as bar:
        measured = measure_choices(
            source,
            counts,
            patterns or CHOICES,
            methods,
            degree,
            holdout=holdout or HOLDOUT,
            seed=seed,
            device=open_device(device),
            progress=bar,
        )
    return [{"pattern": each.choice, **each.quality.to_config(), "psnr_holdout": each.psnr} for each in measured]


def _cells(row: dict[str, Any], methods: Sequence[str]) -> list[str]:
    noise = row["image_noise"]
    return [
        str(row["n_light"]),
        row["pattern"],
        *(_short(row[name]) for name in ("condition", "image_noise")),
        "–" if math.isinf(noise) else f"{10 * math.log10(noise):.1f}",
        _short(row["coefficient_noise"]),
        *(_decibel(row["psnr_holdout"][name]) for name in methods),
    ]


def _short(value: float) -> str:
    return "∞" if math.isinf(value) else f"{value:.3g}"


def _decibel(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2f}"


def _numbered(count: int) -> list[str]:
    """Return names for photographs that are still to be taken, in the order of the lights."""
    return [f"light_{index:04d}.jpg" for index in range(count)]


COMMANDS = (plan_lights,)
