"""Whether `auto` is ever absurd: scenes and lights that nothing was tuned to, ``python -m benchmarks.strange_scenes``.

Twelve kinds, in 8 bits: brushed metal, hard cast shadows, velvet, glints, grain as of high ISO, values clipped at both
ends, exposures that drift, dead lights, directions that are wrong, and lights on one side, in a spiral, in two
clusters. Tested at lights in the gaps between those fitted, beside the best of the grid of `benchmarks.auto_domes`,
which nobody could know beforehand. What `auto` foretold is of photographs, so it is beside the PSNR at such: with
grain, with an exposure and a direction of their own, where those fitted have them.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.auto_domes import best_of_grid, make_stack, mean_psnr
from benchmarks.auto_grid import keep_gaps
from benchmarks.choice import tell_prediction
from clrelight.dataset import LightStack
from clrelight.device import open_device
from clrelight.fit import prepare_fit
from clrelight.sampling import make_pattern

COUNTS = (9, 16, 30, 60)
COLUMNS, TESTS = 600, 163
ABSURD, OFF = 1.0, 1.5
"""Decibels behind the best of the grid, and off what was foretold (twice that below 10 lights)."""
HEADERS = "scene", "lights", "`auto` took", "PSNR", "predicted", "as photographed", "best of the grid", "PSNR", "behind"

Array = NDArray[np.float64]


def draw_matt(rng: np.random.Generator, directions_t3: Array) -> Array:
    """Return Lambert's cosine on bumps, with a soft lobe around the mirrored view."""
    return 0.7 * _slant(_normals(rng), directions_t3) + 0.3 * _slant(_normals(rng), _half(directions_t3)) ** 20


def draw_brushed(rng: np.random.Generator, directions_t3: Array) -> Array:
    """Return lobes that are narrow along a tangent and wide across it (Ward 1992), each column's tangent its own."""
    normals_3p, half_t3 = _normals(rng, 0.15), _half(directions_t3)
    angle_p = rng.uniform(0.0, np.pi) + 0.3 * rng.standard_normal(COLUMNS)
    along_3p = np.stack([np.cos(angle_p), np.sin(angle_p), np.zeros(COLUMNS)])
    across_3p = np.cross(normals_3p, along_3p, axis=0)
    facing_tp = np.maximum(half_t3 @ normals_3p, 1e-3)
    off_tp = ((half_t3 @ along_3p) / 0.12) ** 2 + ((half_t3 @ across_3p) / 0.6) ** 2
    return 0.2 * _slant(normals_3p, directions_t3) + 0.8 * np.exp(-off_tp / facing_tp**2)


def draw_shadowed(rng: np.random.Generator, directions_t3: Array) -> Array:
    """Return matt values that fall to a tenth behind walls with a hard edge."""
    walls_3p = _normals(rng, 2.0)
    lit_tp = directions_t3 @ walls_3p > rng.uniform(-0.3, 0.6, COLUMNS)
    return draw_matt(rng, directions_t3) * np.where(lit_tp, 1.0, 0.1)


def draw_velvet(rng: np.random.Generator, directions_t3: Array) -> Array:
    """Return values that rise towards grazing light."""
    slant_tp = _slant(_normals(rng, 0.3), directions_t3)
    return np.where(slant_tp > 0.0, 0.1 + 0.9 * (1.0 - slant_tp) ** 3, 0.0)


def draw_glints(rng: np.random.Generator, directions_t3: Array) -> Array:
    """Return matt values, of which every tenth column mirrors the light."""
    mirror_tp = _slant(_normals(rng, 0.3), _half(directions_t3)) ** 400
    return 0.4 * _slant(_normals(rng, 0.2), directions_t3) + np.where(np.arange(COLUMNS) % 10 == 0, mirror_tp, 0.0)


def _half(directions_t3: Array) -> Array:
    half_t3 = directions_t3 + np.array([0.0, 0.0, 1.0])
    return np.asarray(half_t3 / np.linalg.norm(half_t3, axis=1, keepdims=True))


def _normals(rng: np.random.Generator, tilt: float = 0.5) -> Array:
    normals_3p = np.vstack([tilt * rng.standard_normal((2, COLUMNS)), np.ones((1, COLUMNS))])
    return np.asarray(normals_3p / np.linalg.norm(normals_3p, axis=0))


def _slant(normals_3p: Array, directions_t3: Array) -> Array:
    return np.maximum(directions_t3 @ normals_3p, 0.0)


def place_evenly(rng: np.random.Generator, count: int) -> Array:
    """Return the usual pattern, turned."""
    turn = rng.uniform(0.0, 2.0 * np.pi)
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.asarray(make_pattern("uniform", count) @ [[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def place_on_one_side(rng: np.random.Generator, count: int) -> Array:
    """Return an arc of 150 degrees of azimuth, 15 to 75 degrees above the horizon."""
    return _point(np.linspace(-1.3, 1.3, count), np.radians(45.0 + 30.0 * np.sin(2.4 * np.arange(count))))


def place_in_a_spiral(rng: np.random.Generator, count: int) -> Array:
    """Return two and a half turns from the horizon to the zenith, as a hand moves a lamp."""
    along = (np.arange(count) + rng.uniform(0.2, 0.8)) / count
    return _point(5.0 * np.pi * along, np.radians(10.0 + 75.0 * along))


def place_in_clusters(rng: np.random.Generator, count: int) -> Array:
    """Return lights that crowd around two directions, a tenth elsewhere."""
    middle_i3 = np.where(np.arange(count)[:, None] % 2 == 0, [[0.7, 0.0, 0.7]], [[-0.5, 0.6, 0.6]])
    spread_i1 = np.where(np.arange(count) % 10 == 9, 1.0, 0.18)[:, None]
    lights_i3 = middle_i3 + spread_i1 * rng.standard_normal((count, 3))
    lights_i3[:, 2] = np.abs(lights_i3[:, 2]) + 0.05
    return np.asarray(lights_i3 / np.linalg.norm(lights_i3, axis=1, keepdims=True))


def _point(azimuth_i: Array, elevation_i: Array) -> Array:
    flat_i = np.cos(elevation_i)
    return np.stack([flat_i * np.cos(azimuth_i), flat_i * np.sin(azimuth_i), np.sin(elevation_i)], axis=1)


def add_grain(rng: np.random.Generator, value_ip: Array) -> Array:
    """Return values with the noise of few photons."""
    return np.asarray(rng.poisson(120.0 * np.maximum(value_ip, 0.0)) / 120.0)


def clip_ends(rng: np.random.Generator, value_ip: Array) -> Array:
    """Return values of a harsh tone curve."""
    return np.asarray(1.8 * value_ip - 0.2)


def drift(rng: np.random.Generator, value_ip: Array) -> Array:
    """Return values whose exposure wanders by a quarter from light to light."""
    return np.asarray(value_ip * np.exp(0.25 * np.sin(0.9 * np.arange(len(value_ip)) + rng.uniform(0.0, 6.0)))[:, None])


def kill_lights(rng: np.random.Generator, value_ip: Array) -> Array:
    """Return values of lights of which one in twenty, at least one, did not burn."""
    dead = rng.choice(len(value_ip), max(1, len(value_ip) // 20), replace=False)
    return np.where(np.isin(np.arange(len(value_ip)), dead)[:, None], 0.0, value_ip)


def keep(rng: np.random.Generator, value_ip: Array) -> Array:
    """Return the values."""
    return value_ip


Draw, Place, Harm = (Callable[[np.random.Generator, Array], Array], Callable[[np.random.Generator, int], Array],
                     Callable[[np.random.Generator, Array], Array])  # fmt: skip
SCENES: dict[str, tuple[Draw, Place, Harm]] = {
    "brushed metal": (draw_brushed, place_evenly, keep),
    "hard cast shadows": (draw_shadowed, place_evenly, keep),
    "velvet": (draw_velvet, place_evenly, keep),
    "glints": (draw_glints, place_evenly, keep),
    "grain": (draw_matt, place_evenly, add_grain),
    "clipped at both ends": (draw_matt, place_evenly, clip_ends),
    "exposures drift": (draw_matt, place_evenly, drift),
    "dead lights": (draw_matt, place_evenly, kill_lights),
    "directions wrong by 3 degrees": (draw_matt, place_evenly, keep),
    "lights on one side": (draw_matt, place_on_one_side, keep),
    "a spiral": (draw_matt, place_in_a_spiral, keep),
    "two clusters": (draw_matt, place_in_clusters, keep),
}


def make_scene(name: str, count: int, seed: int = 0) -> tuple[LightStack, LightStack, LightStack]:
    """Return the lights to fit, those in the gaps between them as they are, and as they would be photographed."""
    rng = np.random.default_rng([seed, list(SCENES).index(name), count])
    draw, place, harm = SCENES[name]
    lights, tests = place(rng, count), make_pattern("uniform", TESTS)
    value_ip = draw(rng, np.concatenate([lights, tests]))
    value_ip = value_ip * rng.uniform(0.3, 1.0, COLUMNS)
    value_ip /= np.quantile(value_ip, 0.999)
    seen_ip, tested_ip = harm(rng, value_ip[:count]), value_ip[count:]
    photographed_ip = tested_ip if harm is kill_lights else harm(rng, tested_ip)
    if harm is clip_ends:
        tested_ip = photographed_ip
    told_of = tests
    if name.startswith("directions wrong"):
        lights, told_of = (_miss(rng, directions) for directions in (lights, tests))
    seen = make_stack(seen_ip, lights)
    photographed = make_stack(photographed_ip, told_of)
    return seen, keep_gaps(seen, make_stack(tested_ip, tests)), keep_gaps(seen, photographed)


def _miss(rng: np.random.Generator, directions_i3: Array) -> Array:
    missed_i3 = directions_i3 + np.radians(3.0) / np.sqrt(2.0) * rng.standard_normal(directions_i3.shape)
    missed_i3[:, 2] = np.abs(missed_i3[:, 2])
    return np.asarray(missed_i3 / np.linalg.norm(missed_i3, axis=1, keepdims=True))


def main() -> None:
    """Print a Markdown table, and how often `auto` was absurd."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", action="append", choices=SCENES, help="Default: all.")
    parser.add_argument("--count", action="append", type=int, help=f"Lights; default: {COUNTS}.")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    device, behind, off, limits = open_device(None), [], [], []
    print("| " + " | ".join(HEADERS) + " |\n" + "|---" * len(HEADERS) + "|")
    for name in given.scene or SCENES:
        for count in given.count or COUNTS:
            seen, tested, photographed = make_scene(name, count, given.seed)
            prepared = prepare_fit(seen, "auto", "auto", device=device)
            reached, there = mean_psnr(prepared, tested), mean_psnr(prepared, photographed)
            best, whose = best_of_grid(seen, tested, device)
            behind.append(best - reached)
            if prepared.choice is not None and prepared.choice.chosen.predicted is not None:
                off.append(abs(prepared.choice.chosen.predicted - there))
                limits.append(OFF if count >= 10 else 2.0 * OFF)
            took = f"{prepared.method.id} {prepared.degree}"
            figures = [f"{reached:.2f}", tell_prediction(prepared.choice), f"{there:.2f}", whose, f"{best:.2f}"]
            figures.append(f"{behind[-1]:+.2f}")
            print("| " + " | ".join([name, str(count), took, *figures]) + " |", flush=True)
    wrong = sum(one > limit for one, limit in zip(off, limits, strict=True))
    print(
        f"\n{len(behind)} rows: more than {ABSURD:g} dB behind on {sum(one > ABSURD for one in behind)}, "
        f"{max(behind):.2f} at most; of {len(off)} figures foretold {wrong} off by more than they may be"
    )


if __name__ == "__main__":
    main()
