"""Whether robust normals are ever worse than plain ones, ``python -m benchmarks.strange_normals``.

Stacks that nothing was tuned to.
Bumps of 48 x 48 pixels, matte with gloss, rendered here in 8 bits: few lights, lights on one side, strong colours,
samples clipped at the end of the range, parts that cast shadows, a lamp that did not burn, lamps whose intensity is off
by a fifth, noise. Errors are means over pixels in degrees, over `SEEDS` seeds.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

import clrelight as cr
from benchmarks.lighting import Table, show_parts
from benchmarks.normals import angles
from tests.reference.spheres import lamps

Array = NDArray[np.float64]
SEEDS, SIDE = 3, 48
METHODS = ("least-squares", "quick", "robust")
WORSE = 1.1
_UP = np.array([0.0, 0.0, 1.0])


def draw_normals(rng: np.random.Generator) -> Array:
    """Return unit normals of a sum of waves, (SIDE, SIDE, 3), steep to 50 degrees or so."""
    y_hw, x_hw = np.mgrid[:SIDE, :SIDE] / SIDE
    slope = np.zeros((SIDE, SIDE, 2))
    for _ in range(5):
        way, phase = rng.uniform(-9.0, 9.0, 2), rng.uniform(0.0, 6.3)
        slope += 0.32 * np.cos(way[0] * x_hw + way[1] * y_hw + phase)[..., None] * way / np.linalg.norm(way)
    normals = np.concatenate([slope, np.ones((SIDE, SIDE, 1))], axis=2)
    return np.asarray(normals / np.linalg.norm(normals, axis=2, keepdims=True))


def render(
    rng: np.random.Generator,
    normals_hw3: Array,
    lights_i3: Array,
    *,
    gloss: float = 0.3,
    rough: float = 0.25,
    shadows: float = 0.0,
    gains_i: Array | float = 1.0,
    colour_3: tuple[float, float, float] = (1.0, 1.0, 1.0),
    exposure: float = 0.7,
    noise: float = 0.003,
) -> NDArray[np.uint8]:
    """Return linear 8-bit photographs (n_light, SIDE, SIDE, 3): Lambert, a Gaussian lobe, parts in cast shadow."""
    albedo_hw = rng.uniform(0.4, 1.0, (SIDE // 8, SIDE // 8)).repeat(8, 0).repeat(8, 1)
    cosine_ihw = np.maximum(np.einsum("ia,hwa->ihw", lights_i3, normals_hw3), 0.0)
    half_i3 = lights_i3 + _UP
    half_i3 /= np.linalg.norm(half_i3, axis=1, keepdims=True)
    off_ihw = np.arccos(np.clip(np.einsum("ia,hwa->ihw", half_i3, normals_hw3), -1.0, 1.0))
    shine_ihw = gloss * np.exp(-((off_ihw / rough) ** 2)) * (cosine_ihw > 0.0)
    # What stands beside darkens lamps that are low and behind it, all along stripes of the surface.
    wall_hw = rng.uniform(0.0, 2.0 * np.pi, (SIDE // 6, SIDE // 6)).repeat(6, 0).repeat(6, 1)
    azimuth_i = np.arctan2(lights_i3[:, 1], lights_i3[:, 0])
    is_dark_ihw = np.cos(azimuth_i[:, None, None] - wall_hw) > 1.0 - 2.0 * shadows
    shown_ihw = np.where(is_dark_ihw & (lights_i3[:, 2] < 0.9)[:, None, None], 0.03, 1.0)
    matte_ihwc = (albedo_hw * cosine_ihw)[..., None] * np.asarray(colour_3)
    linear_ihwc = (matte_ihwc + shine_ihw[..., None]) * shown_ihw[..., None]
    linear_ihwc = exposure * linear_ihwc * np.broadcast_to(gains_i, len(lights_i3))[:, None, None, None]
    linear_ihwc = linear_ihwc + noise * rng.standard_normal(linear_ihwc.shape)
    return np.asarray(np.rint(255.0 * np.clip(linear_ihwc, 0.0, 1.0)), np.uint8)


def _half(count: int, seed: int) -> Array:
    lights_i3 = lamps(count, seed, 0.3)
    lights_i3[:, 0] = np.abs(lights_i3[:, 0])
    return lights_i3


def _dead(rng: np.random.Generator, count: int) -> Array:
    return np.asarray(np.where(np.arange(count) == rng.integers(count), 0.0, 1.0))


def _uneven(rng: np.random.Generator, count: int) -> Array:
    return np.asarray(1.0 + rng.choice([-0.2, 0.0, 0.2], count))


Stack = tuple[NDArray[np.uint8], Array]
KINDS: dict[str, tuple[int, Callable[[int, int], Array], dict]] = {
    "4 lights": (4, lamps, {}),
    "5 lights": (5, lamps, {}),
    "6 lights": (6, lamps, {}),
    "8 lights": (8, lamps, {}),
    "4 lights, matte": (4, lamps, {"gloss": 0.0}),
    "6 lights, matte, noise of 3%": (6, lamps, {"gloss": 0.0, "noise": 0.03}),
    "6 lights, cast shadows": (6, lamps, {"shadows": 0.3}),
    "8 lights, one dead": (8, lamps, {"gains": _dead}),
    "all in one half": (24, _half, {}),
    "all in one half, 8 lights": (8, _half, {}),
    "strong colour": (24, lamps, {"colour_3": (1.0, 0.08, 0.03)}),
    "clipped": (24, lamps, {"exposure": 1.6}),
    "clipped, 8 lights": (8, lamps, {"exposure": 1.6}),
    "cast shadows": (24, lamps, {"shadows": 0.4}),
    "one of 24 dead": (24, lamps, {"gains": _dead}),
    "gains off by a fifth": (24, lamps, {"gains": _uneven}),
    "gains off by a fifth, 8 lights": (8, lamps, {"gains": _uneven}),
    "noise of 5%": (24, lamps, {"noise": 0.05}),
    "dark: a tenth": (24, lamps, {"exposure": 0.07}),
    "matte": (24, lamps, {"gloss": 0.0}),
    "very rough gloss": (24, lamps, {"gloss": 0.6, "rough": 0.6}),
    "sharp gloss": (24, lamps, {"gloss": 3.0, "rough": 0.05}),
}


def table(kinds: dict[str, tuple[int, Callable[[int, int], Array], dict]]) -> Table:
    """Return mean errors of each method, in degrees, and that of robust by that of least squares."""
    rows = []
    for name, (count, place, how) in kinds.items():
        told = np.array([_errors(seed, count, place, dict(how)) for seed in range(SEEDS)])
        mean_m = told.mean(axis=0)
        ratio = mean_m[2] / mean_m[0]
        rows.append([name, *(f"{each:.2f}" for each in mean_m), f"{ratio:.2f}" + ("" if ratio <= WORSE else " *")])
        click.echo(" | ".join(rows[-1]), err=True)
    return ["stack", *(f"{each}, °" for each in METHODS), "robust / least squares"], rows


def _errors(seed: int, count: int, place: Callable[[int, int], Array], how: dict) -> list[float]:
    rng = np.random.default_rng([19, seed])
    normals_hw3, lights_i3 = draw_normals(rng), place(count, seed + 5)
    if "gains" in how:
        how["gains_i"] = how.pop("gains")(rng, count)
    codes_ihwc = render(rng, normals_hw3, lights_i3, **how)
    errors = []
    for method in METHODS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = cr.normals(cr.LightStack(codes_ihwc, lights_i3, 255.0, "linear"), method=method, report=cr.Report())
        errors.append(float(angles(found.normals_hw3, normals_hw3).mean()))
    return errors


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--only", multiple=True, help="Rows by their names; default: all.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the table of a page.")
def main(only: tuple[str, ...], markdown: Path | None) -> None:
    """Print errors of normals on strange stacks."""
    kinds = {name: each for name, each in KINDS.items() if not only or name in only}
    show_parts({"strange-normals": table(kinds)}, markdown)


if __name__ == "__main__":
    main()
