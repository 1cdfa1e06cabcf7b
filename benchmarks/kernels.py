"""Print what share of a device's multiply-adds and memory bandwidth kernels reach: ``python -m benchmarks.kernels``."""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
import numpy as np

from clrelight.cli.output import print_facts
from clrelight.cli.tables import print_table
from clrelight.codec.formats.half import STRETCH, launch_conversion
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.fit.columns import launch_columns
from clrelight.matmul import apply_operator, pack_operator
from clrelight.metrics import sum_errors
from clrelight.opencl.arguments import DeviceArray
from clrelight.speed.environment import describe_environment
from clrelight.speed.peak import copy_values, device_copy_run, peak_run
from clrelight.speed.timing import interleave

LIGHTS, COMPONENTS = 256, 49


@dataclass(frozen=True)
class Work:
    """A kernel with its arrays on the device.

    Attributes
    ----------
    name : str
    run : callable
        Queues it once.
    moved_bytes : float
        The least that it must read and write.
    flops : float, optional
        Where multiply-adds are most of what it does.
    """

    name: str
    run: Callable[[], object]
    moved_bytes: float
    flops: float | None = None


@dataclass(frozen=True)
class Share:
    """Median rates of a kernel, and what part they are of the peaks measured in turns with it."""

    name: str
    milliseconds: float
    gigabytes_per_second: float
    bandwidth_share: float
    gigaflops: float | None
    multiply_add_share: float | None


def all_work(device: Device, columns: int) -> Iterator[Work]:
    """Yield every kernel, made when it is its turn, so that only one's arrays are held."""
    rng = np.random.default_rng(0)
    codes_ip = rng.integers(0, 255, (LIGHTS, columns), np.uint8, endpoint=True)
    for rows in (9, 25, COMPONENTS):
        yield _product(device, f"project uint8, n = {rows}", rows, codes_ip)
    for dtype in (np.float16, np.float32):
        yield _product(device, f"project {np.dtype(dtype)}, n = {COMPONENTS}", COMPONENTS, codes_ip.astype(dtype))
    coeffs_kp = rng.standard_normal((COMPONENTS, columns), np.float32)
    for lights in (1, 16, LIGHTS):
        yield _product(device, f"relight float32, {lights} light{'s' * (lights > 1)}", lights, coeffs_kp)
    yield _product(device, "relight float16, 1 light", 1, coeffs_kp.astype(np.float16))
    yield from _shrinking(device, coeffs_kp)
    yield from _halves(device, coeffs_kp.ravel())
    yield _errors(device, codes_ip)


def _product(device: Device, name: str, rows: int, source: np.ndarray) -> Work:
    inner, columns = source.shape
    operator = pack_operator(device, np.random.default_rng(1).standard_normal((rows, inner)))
    source_ip, out_mp = device.upload(source), device.empty((rows, columns), np.float32)
    return Work(
        name,
        lambda: apply_operator(device, operator, source_ip, out_mp),
        source.nbytes + 4.0 * rows * columns,
        2.0 * rows * source.size,
    )


def _shrinking(device: Device, components_rq: np.ndarray) -> Iterator[Work]:
    rank, columns = components_rq.shape
    given_rq, z_rq = device.upload(components_rq), device.empty(components_rq.shape, np.float32)
    flat_given, flat_z = (replace(array, shape=(components_rq.size,)) for array in (given_rq, z_rq))
    lambda_q, doubt_q = (device.empty((columns,), np.float32) for _ in range(2))
    rank_q = device.empty((columns,), np.int32)
    energy_q = device.upload(np.full(columns, 5.0, np.float32))
    singular_r = device.upload(np.geomspace(1.0, 1e-3, rank, dtype=np.float32))
    moved = 4.0 * components_rq.nbytes + 12.0 * columns

    def shrink(file: str, kernel: str, maps: tuple[object, ...], rest: tuple[int, ...], **defines: int) -> None:
        # They work in place, so each run needs its components again.
        copy_values(device, flat_z, flat_given)
        launch_columns(device, file, kernel, z_rq, *maps, energy_q, singular_r, *rest, rank, columns, defines=defines)

    for solver, steps in (("newton", 16), ("bisection", 32)):
        search = functools.partial(shrink, "fit/cls.cl", f"shrink_by_{solver}_rq", (lambda_q, doubt_q), (steps,))
        yield Work(f"copy and CLS {solver} {steps}", functools.partial(search, PAIRED=1, ONTO_BOUND=0), moved)
    yield Work("copy and CEB", lambda: shrink("fit/ceb.cl", "truncate_rq", (rank_q,), (), CROSSING=0), moved)


def _halves(device: Device, values_p: np.ndarray) -> Iterator[Work]:
    floats_p, halves_p = device.upload(values_p), device.upload(values_p.astype(np.float16))
    to_halves, to_floats = device.empty(values_p.shape, np.float16), device.empty(values_p.shape, np.float32)
    refused_j = device.empty((-(-values_p.size // STRETCH),), np.uint8)

    def convert(kernel: str, out_p: DeviceArray, source_p: DeviceArray) -> None:
        launch_conversion(device, kernel, out_p, refused_j, source_p, clamp=False)

    yield Work("encode half", lambda: convert("encode_half_p", to_halves, floats_p), 6.0 * values_p.size)
    yield Work("decode half", lambda: convert("decode_half_p", to_floats, halves_p), 6.0 * values_p.size)


def _errors(device: Device, codes_ip: np.ndarray) -> Work:
    lights = LIGHTS // 4
    source_ip = device.upload(codes_ip[:lights])
    relit_ip = device.upload(codes_ip[:lights] / np.float32(256.0))
    weight_p = device.upload(np.ones(codes_ip.shape[1], np.float32))
    return Work(
        "squared error uint8",
        lambda: sum_errors(device, relit_ip, source_ip, weight_p, 255.0),
        5.0 * lights * codes_ip.shape[1],
    )


def measure_share(work: Work, device: Device, rounds: int) -> Share:
    """Time a kernel in turns with the device's multiply-add peak and with a copy in its memory."""
    (multiply_add, peak_flops), (copy, copied) = peak_run(device), device_copy_run(device)
    runs = {"kernel": work.run, "multiply-add": multiply_add, "copy": copy}
    timings = interleave(runs, finish=device.finish, rounds=rounds, settle_seconds=0.0)
    seconds = timings.time("kernel")[1]
    bandwidth_share = timings.speed("kernel", "copy")[1] * work.moved_bytes / copied
    share = None if work.flops is None else timings.speed("kernel", "multiply-add")[1] * work.flops / peak_flops
    flops = None if work.flops is None else work.flops / seconds / 1e9
    return Share(work.name, 1e3 * seconds, work.moved_bytes / seconds / 1e9, bandwidth_share, flops, share)


def _cells(row: Share) -> list[str]:
    rate = "–" if row.gigaflops is None else f"{row.gigaflops:.0f} ({row.multiply_add_share:.0%})"
    return [row.name, f"{row.milliseconds:.3g}", f"{row.gigabytes_per_second:.1f} ({row.bandwidth_share:.0%})", rate]


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--device", metavar="NAME", help="Index, gpu, cpu, pocl or a part of a name.")
@click.option(
    "--columns", type=click.IntRange(min=16), help="Columns.  [default: 2**20 for a GPU's kernels, else 2**17]"
)
@click.option("--rounds", type=click.IntRange(min=1), default=9, show_default=True, help="Samples of each.")
@click.option("--only", metavar="TEXT", default="", help="Only kernels whose name holds TEXT.")
@click.option(
    "--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write the figures to a file."
)
def main(device: str | None, columns: int | None, rounds: int, only: str, json_file: Path | None) -> None:
    """Time kernels whose arrays are on the device already, in turns with its peaks.

    \b
    Example:
      python -m benchmarks.kernels --device gpu --json kernels.json
    """
    opened = open_device(device)
    # A multiple of what the CPU's kernels take at a time.
    columns = -(-(columns or (1 << 20 if opened.style == "gpu" else 1 << 17)) // 16) * 16
    facts = {**describe_environment(opened), "columns": str(columns)}
    chosen = (work for work in all_work(opened, columns) if only.lower() in work.name.lower())
    rows = [measure_share(work, opened, rounds) for work in chosen]
    if not rows:
        raise InputError(f"no kernel has {only!r} in its name")
    print_facts(facts)
    click.echo()
    print_table(["kernel", "ms", "GB/s (of a copy)", "GFLOP/s (of peak)"], [_cells(row) for row in rows])
    if json_file is not None:
        figures = {"environment": facts, "kernels": [asdict(row) for row in rows]}
        json_file.write_text(json.dumps(figures, indent=1), encoding="utf-8")


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.kernels")
    except InputError as error:
        sys.exit(f"benchmarks.kernels: {error}")
