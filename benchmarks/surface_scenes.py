"""Print what coding costs on scenes of surfaces, and whether wraps matter: ``python -m benchmarks.surface_scenes``.

The first table is that of four runs of ``clrelight bench``, which go on where an earlier run stopped. The second codes
maps of the same size whose margins continue the middle either around the seam or mirrored: what differs between them
is all that a codec could gain from knowing that a grid wraps.

Beside our wavelet the first table has one without an entropy coder: the same 9/7 transform by PyWavelets (extra
``speed``), and 16 levels in each subband of each map.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.commands import run_command
from benchmarks.lighting import Table, show_parts
from clrelight.codec import decode, encode
from clrelight.codec.formats.klt import Klt
from clrelight.codec.formats.wavelet import Wavelet
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device, open_device
from clrelight.jobs.fit import fit
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.report.paper_figures import SETTINGS
from clrelight.report.rows import Setting, method_label, rows_by_key, scene_names, scene_rows
from clrelight.results import Results
from clrelight.store import read_results
from datasets_synth.scenes import SCENES as RENDERED

SCENES = (["torus"], ["torus", "--albedo", "tiles"], ["dama"], ["dama", "--material", "ggx"])
DEGREES, RATES = (4, 6), (4.0, 2.0, 1.0)
COLUMNS = (*SETTINGS[:3], Setting("wavelet", "2"), Setting("wavelet", "1"))
LEVELS = 16
METHODS = ("uls", "sloan", "cls", "ceb")
SEAM = 4
"""Rows or columns beside a seam that count as at it."""


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--size", type=click.IntRange(min=8), default=128, show_default=True, help="Rows and columns.")
@click.option("--results", type=click.Path(dir_okay=False), default="scenes.h5", show_default=True)
@click.option("--device", metavar="NAME", help="Index, gpu, cpu, pocl or a part of a name.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the tables of a page.")
def main(size: int, results: str, device: str | None, markdown: Path | None) -> None:
    """Measure the scenes of surfaces, and print one table for each question."""
    for words in SCENES:
        run_command(["bench", *words, "--size", str(size), "--degrees", ",".join(map(str, DEGREES)), "--codecs",
                     "none,uniform,wavelet", "--rates", ",".join(f"{rate:g}" for rate in RATES), "--out", results,
                     "--json"])  # fmt: skip
    stacks = {stack.name: stack for stack in (_render(words, size) for words in SCENES)}
    parts = {
        "coding": coding_table(read_results(results), stacks, open_device(device)),
        "wrapping": wrapping_table(stacks, open_device(device)),
    }
    show_parts(parts, markdown)


def _render(words: list[str], size: int) -> LightStack:
    options = dict(zip((word.removeprefix("--") for word in words[1::2]), words[2::2], strict=True))
    scene = RENDERED[words[0]]
    return replace(scene.render({**options, "size": size}), name=scene.stack_name(options))


def coding_table(results: Results, stacks: dict[str, LightStack], device: Device) -> Table:
    """Return PSNR over the sampled directions, plain and coded."""
    rows = []
    for scene in scene_names(results):
        found = rows_by_key(scene_rows(results, scene))
        for degree in DEGREES:
            for method in METHODS:
                cells = [found[method, degree, setting] for setting in COLUMNS]
                plain = float(cells[0]["psnr_mean"])
                coded = [float(cell["psnr_mean"]) for cell in cells[1:]]
                coded.append(_psnr_of_levels(fit(stacks[scene], method, degree, device=device), stacks[scene], device))
                falls = [f"{each:.2f} (−{max(plain - each, 0.0):.2f})" for each in coded]
                energy = f"{float(cells[0]['mean_energy']):.3g}"
                rows.append(
                    [scene, str(int(cells[0]["n_coeff"])), method_label(method), energy, f"{plain:.2f}", *falls]
                )
    headers = ["scene", "n", "method", "‖c‖²", "plain (dB)", *(setting.label for setting in COLUMNS[1:])]
    return [*headers, f"9/7, {LEVELS} levels, no entropy coder"], rows


def _psnr_of_levels(fitted: CoefficientMap, stack: LightStack, device: Device) -> float:
    """Return PSNR of coefficients whose subbands have `LEVELS` levels between their least and greatest value."""
    planes_phw = np.moveaxis(fitted.coeffs_khwc, 3, 1).reshape(-1, *fitted.image_shape[:2])
    coded_phw = np.stack([_code_subbands(plane_hw.astype(np.float64)) for plane_hw in planes_phw])
    n_coeff, height, width, channel = fitted.coeffs_khwc.shape
    coded_khwc = np.moveaxis(coded_phw.reshape(n_coeff, channel, height, width), 1, 3).astype(np.float32)
    coded = replace(fitted, coeffs_khwc=np.ascontiguousarray(coded_khwc))
    return summarize_errors(measure_errors(coded, stack, device=device)).psnr_mean


def _code_subbands(plane_hw: NDArray[np.float64]) -> NDArray[np.float64]:
    import pywt

    def code(band: NDArray[np.float64]) -> NDArray[np.float64]:
        low, step = band.min(), np.ptp(band) / LEVELS
        return band if step == 0.0 else low + step * (np.minimum((band - low) // step, LEVELS - 1) + 0.5)

    low, *details = pywt.wavedec2(plane_hw, "bior4.4", mode="periodization", level=3)
    coded = [code(low), *(tuple(map(code, bands)) for bands in details)]
    height, width = plane_hw.shape
    return pywt.waverec2(coded, "bior4.4", mode="periodization")[:height, :width]


def wrapping_table(stacks: dict[str, LightStack], device: Device) -> Table:
    """Return how much noise stands at seams, and what a codec that wraps could gain, in dB."""
    rows = []
    for name in ("tiles-torus", "dama"):
        stack = stacks[name]
        axes = (1, 2) if name == "tiles-torus" else (2,)
        for method in ("uls", "cls"):
            coeffs_khwc = fit(stack, method, 6, device=device).coeffs_khwc
            for codec in (Wavelet(rate=1.0), Wavelet(rate=4.0), Klt(rate=0.5)):
                error_hw = _errors(coeffs_khwc, codec, device)
                at_seam = _at_seam(error_hw.shape, axes)
                padded = [_padded(coeffs_khwc, axes, how) for how in ("reflect", "wrap")]
                sides = enumerate(stack.image_shape[:2], start=1)
                middle = tuple(slice(n // 2, n // 2 + n) if axis in axes else slice(None) for axis, n in sides)
                gains = [_errors(each_khwc, codec, device)[middle] for each_khwc in padded]
                rows.append([
                    name, method_label(method), f"{codec.id} {codec.rate:g} bit",
                    f"{_decibels(error_hw[at_seam].mean(), error_hw[~at_seam].mean()):+.2f}",
                    f"{_decibels(gains[0][at_seam].mean(), gains[1][at_seam].mean()):+.2f}",
                    f"{_decibels(gains[0].mean(), gains[1].mean()):+.2f}",
                ])  # fmt: skip
    headers = ["scene", "method", "codec", "noise at seams against elsewhere", "gain of wrapping, at seams", "overall"]
    return headers, rows


def _errors(coeffs_khwc: NDArray[np.float32], codec: Wavelet | Klt, device: Device) -> NDArray[np.float64]:
    """Return the squared errors of coefficients, summed over coefficients and channels."""
    decoded_khwc = decode(encode(coeffs_khwc, codec, device).to_bytes(), device)
    return ((decoded_khwc.astype(np.float64) - coeffs_khwc) ** 2).sum(axis=(0, 3))


def _padded(coeffs_khwc: NDArray[np.float32], axes: tuple[int, ...], how: str) -> NDArray[np.float32]:
    widths = [(n // 2, n // 2) if axis in axes else (0, 0) for axis, n in enumerate(coeffs_khwc.shape)]
    return np.ascontiguousarray(np.pad(coeffs_khwc, widths, mode=how))  # type: ignore[call-overload]


def _at_seam(shape: tuple[int, ...], axes: tuple[int, ...]) -> NDArray[np.bool_]:
    found = np.zeros(shape, bool)
    for axis in axes:
        place = np.arange(shape[axis - 1])
        near = np.minimum(place, shape[axis - 1] - 1 - place) < SEAM
        found |= near[:, None] if axis == 1 else near[None, :]
    return found


def _decibels(first: float, second: float) -> float:
    return float(10.0 * np.log10(first / second))


if __name__ == "__main__":
    main()
