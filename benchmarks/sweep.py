"""Print how fast the projection is over sizes and sample types: ``python -m benchmarks.sweep``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass

import click
import numpy as np

from clrelight.cli.output import print_facts
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.device import Device, open_device
from clrelight.matmul import apply_operator, pack_operator
from clrelight.speed.environment import describe_environment
from clrelight.speed.peak import peak_run
from clrelight.speed.timing import interleave

CLIFF = 1 / 3
"""A point is marked where its share of the peak is below this part of its neighbours', the mean of one or two."""

_MORE_ROUNDS = 3
_MOST_BYTES = 1 << 27
"""Of samples; with many lights there are fewer columns."""


@dataclass(frozen=True)
class Point:
    """A projection of `columns` columns from `lights` samples of a type to `components` components."""

    components: int
    lights: int
    columns: int
    dtype: str


@dataclass(frozen=True)
class Scale:
    """The values that each axis takes while the others stay at `base`, and the samples of each point."""

    base: Point
    components: Sequence[int]
    lights: Sequence[int]
    columns: Sequence[int]
    dtypes: Sequence[str]
    rounds: int


FULL = Scale(
    Point(49, 256, 65536, "uint8"),
    components=(9, 16, 25, 36, 48, 49, 50, 64, 81, 100, 121, 144, 169, 196, 225, 256),
    lights=(12, 16, 24, 32, 48, 64, 65, 96, 128, 192, 255, 256, 257, 384, 512, 768, 1024, 1025, 2048, 4096),
    columns=(4096, 10000, 16384, 32767, 32768, 65535, 65536, 65537, 131072, 196608, 262144, 262147),
    dtypes=("uint8", "uint16", "float16", "float32"),
    rounds=5,
)
QUICK = Scale(Point(9, 12, 512, "uint8"), (4, 9), (12, 16), (512, 513), ("uint8", "float32"), rounds=1)


@dataclass(frozen=True)
class Measured:
    """A point's speed, its share of the multiply-add peak of the same rounds, and its error against float64."""

    point: Point
    gigaflops: float
    share: float
    error: float


def lines(scale: Scale) -> Iterator[list[Point]]:
    """Yield the points in lines along which one size changes: for each type over components, lights and columns."""
    base = scale.base
    for dtype in scale.dtypes:
        yield [Point(n, base.lights, base.columns, dtype) for n in scale.components]
        yield [Point(base.components, m, base.columns, dtype) for m in scale.lights]
        yield [Point(base.components, base.lights, p, dtype) for p in scale.columns]


def measure_point(device: Device, point: Point, rounds: int) -> Measured:
    """Time one projection in turns with the peak kernel."""
    rng = np.random.default_rng(0)
    columns = min(point.columns, _MOST_BYTES // (point.lights * np.dtype(point.dtype).itemsize))
    source = rng.integers(0, 256, (point.lights, columns), np.uint8).astype(point.dtype)
    operator = rng.standard_normal((point.components, point.lights)).astype(np.float32)
    packed, source_ip = pack_operator(device, operator), device.upload(source)
    out_mp = device.empty((point.components, columns), np.float32)
    peak, peak_flops = peak_run(device)
    timings = interleave(
        {"ours": lambda: apply_operator(device, packed, source_ip, out_mp), "peak": peak},
        finish=device.finish,
        rounds=rounds,
        settle_seconds=0.0,
    )
    flops = 2.0 * operator.size * columns
    some = np.linspace(0, columns - 1, min(columns, 257)).astype(np.intp)
    exact = operator.astype(np.float64) @ source[:, some].astype(np.float64)
    return Measured(
        Point(point.components, point.lights, columns, point.dtype),
        flops / timings.time("ours")[1] / 1e9,
        timings.speed("ours", "peak")[1] * flops / peak_flops,
        float(np.abs(device.download(out_mp)[:, some] - exact).max() / np.abs(exact).max()),
    )


def find_cliffs(shares: Sequence[float]) -> list[bool]:
    """Return which points of a line have less than `CLIFF` of the share of their neighbours."""
    found = []
    for index, share in enumerate(shares):
        beside = [shares[i] for i in (index - 1, index + 1) if 0 <= i < len(shares)]
        found.append(bool(beside) and share < CLIFF * sum(beside) / len(beside))
    return found


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--quick", is_flag=True, help="A few small points and one round: shows that it works, not how fast.")
@click.option("--rounds", type=click.IntRange(min=1), help=f"Samples of each point.  [default: {FULL.rounds}]")
@click.option("--dtype", "dtypes", multiple=True, type=click.Choice(FULL.dtypes), help="Only this type of samples.")
@click.option("--device", metavar="NAME", help="Index, gpu, cpu, pocl or a part of a name.")
def main(quick: bool, rounds: int | None, dtypes: tuple[str, ...], device: str | None) -> None:
    """Time the projection along each size, as a share of the multiply-add peak of the same rounds, and mark cliffs.

    \b
    Example:
      python -m benchmarks.sweep --dtype uint8
    """
    scale = QUICK if quick else FULL
    opened = open_device(device)
    rows: list[list[str]] = []
    cliffs = 0
    wanted = [line for line in lines(scale) if not dtypes or line[0].dtype in dtypes]
    total = sum(len(line) for line in wanted)
    with progress_bar("sweep") as progress:
        for line in wanted:
            measured = []
            for point in line:
                measured.append(measure_point(opened, point, rounds or scale.rounds))
                progress(len(rows) + len(measured), total, " × ".join(map(str, astuple(point)[:3])))
            for index, cliff in enumerate(find_cliffs([m.share for m in measured])):
                if cliff:  # on a busy machine most are chance: such points get a second trial
                    again = measure_point(opened, line[index], _MORE_ROUNDS * (rounds or scale.rounds))
                    measured[index] = max(measured[index], again, key=lambda one: one.share)
            for one, cliff in zip(measured, find_cliffs([m.share for m in measured]), strict=True):
                cliffs += cliff
                n, m, p, dtype = astuple(one.point)
                figures = f"{one.gigaflops:.1f}", f"{one.share:.0%}", f"{one.error:.1e}", "cliff" if cliff else ""
                rows.append([dtype, str(n), str(m), str(p), *figures])
    print_facts(describe_environment(opened))
    click.echo()
    print_table(("samples", "n", "lights", "columns", "GFLOP/s", "of peak", "error", ""), rows)
    click.echo(f"\n{cliffs} of {len(rows)} points below {CLIFF:.0%} of their neighbours")


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.sweep")
