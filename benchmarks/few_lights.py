"""What is gained where few lights tell that a function ends at some degree: ``python -m benchmarks.few_lights``.

Scenes drawn at random (smooth, matt, glossy, translucent, with cast shadows), under 4 to 25 lights in patterns, at
random or in two rings, three of four in 8 bits, the others as floats. Each is fitted by `spectrum` as it is, and with
functions that never end, and tested under lights in the gaps between those fitted; more than 60 dB count as 60.
Printed are decibels by which the former is better: the mean, the worst and the best, for each kind of scene, and for
each way in which an end is found. With ``--stacks GLOB`` (CLRELIGHT_DATA) scenes are SynthRTI's and RealRTI's instead,
under a few of their lights that are far from each other.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.auto_grid import keep_gaps
from benchmarks.rti_stacks import find_stacks, read_case
from clrelight.dataset import LightStack
from clrelight.fit.left_out import LIMIT_LIGHTS
from clrelight.fit.places import pick_spread
from clrelight.fit.plan import make_lighting
from clrelight.fit.samples import Samples
from clrelight.fit.spectrum import SpectrumFit
from clrelight.fit.zonal import LARGEST_DEGREE
from clrelight.harmonics.basis import evaluate_basis
from clrelight.sampling import make_pattern

COUNTS = (4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 20, 25)
KINDS = (
    "degree 1", "degree 2", "degree 3", "degree 4", "power law", "matt", "nearly flat", "wrapped", "translucent",
    "glossy", "cast shadows",
)  # fmt: skip
COLUMNS, TESTS = 498, 120
STACK_COLUMNS, STACK_COUNTS = 1500, (7, 9, 12, 14, 16)
_SHARPNESS = 5, 8, 15, 30, 80
_LEAST = 1e-6
"""A smaller mean squared error counts as this."""


def draw_lights(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return directions in an even pattern, at random but apart, or in two rings; turned about the zenith."""
    pattern = rng.choice(["even", "random", "rings"])
    if pattern == "even":
        lights = make_pattern("uniform", count)
    elif pattern == "random":
        lights = _apart(rng, count)
    else:
        sizes, heights = (count - count // 2, count // 2), np.radians([rng.uniform(20, 35), rng.uniform(50, 75)])
        angles = [np.arange(size) * 2.0 * np.pi / size + 0.3 * ring for ring, size in enumerate(sizes)]
        lights = np.concatenate([_ring(angle, height) for angle, height in zip(angles, heights, strict=True)])
    turn = rng.uniform(0.0, 2.0 * np.pi)
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.asarray(lights @ [[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _apart(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    least = np.cos(0.9 / np.sqrt(count))
    while True:
        tried = rng.standard_normal((4 * count, 3))
        tried[:, 2] = np.abs(tried[:, 2]) + 0.1
        tried /= np.linalg.norm(tried, axis=1, keepdims=True)
        kept = [0]
        for light in range(1, len(tried)):
            if len(kept) < count and (tried[kept] @ tried[light]).max() < least:
                kept.append(light)
        if len(kept) == count:
            return np.asarray(tried[kept])


def _ring(angle: NDArray[np.float64], height: float) -> NDArray[np.float64]:
    flat = np.cos(height)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), np.full(len(angle), np.sin(height))], axis=1)


def draw_values(rng: np.random.Generator, kind: str, directions_t3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values of 0 to 1 of random columns of a kind, shape (n_direction, COLUMNS)."""
    if kind.startswith("degree"):
        return _draw_harmonics(rng, int(kind[-1]), rng.uniform(0.5, 2.5), directions_t3)
    if kind == "power law":
        return _draw_harmonics(rng, 20, rng.uniform(1.2, 3.5), directions_t3)
    albedo_p, tilt = rng.uniform(0.2, 1.0, COLUMNS), 0.1 if kind == "nearly flat" else rng.uniform(0.15, 1.0)
    normals_3p = _draw_normals(rng, tilt)
    slant_tp = directions_t3 @ normals_3p
    cosine_tp = np.maximum(slant_tp, 0.0)
    if kind == "nearly flat":
        value_tp = np.maximum(0.25 + 0.75 * slant_tp, 0.0)
    elif kind == "wrapped":
        wrap = rng.uniform(0.3, 1.0)
        value_tp = np.maximum((slant_tp + wrap) / (1.0 + wrap), 0.0) ** rng.choice([1, 2])
    elif kind == "translucent":
        others = [np.maximum(directions_t3 @ _draw_normals(rng, rng.uniform(0.3, 1.0)), 0.0) for _ in range(5)]
        value_tp = np.mean(others, axis=0)
    elif kind == "glossy":
        half_t3 = directions_t3 + np.array([0.0, 0.0, 1.0])
        half_t3 /= np.linalg.norm(half_t3, axis=1, keepdims=True)
        gloss = rng.uniform(0.2, 0.6)
        lobe_tp = np.maximum(half_t3 @ normals_3p, 0.0) ** rng.choice(_SHARPNESS) * (cosine_tp > 0.0)
        value_tp = (1.0 - gloss) * cosine_tp + gloss * lobe_tp
    elif kind == "cast shadows":
        value_tp = 0.05 + cosine_tp * _draw_horizon(rng, directions_t3)
    else:
        value_tp = cosine_tp
    value_tp = albedo_p * value_tp
    return np.asarray(value_tp / value_tp.max())


def _draw_harmonics(
    rng: np.random.Generator, degree: int, slope: float, directions_t3: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return functions of variances ``(l (l + 1) / 2)^-slope`` by degree; half the time mixtures of six materials."""
    l = np.repeat(np.arange(degree + 1.0), 2 * np.arange(degree + 1) + 1)
    deviation_k = np.where(
        l > 0, (np.maximum(l, 1.0) * (l + 1.0) / 2.0) ** (-slope / 2.0) / np.sqrt(2.0 * l + 1.0), 0.0
    )
    coeffs_kp = rng.standard_normal((len(l), COLUMNS))
    if rng.random() < 0.5:
        coeffs_kp = 0.2 * coeffs_kp + rng.standard_normal((len(l), 6)) @ rng.dirichlet(np.full(6, 0.5), COLUMNS).T
    value_tp = evaluate_basis(directions_t3, degree) @ (deviation_k[:, None] * coeffs_kp)
    return np.asarray((value_tp - value_tp.min()) / (value_tp.max() - value_tp.min()))


def _draw_normals(rng: np.random.Generator, tilt: float) -> NDArray[np.float64]:
    normals_3p = np.vstack([tilt * rng.standard_normal((2, COLUMNS)), np.ones((1, COLUMNS))])
    return np.asarray(normals_3p / np.linalg.norm(normals_3p, axis=0))


def _draw_horizon(rng: np.random.Generator, directions_t3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 where a light is above a column's horizon, 0 below, soft over some 3 degrees."""
    azimuth_t1 = np.arctan2(directions_t3[:, 1], directions_t3[:, 0])[:, None]
    bumps_4p = rng.standard_normal((4, COLUMNS)) * rng.uniform(0.1, 0.4)
    waves = np.cos(azimuth_t1), np.sin(azimuth_t1), np.cos(2.0 * azimuth_t1), np.sin(2.0 * azimuth_t1)
    horizon_tp = rng.uniform(0.0, 0.4, COLUMNS) + sum(w * b for w, b in zip(waves, bumps_4p, strict=True))
    return np.clip((np.arcsin(directions_t3[:, 2])[:, None] - horizon_tp) / 0.05, 0.0, 1.0)


def draw_scene(seed: int) -> tuple[str, LightStack, LightStack]:
    """Return a scene's kind, its lights to fit, and those in the gaps between them."""
    rng = np.random.default_rng(seed)
    kind, count = KINDS[seed % len(KINDS)], int(rng.choice(COUNTS))
    lights = draw_lights(rng, count)
    tests = make_pattern("uniform", TESTS)
    value_tp = draw_values(rng, kind, np.concatenate([lights, tests])).reshape(count + TESTS, 1, -1, 3)
    floats = rng.random() < 0.25
    images = value_tp.astype(np.float32) if floats else np.rint(255.0 * value_tp).astype(np.uint8)
    peak = 1.0 if floats else 255.0
    seen, tested = LightStack(images[:count], lights, peak), LightStack(images[count:], tests, peak)
    return kind, seen, keep_gaps(seen, tested)


def list_stacks(patterns: Sequence[str]) -> Iterator[tuple[str, LightStack, LightStack]]:
    """Yield name, lights to fit and lights in the gaps of stacks whose names fit one of the patterns."""
    for source in find_stacks(patterns):
        case = read_case(source)
        seen, tested = (Samples(part, STACK_COLUMNS).stack for part in (case.seen, case.stack.select(case.unseen_i)))
        for count in STACK_COUNTS:
            some = seen.select(pick_spread(seen.directions_i3, count))
            yield source.name, some, keep_gaps(some, tested)


def fit_and_test(seen: LightStack, tested: LightStack, limit: int | None) -> tuple[float, int]:
    """Return the mean PSNR in dB of `spectrum` at the lights tested, and the degree where its functions end."""
    lighting, samples = make_lighting(seen, "uniform", "hemisphere"), Samples(seen)
    settled = SpectrumFit(limit=limit).settle(lighting, LARGEST_DEGREE, samples)
    assert isinstance(settled, SpectrumFit)
    assert settled.limit is not None
    shown_tp = np.clip(settled.model(lighting).weights_at(tested.directions_i3) @ samples.radiance_ip, 0.0, 1.0)
    error_t = np.mean((shown_tp - Samples(tested).radiance_ip) ** 2, axis=1)
    return float(np.mean(-10.0 * np.log10(np.maximum(error_t, _LEAST)))), settled.limit


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=121)
    parser.add_argument("--first", type=int, default=1000, help="Seed of the first.")
    parser.add_argument("--stacks", action="append", metavar="GLOB", help="Such as 'Single/*', instead of scenes.")
    given = parser.parse_args()
    clear, agreed, every = "an end that lights left out ask for", "an end on which three agree", "all"
    drawn = (draw_scene(seed) for seed in range(given.first, given.first + given.scenes))
    gains: dict[str, list[float]] = {} if given.stacks else {kind: [] for kind in KINDS}
    ends: dict[str, list[float]] = {clear: [], agreed: [], every: []}
    for kind, seen, tested in list_stacks(given.stacks) if given.stacks else drawn:
        reached, limit = fit_and_test(seen, tested, None)
        gain = reached - fit_and_test(seen, tested, LARGEST_DEGREE)[0]
        gains.setdefault(kind, []).append(gain)
        if limit < LARGEST_DEGREE:
            ends[clear if (limit + 1) ** 2 <= seen.n_light / LIMIT_LIGHTS else agreed].append(gain)
        ends[every].append(gain)
    print("| scenes | number | mean, dB | worst | best |\n" + "|---" * 5 + "|")
    for name, some in {**gains, **ends}.items():
        if not some:
            continue
        print(f"| {name} | {len(some)} | {np.mean(some):+.2f} | {min(some):+.2f} | {max(some):+.2f} |")


if __name__ == "__main__":
    main()
