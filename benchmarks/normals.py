"""Print how far normals are from those that were scanned or rendered, and how long they take.

``python -m benchmarks.normals`` takes the stacks of CLRELIGHT_DATA whose normals are known: DiLiGenT's (scanned) and
SynthRTI's (rendered); the transfer curve is told from the samples. ``--megapixels 24`` times a stack of that size, from
file to file, beside a fit of degree 4.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import click
import numpy as np
import scipy.io
from numpy.typing import NDArray

import clrelight as cr
from benchmarks.lighting import Table, show_parts
from clrelight.images import read_image
from clrelight.sampling import make_pattern
from clrelight.store import create_stack

DATA_VARIABLE = "CLRELIGHT_DATA"
SCANNED = ("cat", "bear", "pot1")
SHINING = ("material5", "material7")
"""What looks like metal: its samples near the mirror direction are far above the law."""
LIGHTS, WIDTH = 49, 6000


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--megapixels", type=click.FloatRange(min=0.1), help="Time a stack of that size instead.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the tables of a page.")
def main(megapixels: float | None, markdown: Path | None) -> None:
    """Measure normals against known ones, or their time beside a fit's."""
    if megapixels is not None:
        show_parts({"normals-time": time_table(megapixels)}, markdown)
        return
    if DATA_VARIABLE not in os.environ:
        raise click.UsageError(f"{DATA_VARIABLE} must name the folder that holds stacks/diligent and stacks/synthrti")
    root = Path(os.environ[DATA_VARIABLE], "stacks")
    show_parts({"normals": error_table(root)}, markdown)


def angles(found_hw3: NDArray[np.float32], known_hw3: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return degrees between unit vectors of any shape (..., 3); 90 where none was found."""
    known_hw3 = known_hw3 / np.maximum(np.linalg.norm(known_hw3, axis=-1, keepdims=True), 1e-9)
    return np.degrees(np.arccos(np.clip(np.sum(found_hw3 * known_hw3, axis=-1), -1.0, 1.0)))


def error_table(root: Path) -> Table:
    """Return mean and median errors of the methods, and ratios to plain least squares."""
    rows, ratios, medians = [], [], []
    for name in SCANNED:
        folder = root / "diligent" / f"{name}PNG"
        stack = cr.ingest(folder, report=cr.Report())
        known_hw3 = scipy.io.loadmat(folder / "Normal_gt.mat")["Normal_gt"]
        row, ratio, _ = _row(f"DiLiGenT {name}", stack, known_hw3, stack.mask_hw)
        ratios.append(ratio)
        rows.append(row)
    rows.append(["DiLiGenT, greatest ratio", *[""] * 5, f"{max(ratios):.3f}", "", ""])
    for kind in ("Single", "Multi"):
        for folder in sorted(root.glob(f"synthrti/{kind}/*/*/Dome")):
            material, body = folder.parent.name, folder.parents[1].name
            stack = cr.ingest(folder, lights=folder / "dirs.lp", report=cr.Report())
            codes_hw3 = read_image(folder / "normals.png")
            known_hw3 = codes_hw3.astype(np.float64) * (2.0 / np.iinfo(codes_hw3.dtype).max) - 1.0
            name = f"SynthRTI {kind} {body} {material}"
            row, _, median = _row(name + (" (shines)" if material in SHINING else ""), stack, known_hw3, None)
            rows.append(row)
            if kind == "Single":
                medians.append(median)
    if medians:
        told = f"{np.median(medians):.2f}; greatest {max(medians):.2f}"
        rows.append(["SynthRTI Single, median of the medians", *[""] * 4, told, "", "", ""])
    headers = ["stack", "least squares, mean °", "median °", "quick, mean °", "robust, mean °", "median °"]
    return [*headers, "robust / least squares", "curve told", "law"], rows


def _row(
    name: str, stack: cr.LightStack, known_hw3: NDArray[np.floating], mask_hw: NDArray[np.bool_] | None
) -> tuple[list[str], float, float]:
    inside = np.ones(stack.image_shape[:2], bool) if mask_hw is None else mask_hw
    error = {}
    for method in ("least-squares", "quick", "auto"):
        found = cr.normals(stack, method=method, transfer="auto", report=cr.Report())
        error[method] = angles(found.normals_hw3, known_hw3)[inside]
    robust, plain = error["auto"], error["least-squares"]
    ratio = float(robust.mean() / plain.mean())
    cells = [f"{plain.mean():.2f}", f"{np.median(plain):.2f}", f"{error['quick'].mean():.2f}"]
    cells += [f"{robust.mean():.2f}", f"{np.median(robust):.2f}", f"{ratio:.3f}"]
    law = found.found.law.text if found.found.law is not None else ""
    return [name, *cells, found.found.transfer, law], ratio, float(np.median(robust))


def time_table(megapixels: float) -> Table:
    """Return seconds of normals and of a fit of degree 4, of one stack of 8-bit colour, and the memory of each."""
    height = max(1, round(megapixels * 1e6 / WIDTH))
    directions_i3 = make_pattern("uniform", LIGHTS)
    rng, rows, seconds = np.random.default_rng(0), [], {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "stack.h5")
        blank_ihwc = np.broadcast_to(np.zeros((), np.uint8), (LIGHTS, height, WIDTH, 3))
        with create_stack(path, cr.LightStack(blank_ihwc, directions_i3, 255.0)) as sink:
            step = -(-64 // sink.chunks[1]) * sink.chunks[1]
            strip_ihwc = _strip(rng, directions_i3, step)
            for first in range(0, height, step):
                sink[:, first : min(first + step, height)] = strip_ihwc[:, : min(step, height - first)]
        for name, run in {
            "`normals` (quick)": lambda: cr.normals(path, out=Path(folder, "n.exr"), report=cr.Report()),
            "`normals --method robust`": lambda: cr.normals(
                path, out=Path(folder, "n.exr"), method="robust", report=cr.Report()
            ),
            "`fit --degree 4 --no-measure`": lambda: cr.fit(
                path, degree=4, out=Path(folder, "f.h5"), measure=False, report=cr.Report()
            ),
            "`fit --degree 4`": lambda: cr.fit(path, degree=4, out=Path(folder, "f.h5"), report=cr.Report()),
        }.items():
            since, used = time.perf_counter(), time.process_time()
            run()
            seconds[name] = time.perf_counter() - since, time.process_time() - used
    beside = list(seconds.values())[-1]
    for name, (wall, used) in seconds.items():
        ratio = f"{wall / beside[0]:.2f}"
        rows.append([name, f"{megapixels:g} MP × {LIGHTS}", f"{wall:.1f}", f"{used:.1f}", ratio])
    return ["job", "stack", "seconds", "of processors", "beside the fit that is measured"], rows


def _strip(rng: np.random.Generator, directions_i3: NDArray[np.float64], rows: int) -> NDArray[np.uint8]:
    """Return rows of a rough matte surface with some gloss."""
    normals_p3 = rng.standard_normal((rows * WIDTH, 3)).astype(np.float32) * 0.3 + np.array([0.0, 0.0, 1.0], np.float32)
    normals_p3 /= np.linalg.norm(normals_p3, axis=1, keepdims=True)
    shade_ip = np.maximum(directions_i3.astype(np.float32) @ normals_p3.T, 0.0)
    shade_ip += 0.3 * shade_ip**30
    codes_ip = np.minimum(180.0 * shade_ip, 255.0).astype(np.uint8)
    return np.repeat(codes_ip.reshape(LIGHTS, rows, WIDTH, 1), 3, axis=3)


if __name__ == "__main__":
    main()
