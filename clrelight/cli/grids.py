"""The grid of a ``clrelight bench``: measured by this process, or by workers, and printed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clrelight.cli.engines import is_shared, run_shared
from clrelight.cli.output import print_facts, print_json, print_notes
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.experiment import Experiment
    from clrelight.results import Results


def bench_grid(
    what: str,
    out: str,
    grid: dict,
    synth: dict,
    workers: tuple[str | None, int | None],
    *,
    force: bool,
    device: str | None,
    as_json: bool,
) -> None:
    """Measure a scene, a stack or what a file says; `workers` are an engine and how many."""
    from clrelight.device import open_device
    from clrelight.experiment import run_experiment
    from clrelight.experiment.scenes import read_notes
    from clrelight.jobs.report import Report
    from clrelight.report import summary_rows
    from clrelight.store import check_output, read_results
    from datasets_synth.scenes import SCENES

    experiment = _experiment(what, grid, synth)
    check_output(out, [what])
    taken = read_notes(experiment)
    told: list[str] = []
    with progress_bar("bench") as bar:
        if is_shared(*workers):
            if what in SCENES:
                raise InputError(
                    f"workers share the grid of a file, {what} is none: synth it, or name it in an EXPERIMENT.toml"
                )
            shared = Report(tell=told.append)
            run_shared("bench", what, out, {**grid, "force": force}, *workers, device, bar, shared)
            results = read_results(out)
        else:
            results = run_experiment(
                experiment,
                out,
                device=open_device(device),
                force=force,
                progress=lambda step, done, total: bar(done, total, step),
                tell=told.append,
            )
    if as_json:
        print_json({"file": out, "rows": _rows(results), "notes": taken + told})
        return
    print_notes(taken + told + _notes(results))
    print_table(
        *summary_rows(results), expendable=("encode (s)", "fit (s)", "noise, predicted (dB)", "noise (dB)", "kB")
    )
    print_facts({"results": out, "next": f"clrelight report {out} --out report"})


def _experiment(what: str, grid: dict, synth: dict) -> Experiment:
    from clrelight.experiment import load_experiment, paper_experiment
    from datasets_synth.scenes import SCENES, scenes_with

    for option in synth:
        if what not in scenes_with(option):
            owners = scenes_with(option)
            kind = f"the {owners[0]} scene" if len(owners) == 1 else f"the scenes {', '.join(owners)}"
            raise InputError(f"--{option} is an option of {kind}, not of {what}")
    if what in SCENES:
        return paper_experiment(what, synth=synth, **grid)
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
