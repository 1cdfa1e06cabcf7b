"""How fast reflection maps are made and turned, beside NumPy and ducc0: ``python -m benchmarks.reflection_speed``.

Each number of threads has a process of its own, held to as many cores, with as many threads of the device, of BLAS and
of ducc0. Times are the least of rounds that take all ways in turns: other programs of a busy machine only add to them.
With one thread they are the processor's, with more the clock's.
``--markdown docs/shrm.md`` renews the tables there.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.pages import replace_block
from clrelight.speed.tables import markdown_table

SIZE = (512, 1024)
"""Rows and columns of the light's map: 1024 × 512 RGB."""

ROTATED = ((13, 1, 27), (13, 36, 27), (10, 360, 3), (10, 360, 60), (30, 36, 300))
"""Degree, rotations and functions: the maps of an SHRM of F = 11, P = 2 in RGB turned once and round, one light in RGB
turned round, twenty probes, and a hundred probes of a higher degree."""

_RUNS, _MOST_ONE_BY_ONE = 4, 2000

CASES = ((0.1, None), (0.2, None), (0.3, None), (0.5, None), (0.2, (20, 5)), (0.1, (40, 5)))
"""Roughness of microfacets, and F and P where not those of epsilon 0.03."""


def least_milliseconds(works: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return each way's least time of rounds that take all in turns; in a process with one thread, of its processor.

    Time of the processor is what a quiet machine takes where nothing waits. In each round a way runs some times, of
    which the first warms caches.
    """
    clock = time.process_time if os.environ.get("OPENBLAS_NUM_THREADS") == "1" else time.perf_counter
    least = dict.fromkeys(works, float("inf"))
    for _ in range(rounds):
        for name, work in works.items():
            for turn in range(_RUNS):
                since = clock()
                work()
                if turn:
                    least[name] = min(least[name], 1e3 * (clock() - since))
    return least


def sunny_map() -> np.ndarray:
    """Return a made-up sky with a sun of 10^4 times its radiance, float32."""
    from clrelight.shrm.record import grid_directions

    directions_hw3 = grid_directions(*SIZE)
    rng = np.random.default_rng(0)
    sun_hw = directions_hw3 @ np.array([0.36, -0.48, 0.8]) > np.cos(np.radians(1.0))
    grain_hwc = rng.random((*SIZE, 3))
    return (grain_hwc + 1e4 * sun_hw[:, :, None]).astype(np.float32)


def prefilter_rows(threads: int, rounds: int) -> list[dict[str, Any]]:
    """Return times of whole reflection maps, from a lat-long map on."""
    from benchmarks.reflection_peers import DuccPipeline
    from clrelight.brdf.analytic import Microfacet
    from clrelight.brdf.coefficients import brdf_coefficients
    from clrelight.device import open_device
    from clrelight.harmonics.latlong import project_latlong
    from clrelight.lighting.light import Light
    from clrelight.lighting.projection_device import project_latlong_on_device
    from clrelight.shrm.orders import sufficient_coefficients
    from clrelight.shrm.prefilter import build_shrm

    device, map_hwc = open_device(None), sunny_map()
    double_hwc = map_hwc.astype(np.float64)
    single, double = np.dtype(np.float32), np.dtype(np.float64)
    rows = []
    for sigma, orders in CASES:
        lobe = Microfacet(sigma)
        brdf = brdf_coefficients(lobe, *orders) if orders else sufficient_coefficients(lobe, 0.03)
        height = 10 * brdf.degree
        peers = {real.name: DuccPipeline(brdf, *SIZE, height, 2 * height, real, threads) for real in (single, double)}
        planar = {real.name: DuccPipeline.planar(map_hwc, real) for real in (single, double)}
        for frame in ("local", "global"):

            def ours(method: str, dtype: np.dtype, frame: str = frame, brdf: Any = brdf, height: int = height) -> Any:
                if method == "device":
                    light = Light(project_latlong_on_device(map_hwc, brdf.degree, device))
                else:
                    light = Light(project_latlong(map_hwc if dtype == single else double_hwc, brdf.degree))
                made = build_shrm(light, brdf, height, frame=frame, method=method, dtype=dtype, device=device)
                return made.maps_khwc

            works: dict[str, Callable[[], Any]] = {
                "device": lambda: ours("device", single),
                "host32": lambda: ours("fft", single),
                "host64": lambda: ours("fft", double),
                "peer32": lambda: peers["float32"].run(planar["float32"], frame),  # noqa: B023
                "peer64": lambda: peers["float64"].run(planar["float64"], frame),  # noqa: B023
            }
            exact = works["host64"]()
            size = float(np.abs(exact).max())
            apart = {}
            for name, work in works.items():
                made = DuccPipeline.as_ours(work()) if name.startswith("peer") else work()
                apart[name] = float(np.abs(made - exact).max()) / size
            found = least_milliseconds(works, rounds)
            row = {"sigma": sigma, "degree": brdf.degree, "order": brdf.order, "rows": height, "frame": frame}
            rows.append(row | {"threads": threads, "ms": found, "apart": apart})
    return rows


def share_rows(threads: int, rounds: int) -> list[dict[str, Any]]:
    """Return the time of a whole reflection map beside that of projecting and reconstructing its light's map."""
    from clrelight.device import open_device
    from clrelight.jobs.reflection.bench import prefilter_works

    works = prefilter_works(sunny_map(), open_device(None))
    return [{"threads": threads, "ms": least_milliseconds(works, rounds)}]


def rotation_rows(threads: int, rounds: int) -> list[dict[str, Any]]:
    """Return times of turning many functions, once and for all, one by one, and by ducc0."""
    import ducc0

    from clrelight.harmonics.rotation import rotation_blocks, rotation_matrix
    from clrelight.harmonics.rotations import make_rotations

    rng = np.random.default_rng(0)
    rows = []
    for degree, turns, maps in ROTATED:
        matrices_n33 = np.stack([rotation_matrix("euler", (360.0 * i / turns, 40.0, 20.0)) for i in range(turns)])
        coeffs_kx = rng.standard_normal(((degree + 1) ** 2, maps))
        alm_xk = _to_alm(coeffs_kx, degree)
        rotations = make_rotations(matrices_n33, degree)
        angles = [np.radians((20.0, 40.0, 360.0 * i / turns)) for i in range(turns)]

        def one_by_one(matrices_n33: Any = matrices_n33, coeffs_kx: Any = coeffs_kx, degree: int = degree) -> Any:
            made = []
            for matrix in matrices_n33:
                for x in range(coeffs_kx.shape[1]):
                    blocks = rotation_blocks(matrix, degree)
                    made.append([block @ coeffs_kx[l * l : (l + 1) ** 2, x] for l, block in enumerate(blocks)])
            return made

        def by_ducc(together: bool, alm_xk: Any = alm_xk, angles: Any = angles, degree: int = degree) -> Any:
            parts = [alm_xk] if together else [alm_xk[x : x + 1] for x in range(len(alm_xk))]
            return [[ducc0.sht.rotate_alm(part, degree, *abc, nthreads=threads) for part in parts] for abc in angles]

        works: dict[str, Callable[[], Any]] = {
            "make": lambda: make_rotations(matrices_n33, degree),  # noqa: B023
            "apply": lambda: rotations.apply(coeffs_kx),  # noqa: B023
            "one": one_by_one,
            "ducc_one": lambda: by_ducc(False),
            "ducc": lambda: by_ducc(True),
        }
        if turns * maps > _MOST_ONE_BY_ONE:  # a minute or more
            del works["one"]
        exact_xk = _to_alm(rotations.apply(coeffs_kx)[-1], degree)
        apart = float(np.abs(works["ducc"]()[-1][0] - exact_xk).max() / np.abs(exact_xk).max())
        found = least_milliseconds(works, max(1, rounds // 5))
        rows.append({"degree": degree, "turns": turns, "maps": maps, "threads": threads, "ms": found, "apart": apart})
    return rows


def _to_alm(coeffs_kx: np.ndarray, degree: int) -> np.ndarray:
    """Return coefficients of complex harmonics with Condon and Shortley's sign as ducc0 has them, (function, k)."""
    from clrelight.harmonics.wigner import complex_coefficients

    return np.ascontiguousarray(
        np.concatenate([(-1) ** m * complex_coefficients(coeffs_kx, m) for m in range(degree + 1)]).T
    )


PARTS: dict[str, Callable[[int, int], list[dict[str, Any]]]] = {
    "prefilter": prefilter_rows,
    "share": share_rows,
    "rotation": rotation_rows,
}


def measure(part: str, threads: int, rounds: int) -> list[dict[str, Any]]:
    """Return the rows of a part, measured in a process of its own that has so many cores and threads."""
    count = str(threads)
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": count, "OMP_NUM_THREADS": count}
    environment |= {"POCL_MAX_PTHREAD_COUNT": count, "DUCC0_NUM_THREADS": count}
    command = [sys.executable, "-m", "benchmarks.reflection_speed", "--part", part]
    command += ["--threads", count, "--rounds", str(rounds), "--json"]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout)


def prefilter_table(rows: list[dict[str, Any]]) -> str:
    """Return the table of whole reflection maps."""
    headers = ["σ: F, P", "frame", "threads", "float32 on the device, ms", "float32 on the host", "float64"]
    headers += ["ducc0, float32", "ducc0, float64", "times as fast, float32", "float64", "apart"]
    lines = []
    for row in rows:
        ms = row["ms"]
        speeds = f"{ms['peer32'] / ms['device']:.1f}", f"{ms['peer64'] / ms['host64']:.1f}"
        lines.append(
            [f"{row['sigma']:g}: {row['degree']}, {row['order']}", row["frame"], str(row["threads"])]
            + [f"{ms[name]:.2f}" for name in ("device", "host32", "host64", "peer32", "peer64")]
            + [*speeds, f"{row['apart']['device']:.0e}, {row['apart']['peer64']:.0e}"]
        )
    return markdown_table(headers, lines)


def share_table(rows: list[dict[str, Any]]) -> str:
    """Return the table of a reflection map beside its light's own transforms."""
    headers = ["threads", "whole reflection map, ms", "with the reflectance's orders", "projection, reconstruction"]
    lines = []
    for row in rows:
        ms = row["ms"]
        values = [f"{ms[name]:.2f}" for name in ("whole", "with_reflectance", "transforms")]
        lines.append([str(row["threads"]), *values, f"{ms['whole'] / ms['transforms']:.2f}"])
    return markdown_table([*headers, "ratio"], lines)


def rotation_table(rows: list[dict[str, Any]]) -> str:
    """Return the table of turned functions."""
    headers = ["degree", "rotations × functions", "threads", "matrices, ms", "all functions", "one by one"]
    headers += ["ducc0, one by one", "ducc0, together", "times as fast as ducc0", "apart"]
    lines = []
    for row in rows:
        ms = row["ms"]
        speeds = f"{ms['ducc_one'] / ms['apply']:.0f}, {ms['ducc'] / ms['apply']:.1f}"
        lines.append(
            [str(row["degree"]), f"{row['turns']} × {row['maps']}", str(row["threads"])]
            + [f"{ms[name]:.3g}" if name in ms else "" for name in ("make", "apply", "one", "ducc_one", "ducc")]
            + [speeds, f"{row['apart']:.0e}"]
        )
    return markdown_table(headers, lines)


TABLES = {"prefilter": prefilter_table, "share": share_table, "rotation": rotation_table}


@click.command()
@click.option("--part", "parts", type=click.Choice(list(PARTS)), multiple=True, help="Default: all.")
@click.option("--threads", "counts", type=click.IntRange(min=1), multiple=True, default=(1, 2), show_default=True)
@click.option("--rounds", type=click.IntRange(min=1), default=8, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Measure one part in this process, and print its rows.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Page whose blocks are renewed.")
def main(parts: tuple[str, ...], counts: tuple[int, ...], rounds: int, as_json: bool, markdown: Path | None) -> None:
    """Measure reflection maps beside ducc0."""
    if as_json:
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: counts[0]])
        click.echo(json.dumps(PARTS[parts[0]](counts[0], rounds)))
        return
    for part in parts or tuple(PARTS):
        rows = [row for threads in counts for row in measure(part, threads, rounds)]
        table = TABLES[part](rows)
        click.echo(f"{part}\n{table}\n")
        if markdown is not None:
            replace_block(markdown, table, f"<!-- {part} -->", f"<!-- /{part} -->")


if __name__ == "__main__":
    main()
