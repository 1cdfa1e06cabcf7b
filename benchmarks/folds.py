"""Print what light between folds does to normals: ``python -m benchmarks.folds --markdown docs/normals.md``.

The known normals of SynthRTI's Object 2 are integrated to a relief, which is lit by that stack's lights with cast
shadows, and then by what its own parts send on as well, matte and to any number of bounces (radiosity:
``x = E + rho F x``, F gathered along rays). All that differs between rows is the albedo rho; without bounces normals
are those of the relief, so that what is off is this light's.
"""

from __future__ import annotations

import os
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

import clrelight as cr
from benchmarks.lighting import Table, show_parts
from benchmarks.normals import DATA_VARIABLE, angles
from clrelight.images import read_image
from clrelight.surface import Surface
from clrelight.transfer.rays import RayScene
from clrelight.variation.heights import integrate_normals

BODY = ("synthrti", "Single", "Object2", "material3", "Dome")
ALBEDOS = (0.0, 0.2, 0.5, 0.8, 0.9)
STEP, RAYS, BOUNCES = 5, 256, 60
_EXPOSURE, _EDGE, _SLOPED = 0.7, 2, 10.0
"""How bright white is; pixels of the border that are left out; degrees of tilt from which on it is compared."""


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the table of a page.")
def main(markdown: Path | None) -> None:
    """Measure normals of a relief whose folds light each other."""
    if DATA_VARIABLE not in os.environ:
        raise click.UsageError(f"{DATA_VARIABLE} must name the folder that holds stacks/synthrti")
    folder = Path(os.environ[DATA_VARIABLE], "stacks", *BODY)
    codes_hw3 = read_image(folder / "normals.png")
    known_hw3 = codes_hw3.astype(np.float64) * (2.0 / np.iinfo(codes_hw3.dtype).max) - 1.0
    known_hw3 /= np.maximum(np.linalg.norm(known_hw3, axis=2, keepdims=True), 1e-9)
    heights_hw = integrate_normals(known_hw3.astype(np.float32), None)[::STEP, ::STEP] / STEP
    lights_i3 = cr.ingest(folder, lights=folder / "dirs.lp", report=cr.Report()).directions_i3
    show_parts({"folds": fold_table(heights_hw, lights_i3, ALBEDOS)}, markdown)


def fold_table(heights_hw: NDArray[np.floating], lights_i3: NDArray[np.float64], albedos: tuple[float, ...]) -> Table:
    """Return how far normals of a relief are off for each albedo, in degrees."""
    surface = relief(heights_hw)
    scene, shape = RayScene(surface), heights_hw.shape
    gathered_vv = gather(scene)
    normals_v3 = surface.normals_v3.astype(np.float64)
    direct_iv = np.maximum(lights_i3 @ normals_v3.T, 0.0)
    for i, light_3 in enumerate(lights_i3.astype(np.float32)):
        direct_iv[i] *= ~scene.blocked(scene.starts_v3, np.broadcast_to(light_3, normals_v3.shape))
    within = np.zeros(shape, bool)
    within[_EDGE:-_EDGE, _EDGE:-_EDGE] = True
    tilt_v = np.degrees(np.arccos(np.clip(normals_v3[:, 2], -1.0, 1.0)))
    sloped_v = within.ravel() & (tilt_v > _SLOPED)
    rows = []
    for albedo in albedos:
        lit_iv = direct_iv
        for _ in range(BOUNCES if albedo else 0):
            lit_iv = direct_iv + albedo * (gathered_vv @ lit_iv.T).T
        images = (_EXPOSURE * lit_iv).reshape(len(lights_i3), *shape, 1).astype(np.float32)
        found_v3 = cr.normals(cr.LightStack(images, lights_i3, 1.0), report=cr.Report()).normals_hw3.reshape(-1, 3)
        off_v = angles(found_v3, normals_v3)[within.ravel()]
        flat = np.degrees(np.arccos(np.clip(found_v3[:, 2], -1.0, 1.0)))[sloped_v] / tilt_v[sloped_v]
        rows.append([f"{albedo:g}", f"{off_v.mean():.2f}", f"{np.median(off_v):.2f}", f"{np.median(flat):.2f}"])
    return ["albedo", "robust, mean °", "median °", "tilt found / true"], rows


def relief(heights_hw: NDArray[np.floating]) -> Surface:
    """Return a relief of heights in pixels, x right and y up, with the normals of central differences."""
    height, width = heights_hw.shape
    x_hw, y_hw = np.meshgrid(np.arange(width), -np.arange(height))
    right_hw, up_hw = np.gradient(heights_hw, axis=1), -np.gradient(heights_hw, axis=0)
    normals_hw3 = np.stack([-right_hw, -up_hw, np.ones_like(right_hw)], axis=2)
    normals_hw3 /= np.linalg.norm(normals_hw3, axis=2, keepdims=True)
    at_hw = np.arange(height * width, dtype=np.int32).reshape(height, width)
    first, right, below, across = at_hw[:-1, :-1], at_hw[:-1, 1:], at_hw[1:, :-1], at_hw[1:, 1:]
    faces = np.concatenate(
        [np.stack(each, -1).reshape(-1, 3) for each in ((first, below, right), (below, across, right))]
    )
    points_v3 = np.stack([x_hw, y_hw, heights_hw], axis=2).reshape(-1, 3).astype(np.float64)
    return Surface(points_v3, faces, normals_hw3.reshape(-1, 3).astype(np.float64))


def gather(scene: RayScene) -> sparse.csr_matrix:
    """Return how much of a vertex's irradiance each other's radiosity gives, (V, V), by rays of cosine density."""
    normals_v3, faces_f3 = scene.surface.normals_v3.astype(np.float64), scene.surface.faces_f3
    count, rng = len(normals_v3), np.random.default_rng(0)
    aside_v3 = np.cross(np.where(np.abs(normals_v3[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]), normals_v3)
    aside_v3 /= np.linalg.norm(aside_v3, axis=1, keepdims=True)
    across_v3 = np.cross(normals_v3, aside_v3)
    from_, to = [], []
    for k in range(RAYS):
        squared_v1 = ((k + rng.random(count)) / RAYS)[:, None]
        turn_v1 = 2.0 * np.pi * rng.random((count, 1))
        along_v3 = np.cos(turn_v1) * aside_v3 + np.sin(turn_v1) * across_v3
        rays_v3 = np.sqrt(squared_v1) * along_v3 + np.sqrt(1.0 - squared_v1) * normals_v3
        hits = scene.trace(scene.starts_v3, rays_v3.astype(np.float32))
        met_v = np.flatnonzero((hits.face_r >= 0) & ~hits.from_behind_r)
        from_.append(met_v)
        to.append(faces_f3[hits.face_r[met_v], hits.weights_r3[met_v].argmax(axis=1)])
    ends = np.concatenate(from_), np.concatenate(to)
    return sparse.csr_matrix((np.full(len(ends[0]), 1.0 / RAYS), ends), (count, count))


if __name__ == "__main__":
    main()
