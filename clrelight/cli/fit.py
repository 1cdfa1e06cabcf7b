"""``clrelight fit``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.completion import known_methods
from clrelight.cli.engines import engine_options, is_shared, run_shared
from clrelight.cli.options import (
    DegreeType,
    basis_option,
    device_option,
    holdout_by_option,
    holdout_option,
    is_given,
    json_option,
    memory_option,
    within_option,
)
from clrelight.cli.output import decibel, make_report, print_facts, print_json, print_notes, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.cli.psnr import psnr_lines
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.jobs.report import Report

_HOW = ("stack", "out", "measured", "memory", "device", "as_json")
_BESIDE_CONFIG = (*_HOW, "config", "within", "store", "confidence", "engine", "jobs")
"""What a file that says what to fit leaves open."""
_BESIDE_UPDATE = (*_HOW, "update")
"""What a fit that is to grow leaves open."""


@click.command()
@click.argument("stack", type=click.Path())
@click.argument("out", type=click.Path())
@click.option(
    "--method",
    default="cls",
    shell_complete=known_methods,
    show_default=True,
    help="project, uls, sloan, cls, ceb, ceb-crossing, spline, spectrum, spectrum-curve, constrained or auto.",
)
@click.option("--degree", type=DegreeType(), default=6, show_default=True, help="Largest SH degree, or auto.")
@basis_option
@holdout_option("the fit")
@holdout_by_option
@click.option("--energy", type=float, help="Factor on the bound E_c of cls, ceb and constrained; 1 is the paper's.")
@click.option("--iterations", type=int, help="Steps of the search for lambda (cls); default 32.")
@click.option("--solver", help="Search for lambda (cls): newton (default), bisection of its logarithm, or the paper's.")
@click.option("--fill", help="Lower hemisphere (project): zero or mirror.")
@click.option("--lam", type=float, help="Smoothing of spline; default: by generalised cross-validation.")
@click.option("--per", help="What shares one lambda (spline): stack or channel.")
@click.option("--slope", type=float, help="Of the energy over degrees (spectrum); default: learnt.")
@click.option("--noise", type=float, help="Its variance in units of the samples' (spectrum); default: learnt.")
@click.option(
    "--lower", type=float, help="Least value at the directions of --bound-at (constrained), in units of the peak."
)
@click.option("--upper", type=float, help="Largest value there (constrained).")
@click.option(
    "--nonnegative", is_flag=True, default=None, help="The same as --lower 0, which is what constrained does by itself."
)
@click.option(
    "--bound-at",
    "at",
    metavar="WHERE",
    help="Where bounds on values stand (constrained): grid (default), ring, lights, or a light file.",
)
@within_option
@click.option("--weights", default="uniform", show_default=True, help="uniform or solid-angle.")
@click.option("--sampling", default="hemisphere", show_default=True, help="hemisphere or scattered (section V-D).")
@click.option(
    "--precision", default="mixed", show_default=True, help="Of kernels: mixed, single (float32) or double (float64)."
)
@click.option("--config", type=click.Path(), metavar="FILE.toml", help="All of this from a file, as trade writes it.")
@click.option(
    "--update",
    type=click.Path(),
    metavar="FIT.h5",
    help="Add the photographs of STACK to this fit (uls, sloan, spline), whose own are not needed.",
)
@click.option(
    "--store",
    type=click.Choice(["float32", "float16"]),
    default="float32",
    show_default=True,
    help="Type that coefficients are stored in: float16 takes half the bytes.",
)
@click.option("--measure/--no-measure", "measured", default=True, help="Whether to measure PSNR after fitting.")
@click.option(
    "--confidence",
    type=click.Path(),
    metavar="IMAGE",
    help="Picture of the PSNR expected under each light (spectrum): decibels in .exr, 5 code values each in .png.",
)
@memory_option("256MiB", "one tile of the fit")
@engine_options
@device_option
@json_option
@click.pass_context
def fit(
    context: click.Context,
    stack: str,
    out: str,
    config: str | None,
    update: str | None,
    holdout_by: str | None,
    measured: bool,
    confidence: str | None,
    engine: str | None,
    jobs: int | None,
    device: str | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Fit coefficients of spherical harmonics, or of another basis, to every pixel of a stack.

    \b
    Example:
      clrelight fit stack.h5 fit.h5 --method cls --degree 6 --holdout 5
      clrelight fit stack.h5 fit.h5 --method auto --degree auto
      clrelight fit stack.h5 fit.h5 --config trade.toml
      clrelight fit stack.h5 fit.h5 --method ceb --store float16
      clrelight fit stack.h5 fit.h5 --method spline --basis hsh
      clrelight fit stack.h5 fit.h5 --method constrained --bound-at ring
      clrelight fit more.h5 grown.h5 --update fit.h5
      clrelight fit large.h5 fit.h5 --jobs 2
    """
    from clrelight.fit.value_bounds import check_places
    from clrelight.jobs.fit import fit as run_fit
    from clrelight.jobs.inputs import read_directions
    from clrelight.jobs.report import Report
    from clrelight.jobs.update import update_fit
    from clrelight.store import check_output

    read_too = [name for name in (config, update) if name]
    # Of work that is long enough to be shared, what is done is told of also where it does not come to its end.
    report = make_report(as_json) if is_shared(engine, jobs) else Report()
    if asked["at"] is not None and not check_places(asked["at"]):
        read_too.append(asked["at"])
        asked["at"] = read_directions(asked["at"], report)
    for target in [out, *([confidence] if confidence else [])]:
        check_output(target, [stack, *read_too])
    asked["holdout_by"] = holdout_by or "index"
    if config is not None:
        asked.update(_read_config(context, config))
    with progress_bar("preparing") as bar:
        if update is not None:
            _refuse_beside(context, update, _BESIDE_UPDATE)
            memory = asked["memory"]
            update_fit(
                update, stack, out=out, measure=measured, memory=memory, device=device, progress=bar, report=report
            )
        else:
            asked.update(measure=measured, confidence=confidence)
            if is_shared(engine, jobs):
                run_shared("fit", stack, out, asked, engine, jobs, device, bar, report)
            else:
                run_fit(stack, out=out, device=device, progress=bar, report=report, **asked)
    if as_json:
        print_json(report.to_json())
        return
    if report.tell is None:
        print_notes(report.notes)
    print_facts(_lines(out, report))


def _lines(out: str, report: Report) -> dict[str, str | None]:
    """Return what people are told of a fit."""
    from clrelight.fit import method_class

    facts = report.facts
    return {
        "fit": out,
        "method": f"{method_class(facts['method']).title}, degree {facts['degree']}, {facts['n_light']} lights",
        **({"basis": facts["config"]["basis"]} if "basis" in facts["config"] else {}),
        "stored": f"{facts['dtype']}, {facts['bytes_on_disk']} bytes",
        "condition": f"{facts['condition']:.3g}",
        **_confidence_line(facts),
        **psnr_lines(report.psnr),
        "time": seconds_line(report.seconds),
        "device": report.device,
    }


def _confidence_line(facts: dict[str, Any]) -> dict[str, str]:
    if "confidence" not in facts:
        return {}
    told = facts["confidence"]
    least, median, most = (decibel(told[f"psnr_{which}"]) for which in ("least", "median", "most"))
    return {"confidence": f"{told['file']}, {least} to {most} expected, {median} in the median"}


def _refuse_beside(context: click.Context, file: str, open_names: tuple[str, ...]) -> None:
    """Raise InputError where the command line says what a file says itself."""
    for name in context.params:
        if name not in open_names and is_given(context, name):
            raise InputError(f"--{name.replace('_', '-')}: {file} says itself what to fit")


def _read_config(context: click.Context, config: str) -> dict[str, Any]:
    """Return the one fit that a TOML file asks for; InputError if it asks for several, or the command line does too."""
    from clrelight.experiment import load_experiment

    _refuse_beside(context, config, _BESIDE_CONFIG)
    asked = load_experiment(config)
    for what, values in (("method", asked.methods), ("degree", asked.degrees)):
        if len(values) != 1:
            raise InputError(f"{config} holds {len(values)} {what}s, a fit has one")
    same = ("holdout", "holdout_by", "lights", "weights", "sampling", "precision")
    return {"method": asked.methods[0], "degree": asked.degrees[0], **{name: getattr(asked, name) for name in same}}


COMMANDS = (fit,)
