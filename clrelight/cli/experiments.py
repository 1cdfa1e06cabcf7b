"""``clrelight bench`` and ``report``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from clrelight.cli.options import Names, Numbers, device_option, given, holdout_option, json_option, whole_number
from clrelight.cli.output import print_facts, print_json, print_notes
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.experiment import Experiment
    from clrelight.results import Results


@click.command()
@click.argument("what", metavar="ring|STACK.h5|EXPERIMENT.toml")
@click.option("--out", type=click.Path(), default="results.h5", show_default=True, help="Results file.")
@click.option("--methods", type=Names(), help="Fits, such as uls,cls; default: the paper's four.")
@click.option("--degrees", type=Numbers(int, "4,6"), help="SH degrees; default 6.")
@click.option("--codecs", type=Names(), help="Codecs; default none,half,s3tc,uniform,wavelet.")
@click.option("--rates", type=Numbers(float, "0.5,1,2"), help="Bits per coefficient of codecs that take a rate.")
@holdout_option("the fits")
@click.option("--size", type=whole_number(8, 1 << 16), help="Ring: width and height; default 256.")
@click.option("--lights", type=whole_number(1, 1 << 20), help="Ring: number of lights; default 256.")
@click.option("--pattern", help="Ring: uniform, grid or scattered.")
@click.option("--seed", type=whole_number(0), help="Ring: seed; default 0.")
@click.option("--force", is_flag=True, help="Start anew although the results file exists.")
@device_option
@json_option
def bench(
    what: str,
    out: str,
    methods: tuple[str, ...] | None,
    degrees: tuple[int, ...] | None,
    codecs: tuple[str, ...] | None,
    rates: tuple[float, ...] | None,
    holdout: int | None,
    size: int | None,
    lights: int | None,
    pattern: str | None,
    seed: int | None,
    force: bool,
    device: str | None,
    as_json: bool,
) -> None:
    """Measure a grid of methods, codecs and rates: sizes, PSNR and seconds.

    The results file is written after every row; the same command goes on where it stopped. A fit or a codec that
    refuses leaves a row with a note instead of numbers.

    \b
    Example:
      clrelight bench ring --out results.h5
      clrelight bench stack.h5 --holdout 5 --methods cls,ceb --codecs none,wavelet --rates 1,2
      clrelight bench experiment.toml --out results.h5
    """
    from clrelight.device import open_device
    from clrelight.experiment import run_experiment
    from clrelight.report import summary_rows
    from clrelight.store import check_output

    ring = given(size=size, lights=lights, pattern=pattern, seed=seed)
    grid = given(methods=methods, degrees=degrees, codecs=codecs, rates=rates, holdout=holdout)
    experiment = _experiment(what, grid, ring)
    check_output(out, [what])
    with progress_bar("bench") as bar:
        results = run_experiment(
            experiment,
            out,
            device=open_device(device),
            force=force,
            progress=lambda step, done, total: bar(done, total, step),
        )
    if as_json:
        print_json({"file": out, "rows": _rows(results)})
        return
    print_notes(_notes(results))
    print_table(*summary_rows(results), expendable=("encode (s)", "fit (s)", "kB"))
    print_facts({"results": out, "next": f"clrelight report {out} --out report"})


def _experiment(what: str, grid: dict, ring: dict) -> Experiment:
    from clrelight.experiment import RING, load_experiment, paper_experiment

    if what == RING:
        return paper_experiment(RING, ring=ring, **grid)
    if ring:
        raise InputError(f"--{next(iter(ring))} is an option of the ring scene, not of {what}")
    if Path(what).suffix.lower() == ".toml":
        if grid:
            raise InputError(f"--{next(iter(grid))}: {what} says itself what to measure")
        return load_experiment(what)
    return paper_experiment(what, **grid)


def _rows(results: Results) -> list[dict]:
    names = results.table.dtype.names or ()
    return [{name: row[name] for name in names} for row in results.table]


def _notes(results: Results) -> list[str]:
    """Return the notes of the rows, each once for all the codecs that have it."""
    codecs: dict[tuple[str, ...], list[str]] = {}
    for row in results.table:
        scene, method, codec, note = (row[name].decode() for name in ("scene", "method", "codec", "note"))
        if note:
            codecs.setdefault((scene, method, str(row["degree"]), note), []).append(codec)
    return [
        f"{scene}, {method} degree {degree}, {', '.join(dict.fromkeys(names))}: {note}"
        for (scene, method, degree, note), names in codecs.items()
    ]


@click.command()
@click.argument("results_file", metavar="RESULTS", type=click.Path())
@click.option("--out", type=click.Path(), default="report", show_default=True, help="Folder for tables and pictures.")
@json_option
def report(results_file: str, out: str, as_json: bool) -> None:
    """Write the tables (Markdown, CSV, LaTeX) and pictures (PNG) of a results file.

    \b
    Example:
      clrelight report results.h5 --out report
    """
    from clrelight.report import write_report
    from clrelight.store import read_results

    results = read_results(results_file)
    with progress_bar("drawing") as bar:
        files = write_report(results, out, progress=bar)
    if as_json:
        print_json({"folder": out, "files": [str(file) for file in files]})
        return
    print_facts({"report": str(Path(out) / "report.md"), "files": len(files)})


COMMANDS = (bench, report)
