"""Print how exact rotation and Monte Carlo projection are, and draw the skies: ``python -m benchmarks.lamps``.

Rotation of one RGB light beside pyshtools (extra ``peers``; left out with a note where it is not installed), of maps
beside NumPy's products with the same matrices.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.lighting import Run, Table, show_parts
from clrelight.cli.output import print_facts
from clrelight.device import Device, open_device
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.montecarlo import project_function
from clrelight.harmonics.rotation import rotation_blocks, rotation_blocks_zyz, rotation_matrix
from clrelight.lighting import layouts
from clrelight.lighting.lamps import cast_shadow
from clrelight.lighting.light import Light, apply_window
from clrelight.lighting.rotation import rotate_light, rotate_maps
from clrelight.lighting.sky import sky_light, sky_luminance
from clrelight.speed.environment import describe_environment
from clrelight.speed.timing import interleave

DEGREES = (2, 6, 15, 30)
SIZE = 128  # of the rotated maps
ANGLES = (20.0, 50.0, 110.0)
COUNTS = (100, 400, 1600, 6400, 25600, 102400)
SEEDS = 16
SUN = (30.0, 200.0)
SKIES = ("overcast", "partly-cloudy", "clear")
DRAWN_DEGREE = 6
PIXELS = 128


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--rounds", type=click.IntRange(min=1), default=7, show_default=True, help="Samples of each contender.")
@click.option("--device", metavar="NAME", help="Index, gpu, cpu, pocl or a part of a name.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the tables of a page.")
@click.option("--picture", type=click.Path(dir_okay=False), metavar="FILE.png", help="Draw the skies and the errors.")
def main(rounds: int, device: str | None, markdown: Path | None, picture: str | None) -> None:
    """Measure rotation and Monte Carlo projection, and print one table for each."""
    opened = open_device(device)
    errors_cs = monte_carlo_errors()
    parts = {"rotation": rotation_table(opened, rounds), "montecarlo": monte_carlo_table(errors_cs)}
    print_facts(describe_environment(opened))
    show_parts(parts, markdown)
    if picture is not None:
        draw(picture, errors_cs)


def rotation_table(device: Device, rounds: int) -> Table:
    """Measure errors of both ways, and times beside peers."""
    matrix = rotation_matrix("euler", ANGLES)
    rng = np.random.default_rng(0)
    rows = []
    for degree in DEGREES:
        blocks, others = rotation_blocks(matrix, degree), rotation_blocks_zyz(matrix, degree)
        orthogonal = max(float(np.abs(block @ block.T - np.eye(len(block))).max()) for block in blocks)
        apart = max(float(np.abs(a - b).max()) for a, b in zip(blocks, others, strict=True))
        single = rotate_maps(np.eye(coefficient_count(degree), dtype=np.float32), matrix, device=device).astype(float)
        loose = float(np.abs(single @ single.T - np.eye(len(single))).max())
        light = Light(rng.standard_normal((coefficient_count(degree), 3)))
        runs: dict[str, Run] = {"ours": lambda light=light: rotate_light(light, matrix), **_peer(light)}
        timings = interleave(runs, finish=device.finish, rounds=rounds)
        beside = f"{1.0 / timings.speed('ours', 'peer')[1]:.2f}" if "peer" in runs else "–"
        maps = rng.standard_normal((coefficient_count(degree), SIZE * SIZE * 3)).astype(np.float32)
        plain = [block.astype(np.float32) for block in blocks]
        timings_maps = interleave(
            {
                "ours": lambda maps=maps: rotate_maps(maps, matrix, device=device),
                "numpy": lambda maps=maps, plain=plain: _multiply(maps, plain),
            },
            finish=device.finish,
            rounds=rounds,
        )
        rows.append(
            [
                *(str(degree), f"{orthogonal:.1e}", f"{loose:.1e}", f"{apart:.1e}"),
                *(f"{1e3 * timings.time('ours')[1]:.2f}", beside),
                *(f"{1e3 * timings_maps.time('ours')[1]:.3g}", f"{1.0 / timings_maps.speed('ours', 'numpy')[1]:.2f}"),
            ]
        )
    headers = ["degree", "off orthogonal, float64", "maps, float32", "two ways apart", "one RGB light, ms"]
    return [*headers, "time beside pyshtools", f"maps of {SIZE}×{SIZE} RGB, ms", "time beside NumPy"], rows


def _multiply(maps_kp: NDArray[np.float32], blocks: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    return np.concatenate([block @ maps_kp[l * l : (l + 1) * (l + 1)] for l, block in enumerate(blocks)])


def _peer(light: Light) -> dict[str, Run]:
    try:
        from pyshtools.rotate import SHRotateRealCoef, djpi2
    except ImportError:
        click.echo("note: pyshtools is not installed, and is left out: pip install 'clrelight[peers]'", err=True)
        return {}
    degree = light.degree
    planes = np.random.default_rng(1).standard_normal((3, 2, degree + 1, degree + 1))
    quarter = djpi2(degree)
    return {"peer": lambda: [SHRotateRealCoef(plane, np.radians(ANGLES), quarter) for plane in planes]}


def monte_carlo_errors() -> NDArray[np.float64]:
    """Return the error of all coefficients up to degree 6 of a clear sky, as a part of their norm, (count, 2)."""
    exact_k = sky_light("clear", *SUN).coeffs_kc[:, 0]

    def error(count: int, stratified: bool) -> float:
        total = 0.0
        for seed in range(SEEDS):
            coeffs_k = project_function(
                lambda directions_i3: sky_luminance(directions_i3, "clear", *SUN),
                DRAWN_DEGREE,
                count,
                stratified=stratified,
                seed=seed,
            )[:, 0]
            total += float(np.sum((coeffs_k - exact_k) ** 2))
        return float(np.sqrt(total / SEEDS) / np.linalg.norm(exact_k))

    return np.array([[error(count, stratified) for stratified in (False, True)] for count in COUNTS])


def monte_carlo_table(errors_cs: NDArray[np.float64]) -> Table:
    """Return errors and their slopes."""
    rows = [
        [f"{count}", *(f"{error:.2%}" for error in errors)] for count, errors in zip(COUNTS, errors_cs, strict=True)
    ]
    slopes = np.polyfit(np.log(COUNTS), np.log(errors_cs), 1)[0]
    return ["samples", "independent", "stratified"], [*rows, ["error goes as N to the", *(f"{v:.2f}" for v in slopes)]]


def draw(path: str, errors_cs: NDArray[np.float64]) -> None:
    """Draw the skies as a fisheye sees them, their spherical harmonics, and the errors of Monte Carlo."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # The upper half of an angular map: the zenith in the centre, the horizon on the circle, y at the top.
    view_t3, _ = layouts.texel_geometry("angular", 2 * PIXELS, 2 * PIXELS)
    view_hw3 = view_t3.reshape(2 * PIXELS, 2 * PIXELS, 3)[PIXELS // 2 : -PIXELS // 2, PIXELS // 2 : -PIXELS // 2]
    up_t3 = view_hw3.reshape(-1, 3) @ layouts.parse_axes("left,up,forward")[1].T
    figure = Figure(figsize=(10.0, 5.4), dpi=90)
    FigureCanvasAgg(figure)
    for row, sky in enumerate(SKIES):
        light = sky_light(sky, *SUN)
        shadow = cast_shadow(light, (0.0, 0.8, 0.6), 35.0)
        true_t = sky_luminance(up_t3, sky, *SUN)
        panels = [(f"{sky}, sun at {SUN[0]:.0f}°", true_t)]
        for title, shown in (
            (f"degree {DRAWN_DEGREE}", light),
            ("Hann window", apply_window(light, "hann")),
            ("shadow of a ball", apply_window(shadow, "hann")),
        ):
            panels.append((title, evaluate_basis(up_t3, DRAWN_DEGREE) @ shown.coeffs_kc[:, 0]))
        # Not the peak beside the sun, which would leave the rest dark.
        white = float(np.percentile(true_t, 97))
        for column, (title, value_t) in enumerate(panels):
            axes = figure.add_axes((0.005 + 0.14 * column, 0.66 - 0.325 * row, 0.13, 0.28))
            shown_t = np.where(up_t3[:, 2] > 0, np.clip(value_t / white, 0, 1), 1.0) ** (1 / 2.2)
            axes.imshow(shown_t.reshape(PIXELS, PIXELS), cmap="gray", vmin=0, vmax=1)
            axes.set_title(title if row == 0 or column == 0 else "", fontsize=7, pad=2)
            axes.axis("off")
    axes = figure.add_axes((0.65, 0.12, 0.33, 0.76))
    for name, errors, marker in zip(("independent", "stratified"), errors_cs.T, "os", strict=True):
        axes.loglog(COUNTS, errors, marker=marker, label=name)
    axes.loglog(COUNTS, errors_cs[0, 0] * (COUNTS[0] / np.array(COUNTS)) ** 0.5, "k:", label="1 / √N")
    axes.set_xlabel("samples N")
    axes.set_title("Monte Carlo: error of the clear sky's coefficients", fontsize=8)
    axes.legend(fontsize=8)
    figure.savefig(path, metadata={"Software": None})


if __name__ == "__main__":
    main()
