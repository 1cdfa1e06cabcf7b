"""Print how often photographs are recognised: ``python -m benchmarks.recognition``.

Synthetic heads (`datasets_synth.heads`), photographed with attached and cast shadows and noise under light that no
subject was seen in: skies of the CIE at random, turned at random, a few lamps at random, and the probes of
CLRELIGHT_DATA, turned at random. Only pixels that all heads share count, so that no outline tells who it is.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.lighting import Table, show_parts
from clrelight.lighting.environment import Environment, read_environment
from clrelight.reproduction.heads import lamps_at, photograph, sky_light_at, turned
from clrelight.sampling import make_pattern
from clrelight.variation.recognition import SPACES, spaces_of_normals
from datasets_synth.heads import make_head, shade_head

SIZE, DIRECTIONS = 48, 400
PROBES = ("beach_probe.hdr", "grace_cross.hdr", "galileo_cross.dds")
DATA_VARIABLE = "CLRELIGHT_DATA"

Make = Callable[[np.random.Generator, NDArray[np.float64]], NDArray[np.float64]]
"""Return radiance of some light in each direction, (n_light, 3)."""


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--subjects", type=click.IntRange(min=2), default=24, show_default=True)
@click.option("--photographs", type=click.IntRange(min=1), default=6, show_default=True, help="Of each, in each light.")
@click.option("--size", type=click.IntRange(min=16), default=SIZE, show_default=True, help="Pixels of each side.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the table of a page.")
def main(subjects: int, photographs: int, size: int, markdown: Path | None) -> None:
    """Photograph synthetic heads under random light, and say how many are recognised."""
    show_parts({"recognition": rate_table(subjects, photographs, size)}, markdown)


def rate_table(count: int, photographs: int, size: int) -> Table:
    """Return the share that is recognised by each space in each kind of light, and the mean distances."""
    heads = [make_head(seed, size) for seed in range(count)]
    share_hw = np.stack([head.mask_hw for head in heads]).all(axis=0)
    directions_i3 = make_pattern("uniform", DIRECTIONS, sphere=True)
    gallery = [spaces_of_normals(head.normals_hw3[share_hw], head.albedo_hwc[share_hw]) for head in heads]
    lights: dict[str, Make] = {"skies, turned": sky_light_at, "one to five lamps": lamps_at, **_probes()}
    right = {(name, space): 0 for name in lights for space in SPACES}
    off = {(name, space): 0.0 for name in lights for space in SPACES}
    rng = np.random.default_rng(0)
    for who, head in enumerate(heads):
        shade_ip = shade_head(head, directions_i3)
        for name, make in lights.items():
            for _ in range(photographs):
                seen_pc = photograph(head, shade_ip, make(rng, directions_i3), rng)[share_hw]
                for space in SPACES:
                    distance_n = [each[space].distance(seen_pc) for each in gallery]
                    right[name, space] += int(np.argmin(distance_n)) == who
                    off[name, space] += distance_n[who]
    total = count * photographs
    rows = [
        [name, str(total), *(f"{right[name, space] / total:.1%}" for space in SPACES)]
        + [f"{off[name, space] / total:.3f}" for space in SPACES]
        for name in lights
    ]
    rows.append(
        ["all", str(total * len(lights))]
        + [f"{sum(right[name, s] for name in lights) / total / len(lights):.1%}" for s in SPACES]
        + [f"{sum(off[name, s] for name in lights) / total / len(lights):.3f}" for s in SPACES]
    )
    return ["light", "photographs", *(f"right, {s}" for s in SPACES), *(f"own distance, {s}" for s in SPACES)], rows


def _probes() -> dict[str, Make]:
    root = os.environ.get(DATA_VARIABLE)
    if root is None:
        click.echo(f"note: {DATA_VARIABLE} is not set, so there is no light of probes", err=True)
        return {}
    probes = [read_environment(Path(root, "probes", name))[0] for name in PROBES]

    def make(rng: np.random.Generator, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        probe = probes[rng.integers(len(probes))]
        return gather(probe, turned(rng, directions_i3))

    return {"real probes, turned any way": make}


def gather(environment: Environment, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean radiance of the texels that are nearest to each direction, (n_light, 3)."""
    from scipy.spatial import cKDTree

    towards, weights = environment.geometry()
    radiance_tc = environment.radiance_hwc.reshape(-1, environment.radiance_hwc.shape[2]).astype(np.float64)
    towards_t3, weight_t = towards.reshape(-1, 3), weights.ravel()
    used_t = weight_t > 0.0
    nearest_t = cKDTree(directions_i3).query(towards_t3[used_t])[1]
    sums_ic = np.stack(
        [np.bincount(nearest_t, weight_t[used_t] * each[used_t], len(directions_i3)) for each in radiance_tc.T], axis=1
    )
    return sums_ic / np.maximum(np.bincount(nearest_t, weight_t[used_t], len(directions_i3)), 1e-12)[:, None]


if __name__ == "__main__":
    main()
