"""``clrelight fit``."""

from __future__ import annotations

import itertools
import time
from collections.abc import Generator
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import DegreeType, device_option, given, holdout_option, json_option, memory_option
from clrelight.cli.output import print_facts, print_json, print_notes, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.cli.quality import measure, psnr_lines
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.experiment import Experiment
    from clrelight.fit import FitMethod
    from clrelight.fit.run import FittedTile, PreparedFit
    from clrelight.store import FitSink


@click.command()
@click.argument("stack", type=click.Path())
@click.argument("out", type=click.Path())
@click.option(
    "--method", default="cls", show_default=True, help="project, uls, sloan, cls, ceb, ceb-crossing, spline or auto."
)
@click.option("--degree", type=DegreeType(), default=6, show_default=True, help="Largest SH degree, or auto.")
@holdout_option("the fit")
@click.option("--energy", type=float, help="Factor on the bound E_c of cls and ceb; 1 is the paper's.")
@click.option("--iterations", type=int, help="Steps of the search for lambda (cls); default 32.")
@click.option("--solver", help="Search for lambda (cls): newton (default), or bisection, the paper's.")
@click.option("--fill", help="Lower hemisphere (project): zero or mirror.")
@click.option("--lam", type=float, help="Smoothing of spline; default: by generalised cross-validation.")
@click.option("--per", help="What shares one lambda (spline): stack or channel.")
@click.option("--weights", default="uniform", show_default=True, help="uniform or solid-angle.")
@click.option("--sampling", default="hemisphere", show_default=True, help="hemisphere or scattered (section V-D).")
@click.option(
    "--precision",
    default="mixed",
    show_default=True,
    help="Of kernels: mixed, single (float32) or double (float64).",
)
@click.option("--config", type=click.Path(), metavar="FILE.toml", help="All of this from a file, as trade writes it.")
@click.option(
    "--store",
    type=click.Choice(["float32", "float16"]),
    default="float32",
    show_default=True,
    help="Type that coefficients are stored in: float16 takes half the bytes.",
)
@click.option("--measure/--no-measure", "measured", default=True, help="Whether to measure PSNR after fitting.")
@memory_option("256MiB", "one tile of the fit")
@device_option
@json_option
@click.pass_context
def fit(
    context: click.Context,
    stack: str,
    out: str,
    method: str,
    degree: int | str,
    holdout: int | None,
    weights: str,
    sampling: str,
    precision: str,
    config: str | None,
    store: str,
    measured: bool,
    memory: int,
    device: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Fit SH coefficients to every pixel of a stack.

    \b
    Example:
      clrelight fit stack.h5 fit.h5 --method cls --degree 6 --holdout 5
      clrelight fit stack.h5 fit.h5 --method auto --degree auto
      clrelight fit stack.h5 fit.h5 --config trade.toml
      clrelight fit stack.h5 fit.h5 --method ceb --store float16
    """
    import os

    from clrelight.dataset import CoefficientMap
    from clrelight.device import open_device
    from clrelight.fit.run import prepare_fit
    from clrelight.sampling import split_chosen
    from clrelight.store import check_output, create_fit, open_stack

    check_output(out, [stack, *([config] if config else [])])
    model: str | FitMethod = method
    lights = None
    if config is not None:
        settled = [*options, "method", "degree", "holdout", "weights", "sampling", "precision"]
        asked = _read_config(context, config, settled)
        model, degree, holdout, lights = asked.methods[0], asked.degrees[0], asked.holdout, asked.lights
        weights, sampling, precision = asked.weights, asked.sampling, asked.precision
    opened = open_device(device)
    with open_stack(stack) as source:
        fitted, held = split_chosen(source.directions_i3, holdout, lights)
        chosen = source if len(fitted) == source.n_light else source.select(fitted)
        with progress_bar("choosing a model" if "auto" in (model, degree) else "preparing"):
            prepared = prepare_fit(
                chosen,
                model,
                degree,
                options=given(**options),
                weights=weights,
                sampling=sampling,
                precision=precision,
                device=opened,
            )
        report, kind, n_coeff = prepared.report, prepared.method, (prepared.degree + 1) ** 2
        facts: dict[str, Any] = {
            "file": out,
            "method": kind.id,
            "degree": prepared.degree,
            "n_coeff": n_coeff,
            "n_light": len(fitted),
            "n_holdout": len(held),
            "config": dict(prepared.config),
            "dtype": store,
            "condition": report.condition,
            "device": opened.info.label,
            "notes": report.notes,
        }
        if prepared.choice is not None:
            facts["choice"] = prepared.choice.to_config()
        about: dict[str, Any] = {
            "degree": prepared.degree,
            "method": kind.id,
            "peak": source.peak,
            "transfer": source.transfer,
            "directions_i3": chosen.directions_i3,
            "config": prepared.config,
            "name": source.name,
        }
        maps: dict[str, Any] = {"has_lambda": kind.has_lambda, "has_rank": kind.has_rank}
        with create_fit(out, image_shape=source.image_shape, dtype=store, **maps, **about) as sink:
            _fill(sink, prepared, memory)
            # Before the file stands: where measuring fails, or is interrupted, an old file stays.
            if measured:
                since = time.perf_counter()
                facts["psnr"] = measure(CoefficientMap(sink.coeffs_khwc, **about), source, opened, (fitted, held))
                report.add("measure", since)
            since = time.perf_counter()
        report.add("write", since)
        facts["bytes_on_disk"] = os.stat(out).st_size
        facts["seconds"] = report.seconds
    if as_json:
        print_json(facts)
        return
    print_notes(report.notes)
    print_facts(
        {
            "fit": out,
            "method": f"{kind.title}, degree {prepared.degree}, {len(fitted)} lights",
            "stored": f"{store}, {facts['bytes_on_disk']} bytes",
            "condition": f"{report.condition:.3g}",
            **psnr_lines(facts.get("psnr")),
            "time": seconds_line(report.seconds),
            "device": opened.info.label,
        }
    )


def _read_config(context: click.Context, config: str, settled: list[str]) -> Experiment:
    """Return the one fit that a TOML file asks for; InputError if it asks for several, or the command line does too."""
    from clrelight.experiment import load_experiment

    for name in settled:
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(f"--{name}: {config} says itself what to fit")
    asked = load_experiment(config)
    for what, values in (("method", asked.methods), ("degree", asked.degrees)):
        if len(values) != 1:
            raise InputError(f"{config} holds {len(values)} {what}s, a fit has one")
    return asked


def _fill(sink: FitSink, prepared: PreparedFit, memory: int) -> None:
    from clrelight.streaming import writing_behind

    def write(tile: FittedTile) -> None:
        sink.write_rows(tile.first, tile.coeffs_khwc, tile.lambda_hwc, tile.rank_hwc)

    make = _float32_tiles if sink.coeffs_khwc.dtype.itemsize == 4 else _float16_tiles
    tiles = make(prepared, memory, sink.coeffs_khwc.chunks[1])
    with progress_bar(f"fitting {prepared.method.title}") as bar, closing(tiles):
        with writing_behind(write) as put:
            for tile in tiles:
                since = time.perf_counter()
                put(tile)
                since = prepared.report.add("write", since)
                bar(tile.end, prepared.stack.image_shape[0])
        prepared.report.add("write", since)


def _float32_tiles(prepared: PreparedFit, memory: int, row_step: int) -> Generator[FittedTile, None, None]:
    from clrelight.fit.run import fit_tiles

    return fit_tiles(prepared, memory_bytes=memory, held=2, row_step=row_step)


def _float16_tiles(prepared: PreparedFit, memory: int, row_step: int) -> Generator[FittedTile, None, None]:
    """Yield each tile rounded to halves: of one tile the float32 are held, of two, one being written, the halves."""
    import numpy as np

    from clrelight.codec.rounding import rounding_rows
    from clrelight.fit.run import fit_tiles
    from clrelight.streaming import Buffer

    map_bytes = 4 * (prepared.method.has_lambda + prepared.method.has_rank)
    beside = 2 * 2 * (prepared.degree + 1) ** 2 + map_bytes
    halves_of = itertools.cycle([Buffer(), Buffer()])
    tiles = fit_tiles(prepared, memory_bytes=memory, row_step=row_step, beside=beside)
    with rounding_rows(prepared.device) as round_rows, closing(tiles):
        for tile in tiles:
            since = time.perf_counter()
            halves_khwc = next(halves_of).lend(tile.coeffs_khwc.shape, np.float16)
            rounded = replace(tile, coeffs_khwc=round_rows(tile.coeffs_khwc, halves_khwc, tile.first))
            prepared.report.add("round", since)
            yield rounded


COMMANDS = (fit,)
