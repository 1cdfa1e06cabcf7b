"""Bases of the hemisphere beside spherical harmonics: ``python -m benchmarks.bases --markdown docs/bases.md``.

At unseen lights of real stacks (``CLRELIGHT_DATA``): SynthRTI's Test, every fifth light of the others. All
methods get the same samples; figures are the mean over stacks of the mean PSNR over unseen lights, in code values taken
as linear.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

import click
import numpy as np

import clrelight as cr
from benchmarks.bases_light import light_parts
from benchmarks.lighting import Table, show_parts
from benchmarks.rti_stacks import DATA_VARIABLE, Case, Source, crop, find_stacks, read_case
from clrelight.bases import SH, basis_ids
from clrelight.bases.haar import level_of
from clrelight.codec import codec_class, decode, encode
from clrelight.dataset import CoefficientMap, split_lights
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.jobs.ingest import ingest
from clrelight.jobs.report import Note, Report
from clrelight.metrics import measure_errors, summarize_errors

METHODS = ("uls", "spline")
BEST = "spectrum"
"""The method for spherical harmonics that `auto` takes, for comparison."""
DEGREES = (2, 3, 4, 5, 6, 7, 15)
CODED = (3, 7)
"""Degrees that all bases have."""
CODECS: dict[str, tuple[str, dict[str, float]]] = {
    "s3tc": ("s3tc", {}),
    "uniform 8": ("uniform", {"bits": 8}),
    "klt, 1 bit a pixel": ("klt", {"bits": 1.0}),
}
HOLDOUT = 5

Figures = dict[tuple[str, str, int, str], dict[str, float]]
"""By method, basis, degree and codec (none where it is empty), the figure of each stack."""


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the tables of a page.")
@click.option("--json", "json_path", type=click.Path(dir_okay=False, path_type=Path), help="All figures as JSON.")
@click.option("--pixels", type=click.IntRange(min=8), default=96, show_default=True, help="Middle pixels of a side.")
@click.option("--stacks", "patterns", multiple=True, metavar="GLOB", help="Stacks by name; default: all.")
def main(markdown: Path | None, json_path: Path | None, pixels: int, patterns: tuple[str, ...]) -> None:
    """Compare bases at equal count, at equal bytes, and by the terms that light takes."""
    if DATA_VARIABLE not in os.environ:
        raise click.ClickException(f"{DATA_VARIABLE} must name the folder of stacks and probes")
    warnings.simplefilter("ignore", Note)
    device, figures = open_device(None), defaultdict(dict)
    for case in list_cases(patterns, pixels):
        measure_case(case, device, figures)
        print(f"measured {case.source.name}", file=sys.stderr)
    if json_path is not None:
        rows = [{"key": key, "psnr": found} for key, found in figures.items()]
        json_path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    parts = {f"count-{method}": count_table(figures, method) for method in METHODS}
    parts |= {"groups": group_table(figures), "coded": coded_table(figures)}
    show_parts(parts | light_parts(Path(os.environ[DATA_VARIABLE]), device), markdown)


def list_cases(patterns: tuple[str, ...], pixels: int) -> Iterator[Case]:
    """Yield the stacks: those of the RTI field, and loewenkopf, each cut to its middle."""
    folder = Path(os.environ[DATA_VARIABLE]) / "stacks" / "loewenkopf"
    if folder.is_dir() and (not patterns or any(fnmatch("loewenkopf", pattern) for pattern in patterns)):
        stack = ingest(folder, report=Report(), lights=folder / "dirs.lp", transfer="linear")
        lion = replace(stack, notes=(), name="loewenkopf")
        yield Case(Source("loewenkopf", "loewenkopf", folder), crop(lion, pixels), *split_lights(lion.n_light, HOLDOUT))
    others = [pattern for pattern in patterns if pattern != "loewenkopf"]
    for source in find_stacks(others) if others or not patterns else []:
        yield read_case(source, pixels=pixels)


def measure_case(case: Case, device: Device, figures: Figures) -> None:
    """Add what every basis reaches on a stack."""
    unseen = case.stack.select(case.unseen_i)

    def psnr(fitted: CoefficientMap) -> float:
        errors_i = measure_errors(fitted, unseen, device=device)
        return float(np.minimum(summarize_errors(errors_i).psnr_i, 60.0).mean())  # identical black images count so

    for method in (*METHODS, BEST):
        for basis in basis_ids() if method != BEST else [SH]:
            for degree in DEGREES:
                if method == "uls" and (degree + 1) ** 2 > len(case.fitted_i):
                    continue
                try:
                    fitted = cr.fit(case.seen, method, degree, basis=basis, device=device)
                except InputError:
                    continue  # more functions than lights, or none of that degree
                figures[method, basis, degree, ""][case.source.name] = psnr(fitted)
                if degree not in CODED or method == BEST:
                    continue
                for name in CODECS:
                    decoded = coded(fitted, name, device)
                    figures[method, basis, degree, name][case.source.name] = psnr(decoded)


def coded(fitted: CoefficientMap, name: str, device: Device) -> CoefficientMap:
    """Return what a codec makes of a fit."""
    codec_id, options = CODECS[name]
    if "bits" in options and codec_id == "klt":
        height, width, _ = fitted.image_shape
        options = {"byte_budget": int(options["bits"] * height * width / 8)}
    encoded = encode(
        fitted.coeffs_khwc,
        codec_class(codec_id).from_config(options),
        device,
        fitted.basis,
        fitted.fitted_lights,
    )
    return replace(fitted, coeffs_khwc=decode(encoded.to_bytes(), device))


def _mean(found: dict[str, float], names: set[str]) -> str:
    return f"{np.mean([found[name] for name in sorted(names)]):.2f}" if names and names <= set(found) else "–"


def _common(figures: Figures, keys: list[tuple[str, str, int, str]]) -> set[str]:
    """Return the stacks that all of some keys have, so that their means are of the same."""
    held = [set(figures[key]) for key in keys if key in figures]
    return set.intersection(*held) if held else set()


def _has(basis: str, degree: int) -> bool:
    if basis != "haar":
        return True
    try:
        level_of(degree)
    except InputError:
        return False
    return True


def count_table(figures: Figures, method: str) -> Table:
    """Return the mean PSNR of each basis at equal counts of functions."""
    header, rows, best = ["basis"], {basis: [basis] for basis in basis_ids()}, [f"sh by {BEST}"]
    for degree in DEGREES:
        keys = [(method, basis, degree, "") for basis in basis_ids() if _has(basis, degree)]
        names = _common(figures, keys)
        if not names:
            continue
        header.append(f"{(degree + 1) ** 2} ({len(names)})")
        for basis, row in rows.items():
            row.append(_mean(figures.get((method, basis, degree, ""), {}), names))
        best.append(_mean(figures.get((BEST, SH, degree, ""), {}), names))
    return header, [*rows.values(), best]


def group_table(figures: Figures) -> Table:
    """Return the mean PSNR of spline at the largest degrees by groups of stacks."""
    columns = [(degree, group) for degree in (7, 15) for group in ("loewenkopf", "Single", "Multi", "Real")]
    rows = []
    for basis in basis_ids():
        row = [basis]
        for degree, group in columns:
            found = figures.get(("spline", basis, degree, ""), {})
            row.append(_mean(found, {name for name in found if name.split("/")[0] == group}))
        rows.append(row)
    return ["basis", *(f"{group}, {(degree + 1) ** 2}" for degree, group in columns)], rows


def coded_table(figures: Figures) -> Table:
    """Return the mean PSNR after codecs, at equal counts, and of `klt` at equal bytes."""
    rows = []
    for degree in CODED:
        for method in METHODS:
            keys = [(method, basis, degree, "") for basis in basis_ids()]
            names = _common(figures, keys)
            for basis in basis_ids() if names else []:
                found = [figures.get((method, basis, degree, name), {}) for name in ("", *CODECS)]
                rows.append([str((degree + 1) ** 2), method, basis, *(_mean(each, names) for each in found)])
    return ["functions", "method", "basis", "as fitted", *CODECS], rows


if __name__ == "__main__":
    main()
