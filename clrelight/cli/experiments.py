"""``clrelight bench`` and ``report``."""

from __future__ import annotations

from pathlib import Path

import click

from clrelight.cli.engines import engine_options
from clrelight.cli.grids import bench_grid
from clrelight.cli.options import (
    ByteCount,
    Degrees,
    Names,
    Numbers,
    device_option,
    given,
    holdout_by_option,
    holdout_option,
    json_option,
    whole_number,
)
from clrelight.cli.output import make_report, print_facts, print_json, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.psnr import psnr_lines
from clrelight.cli.speed import DEFAULT_OUT, bench_speed
from clrelight.errors import InputError

PAGE = "report.html"


@click.command()
@click.argument("what", metavar="[ring|torus|dama|STACK.h5|EXPERIMENT.toml]", required=False)
@click.option("--out", type=click.Path(), help=f"Results file; default results.h5, with --speed {DEFAULT_OUT}.")
@click.option("--methods", type=Names(), help="Fits, such as uls,cls,auto; default: the paper's four.")
@click.option("--degrees", type=Degrees(), help="SH degrees, or auto; default 6. With --speed: those to compare.")
@click.option("--codecs", type=Names(), help="Codecs; default none,half,s3tc,uniform,wavelet.")
@click.option("--rates", type=Numbers(float, "0.5,1,2"), help="Bits per coefficient of codecs that take a rate.")
@holdout_option("the fits")
@holdout_by_option
@click.option("--precision", help="Of the fits' kernels: mixed (default), single or double.")
@click.option(
    "--size", type=whole_number(8, 1 << 16), help="Scene: width and height; default 256, of torus and dama 128."
)
@click.option(
    "--lights",
    type=Numbers(int, "64,256"),
    help="Scene: number of lights; default 256. With --speed: those to compare.",
)
@click.option("--pattern", help="Scene: uniform, grid or scattered.")
@click.option("--seed", type=whole_number(0), help="Scene: seed; default 0.")
@click.option("--albedo", help="Torus: white or tiles.")
@click.option("--material", help="Dama: phong, blinn or ggx.")
@click.option("--force", is_flag=True, help="Start anew although the results file exists.")
@click.option("--speed", is_flag=True, help="Measure seconds and bytes beside NumPy, on pictures made for it.")
@click.option("--sizes", type=Numbers(int, "64,1024"), help="Speed: widths (and heights) to compare.")
@click.option("--threads", type=Numbers(int, "1,2"), help="Speed: numbers of threads to compare.")
@click.option("--rounds", type=whole_number(1), help="Speed: runs of each job that count; default 5.")
@click.option("--quick", is_flag=True, help="Speed: small pictures, one round: shows that it works.")
@click.option(
    "--memory", type=ByteCount(), metavar="BYTES", help="Speed: budget for one tile of a fit; default 256MiB."
)
@click.option("--report", "report_to", type=click.Path(), help="Speed: folder for tables and pictures.")
@engine_options
@device_option
@json_option
def bench(
    what: str | None,
    out: str | None,
    methods: tuple[str, ...] | None,
    degrees: tuple[int | str, ...] | None,
    codecs: tuple[str, ...] | None,
    rates: tuple[float, ...] | None,
    holdout: int | None,
    holdout_by: str | None,
    precision: str | None,
    size: int | None,
    lights: tuple[int, ...] | None,
    pattern: str | None,
    seed: int | None,
    albedo: str | None,
    material: str | None,
    force: bool,
    speed: bool,
    sizes: tuple[int, ...] | None,
    threads: tuple[int, ...] | None,
    rounds: int | None,
    quick: bool,
    memory: int | None,
    report_to: str | None,
    engine: str | None,
    jobs: int | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Measure a grid of methods, codecs and rates: sizes, PSNR and seconds.

    The results file is written after every row; the same command goes on where it stopped. A fit or a codec that
    refuses leaves a row with a note instead of numbers.

    With --speed it measures how fast the program is instead: the whole job beside NumPy, and single stages beside SciPy
    and PyWavelets. Sizes, lights, degrees and threads are varied one at a time; where some are given, only those.

    \b
    Example:
      clrelight bench ring --out results.h5
      clrelight bench stack.h5 --holdout 5 --methods cls,ceb --codecs none,wavelet --rates 1,2
      clrelight bench experiment.toml --out results.h5
      clrelight bench stack.h5 --methods uls,cls,ceb --out grid.h5 --jobs 2
      clrelight bench --speed --sizes 64,256,1024 --report speed
    """
    of_experiments = given(methods=methods, codecs=codecs, rates=rates, holdout=holdout, size=size)
    of_experiments.update(
        given(holdout_by=holdout_by, precision=precision, pattern=pattern, seed=seed, force=force or None)
    )
    of_experiments.update(given(albedo=albedo, material=material, engine=engine, jobs=jobs))
    of_speed = given(sizes=sizes, threads=threads, rounds=rounds, quick=quick or None, memory=memory, report=report_to)
    _check_kind(speed, what, of_experiments, of_speed)
    if speed:
        from clrelight.memory import DEFAULT_MEMORY
        from clrelight.speed.plan import choose_growth

        numbers = None if degrees is None else tuple(degree for degree in degrees if not isinstance(degree, str))
        if numbers != degrees:
            raise InputError("--speed times degrees that are numbers: leave auto out of --degrees")
        growth = choose_growth(quick=quick, rounds=rounds, size=sizes, lights=lights, degree=numbers, threads=threads)
        bench_speed(
            growth,
            out or DEFAULT_OUT,
            report=report_to,
            memory=memory or DEFAULT_MEMORY,
            device=device,
            as_json=as_json,
        )
    elif what is not None:
        synth = given(size=size, lights=_only_number("--lights", lights), pattern=pattern, seed=seed)
        synth.update(given(albedo=albedo, material=material))
        grid = given(methods=methods, degrees=degrees, codecs=codecs, rates=rates, holdout=holdout, precision=precision)
        grid.update(given(holdout_by=holdout_by))
        workers = (engine, jobs)
        bench_grid(what, out or "results.h5", grid, synth, workers, force=force, device=device, as_json=as_json)


def _check_kind(speed: bool, what: str | None, of_experiments: dict, of_speed: dict) -> None:
    """Raise an error unless the options are those of an experiment, or those of --speed."""
    if speed and what is not None:
        raise InputError(f"--speed makes its own pictures: leave out {what}")
    if not speed and what is None:
        raise click.UsageError(
            "Missing argument: a scene such as ring, STACK.h5 or EXPERIMENT.toml, or the option --speed"
        )
    if speed and of_experiments:
        raise InputError(
            f"--{next(iter(of_experiments)).replace('_', '-')} is an option of experiments, not of --speed"
        )
    if not speed and of_speed:
        raise InputError(f"--{next(iter(of_speed))} is an option of --speed")


def _only_number(option: str, numbers: tuple[int, ...] | None) -> int | None:
    if numbers is not None and (len(numbers) != 1 or numbers[0] < 1):
        raise InputError(f"{option} must be one number of at least 1, got {','.join(map(str, numbers))}")
    return None if numbers is None else numbers[0]


@click.command()
@click.argument("results_file", metavar="RESULTS", type=click.Path())
@click.option("--out", type=click.Path(), default="report", show_default=True, help="Folder for tables and pictures.")
@click.option("--stack", type=click.Path(), help="Photographs that a fit or an encoding is compared with.")
@click.option("--parquet", is_flag=True, help="Write all rows as rows.parquet too, beside rows.csv.")
@device_option
@json_option
def report(results_file: str, out: str, stack: str | None, parquet: bool, device: str | None, as_json: bool) -> None:
    """Write the tables and pictures of a results file, or of what --speed measured, and pages that show them.

    Of a fit or an encoding, beside the photographs of --stack: PSNR by light, and pictures side by side.

    report.html is one file that needs no other: tables that sort, charts, pictures side by side with their errors.
    Tables are written as Markdown, CSV and LaTeX, pictures as PNG, all rows as rows.csv, and report.md shows them.

    \b
    Example:
      clrelight report results.h5 --out report
      clrelight report results.h5 --out report --parquet
      clrelight report view.h5 --stack stack.h5 --out view
      clrelight report speed.json --out speed
    """
    if stack is not None:
        if parquet:
            raise InputError("--parquet is for results of experiments: leave out --stack")
        _report_file(results_file, stack, out, device, as_json)
        return
    if device is not None:
        raise InputError("--device is for a fit or an encoding beside its --stack: this computes nothing")
    if Path(results_file).suffix.lower() == ".json":
        from clrelight.speed.record import read_record
        from clrelight.speed.report import write_speed_report

        if parquet:
            raise InputError(f"--parquet is for results of experiments: {results_file} holds what --speed measured")
        files = write_speed_report(read_record(results_file), out)
    else:
        from clrelight.report import write_report
        from clrelight.report.records import check_parquet
        from clrelight.store import read_results

        if parquet:
            check_parquet()
        results = read_results(results_file)
        with progress_bar("drawing") as bar:
            files = write_report(results, out, parquet=parquet, progress=bar)
    if as_json:
        print_json({"folder": out, "files": [str(file) for file in files]})
        return
    pages = {"page": str(Path(out) / PAGE)} if any(file.name == PAGE for file in files) else {}
    print_facts({"report": str(Path(out) / files[0].name), **pages, "files": len(files)})


def _report_file(file: str, stack: str, out: str, device: str | None, as_json: bool) -> None:
    from clrelight.report.file_page import write_file_report

    told = make_report(as_json)
    with progress_bar("measuring") as bar:
        files = write_file_report(file, stack, out, device=device, progress=bar, report=told)
    told.facts |= {"folder": out, "files": [str(each) for each in files]}
    print_report(told, as_json, {"page": str(Path(out) / PAGE), "files": len(files), **psnr_lines(told.psnr)})


COMMANDS = (bench, report)
