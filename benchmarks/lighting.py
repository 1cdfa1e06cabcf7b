"""Print what lighting costs and how good it is: ``python -m benchmarks.lighting``.

Projection of a 1024×512 RGB map beside pyshtools and ducc0 (extra ``peers``; left out with a note where they are not
installed), irradiance from nine coefficients beside brute force, errors of the nine on real probes, and relighting
beside the sum of a stack's photographs. The last two need the folder of real data, ``CLRELIGHT_DATA``.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.pages import replace_block
from benchmarks.photograph_sum import gather_light, sum_photographs
from clrelight.cli.output import print_facts
from clrelight.cli.tables import print_table
from clrelight.dataset import LightStack
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.ingest import ingest_folder
from clrelight.jobs.fit import fit
from clrelight.lighting import layouts
from clrelight.lighting.environment import Environment, read_environment
from clrelight.lighting.irradiance import compare_irradiance, evaluate_irradiance, integrate_irradiance
from clrelight.lighting.projection import project_environment
from clrelight.lighting.relighting import relight_under
from clrelight.metrics import psnr_of
from clrelight.speed.environment import describe_environment
from clrelight.speed.tables import markdown_table
from clrelight.speed.timing import Timings, interleave
from clrelight.store import open_stack
from datasets_synth.ring import render_ring

HEIGHT, WIDTH = 512, 1024
DEGREES = (2, 30)
THREADS = 2
NORMALS = 64  # rows and columns of the irradiance map of irradiance-environment-maps, section 3.1
PROBES = ("grace_cross.hdr", "grace_latlong.exr", "beach_probe.hdr", "galileo_cross.dds")
FIT_DEGREES = (2, 4, 6, 8, 10, 12, 15, 20)
WANTED_DB = 40.0
PEER = "pyshtools SHExpandDH"

Table = tuple[list[str], list[list[str]]]
Run = Callable[[], object]


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--rounds", type=click.IntRange(min=1), default=9, show_default=True, help="Samples of each contender.")
@click.option("--data", type=click.Path(path_type=Path), envvar="CLRELIGHT_DATA", help="Folder of the real data.")
@click.option("--device", metavar="NAME", help="Index, gpu, cpu, pocl or a part of a name.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the tables of a page.")
def main(rounds: int, data: Path | None, device: str | None, markdown: Path | None) -> None:
    """Measure lighting, and print one table for each part."""
    opened = open_device(device)
    parts: dict[str, Table] = {"projection": projection_table(opened, rounds), "nine": nine_table(opened, rounds)}
    if data is None or not data.is_dir():
        click.echo("note: no real data (CLRELIGHT_DATA): errors on probes and relighting are left out", err=True)
    else:
        parts["errors"] = error_table(opened, data / "probes")
        parts["relighting"] = relighting_table(opened, data)
    facts = describe_environment(opened)
    print_facts(facts)
    show_parts(parts, markdown)


def show_parts(parts: Mapping[str, Table], markdown: Path | None) -> None:
    """Print tables, headers and rows by name, and put them between the markers of their names in a page if given."""
    for headers, rows in parts.values():
        click.echo()
        print_table(headers, rows)
    for name, (headers, rows) in parts.items() if markdown is not None else ():
        replace_block(markdown, markdown_table(headers, rows), f"<!-- {name} -->", f"<!-- /{name} -->")


def projection_table(device: Device, rounds: int) -> Table:
    """Time the projection of one map."""
    radiance_hwc = np.random.default_rng(0).random((HEIGHT, WIDTH, 3), np.float32) ** 4
    environment = Environment(radiance_hwc, "latlong")
    rows = []
    for degree in DEGREES:
        runs: dict[str, Run] = {
            "ours, separable": lambda degree=degree: project_environment(environment, degree, method="separable"),
            "ours, direct": lambda degree=degree: project_environment(environment, degree, method="direct"),
            **_peers(radiance_hwc, degree),
        }
        timings = interleave(runs, finish=device.finish, rounds=rounds)
        beside = PEER in runs
        for name in runs:
            rows.append([str(degree), name, _milliseconds(timings, name), _share(timings, name) if beside else "–"])
    return ["degree", "projection of 1024×512 RGB", "ms", "time beside pyshtools"], rows


def _peers(radiance_hwc: NDArray[np.float32], degree: int) -> dict[str, Run]:
    """Return the peers that are installed; their planes are ready in the type that each wants."""
    planes_chw = np.ascontiguousarray(radiance_hwc.transpose(2, 0, 1), dtype=np.float64)
    runs: dict[str, Run] = {}
    try:
        from pyshtools.expand import SHExpandDH

        runs[PEER] = lambda: [SHExpandDH(plane, sampling=2, lmax_calc=degree) for plane in planes_chw]
    except ImportError:
        click.echo("note: pyshtools is not installed, and is left out: pip install 'clrelight[peers]'", err=True)
    try:
        import ducc0

        runs["ducc0 analysis_2d"] = lambda: [
            ducc0.sht.analysis_2d(map=plane[None], spin=0, lmax=degree, geometry="F1", nthreads=THREADS)
            for plane in planes_chw
        ]
    except ImportError:
        click.echo("note: ducc0 is not installed, and is left out: pip install 'clrelight[peers]'", err=True)
    return runs


def nine_table(device: Device, rounds: int) -> Table:
    """Time an irradiance map of 64×64 normals, projection included, both ways."""
    environment = Environment(np.random.default_rng(0).random((HEIGHT, WIDTH, 3), np.float32), "latlong")
    normals_n3, _ = layouts.texel_geometry("angular", NORMALS, NORMALS)
    runs: dict[str, Run] = {
        "nine coefficients": lambda: evaluate_irradiance(project_environment(environment, 2), normals_n3),
        "brute force": lambda: integrate_irradiance(environment, normals_n3, device=device),
    }
    timings = interleave(runs, finish=device.finish, rounds=min(rounds, 5))
    speed = timings.speed("nine coefficients", "brute force")
    rows = [
        [
            "nine coefficients",
            _milliseconds(timings, "nine coefficients"),
            f"{speed[1]:.0f} ({speed[0]:.0f}–{speed[2]:.0f})",
        ],
        ["brute force", _milliseconds(timings, "brute force"), "1"],
    ]
    return ["irradiance at 64×64 normals of 1024×512 RGB", "ms", "times as fast"], rows


def error_table(device: Device, folder: Path) -> Table:
    """Compare nine coefficients with brute force on real probes."""
    normals_n3, weights_n = layouts.texel_geometry("latlong", NORMALS // 2, NORMALS)
    rows = []
    for file in PROBES:
        environment, _ = read_environment(folder / file)
        light = project_environment(environment, 2, device=device)
        exact_nc = integrate_irradiance(environment, normals_n3, device=device)
        error = compare_irradiance(evaluate_irradiance(light, normals_n3), exact_nc, weights_n, light)
        rows.append([file, f"{error.mean:.2%}", f"{error.maximum:.2%}"])
    return ["probe", "mean error of nine coefficients", "largest"], rows


def relighting_table(device: Device, data: Path) -> Table:
    """Compare relighting under Grace with the sum of the stacks' photographs, by degree of the fit and of the light."""
    environment, _ = read_environment(data / "probes" / "grace_cross.hdr")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "loewenkopf.h5"
        ingest_folder(data / "stacks" / "loewenkopf", path, transfer="srgb", name="loewenkopf")
        with open_stack(path) as photographs:
            for stack in (photographs, render_ring(size=64, lights=256)):
                rows += _relighting_rows(stack, environment, device)
    headers = ["stack", "light of degree", *map(str, FIT_DEGREES), f"{WANTED_DB:g} dB from degree"]
    return headers, rows


def _relighting_rows(stack: LightStack, environment: Environment, device: Device) -> list[list[str]]:
    wanted_hwc = sum_photographs(stack, gather_light(environment, stack.directions_i3))
    fits = {degree: fit(stack, "spline", degree=degree, device=device) for degree in FIT_DEGREES}
    rows = []
    for factor, name in ((1, "the fit's"), (2, "twice the fit's")):
        found = []
        for degree, fitted in fits.items():
            light = project_environment(environment, factor * degree, device=device)
            error_hwc = (relight_under(fitted, light, device=device) - wanted_hwc) / wanted_hwc.max()
            found.append(float(psnr_of(float(np.mean(error_hwc**2)))))
        enough = next((str(d) for d, psnr in zip(fits, found, strict=True) if psnr >= WANTED_DB), "–")
        rows.append([stack.name, name, *(f"{psnr:.1f}" for psnr in found), enough])
    return rows


def _share(timings: Timings, name: str) -> str:
    low, middle, high = timings.speed(PEER, name)  # our time over the peer's
    return f"{middle:.2f} ({low:.2f}–{high:.2f})"


def _milliseconds(timings: Timings, name: str) -> str:
    low, middle, high = (1e3 * seconds for seconds in timings.time(name))
    return f"{middle:.3g} ({low:.3g}–{high:.3g})"


if __name__ == "__main__":
    # Both peers read these when they are loaded.
    os.environ.setdefault("OMP_NUM_THREADS", str(THREADS))
    try:
        main(prog_name="python -m benchmarks.lighting")
    except InputError as error:
        sys.exit(f"benchmarks.lighting: {error}")
