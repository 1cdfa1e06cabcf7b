"""Run an experiment row by row; a results file that exists goes on where it stopped."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from clrelight.device import Device, open_device
from clrelight.durable import claiming, no_locks
from clrelight.experiment.bench import Bench
from clrelight.experiment.grid import Experiment
from clrelight.experiment.row import row_key
from clrelight.experiment.scenes import check_names, open_scene, scene_name
from clrelight.holdout import describe_distance
from clrelight.results import ROW_DTYPE, Results
from clrelight.store import check_output, read_results, write_results
from datasets_synth.scenes import SCENES

Progress = Callable[[str, int, int], None]


def run_experiment(
    experiment: Experiment,
    out: str | os.PathLike[str],
    *,
    device: Device | None = None,
    progress: Progress | None = None,
    force: bool = False,
    tell: Callable[[str], None] | None = None,
) -> Results:
    """Measure every row of an experiment; rows that `out` holds already are kept, not measured again.

    Parameters
    ----------
    experiment : Experiment
    out : path
        Results file; written whole after every row.
    device : Device, optional
    progress : callable, optional
        Called with what is being done, rows done, and rows in all.
    force : bool
        Start anew although `out` exists.
    tell : callable, optional
        Called with what the user should know.

    Returns
    -------
    Results
        The table with the rows in the experiment's order, and rows of earlier experiments before them. A fit or a
        codec that refuses leaves a row too, with the reason as its note and NaN for what could not be measured.

    Raises
    ------
    InputError
        If a scene or `out` cannot be used, another program has `out`, two scenes have one name, or `out` holds rows of
        another stack of the same name.
    """
    check_output(out, [scene for scene in experiment.scenes if scene not in SCENES])
    check_names(experiment)
    # Rows are added to what was read: of two experiments on one file, each would write over the other's.
    with claiming(out) as is_claimed:
        if tell is not None and not is_claimed:
            tell(no_locks(out))
        return _measure_rows(experiment, out, device or open_device(), earlier_results(out, force), progress, tell)


def _measure_rows(
    experiment: Experiment,
    out: str | os.PathLike[str],
    device: Device,
    results: Results,
    progress: Progress | None,
    tell: Callable[[str], None] | None,
) -> Results:
    done = {row_key(row) for row in results.table}
    report = progress or (lambda what, count, total: None)
    planned = list(itertools.product(experiment.methods, experiment.degrees, experiment.codecs))
    count = 0
    for scene in experiment.scenes:
        rendering = partial(_report_part, report, count, experiment.row_count, scene)
        report(f"open {scene_name(scene)}", count, experiment.row_count)
        with open_scene(scene, experiment, progress=rendering) as stack:
            bench = Bench(stack, experiment, device, experiment.synth.get(scene, {}).get("seed", 0))
            bench.check_earlier(results, out)
            if tell is not None and len(bench.held):
                tell(f"{stack.name}: {describe_distance(stack.directions_i3, bench.fitted, bench.held)}")
            for method, degree, setting in planned:
                identity = bench.identity(method, degree, setting)
                if row_key(identity) not in done:
                    what = f"{stack.name}: {getattr(method, 'title', method)} degree {degree}, {setting.picture_name}"
                    report(what, count, experiment.row_count)
                    results = bench.measure(results, identity, method, degree, setting)
                    write_results(out, results)
                    done.add(row_key(identity))
                count += 1
    report("done", count, experiment.row_count)
    return results


def earlier_results(out: str | os.PathLike[str], force: bool) -> Results:
    """Return the results that `out` holds; none where it is not there, or to start anew."""
    return read_results(out) if Path(out).exists() and not force else Results(np.empty(0, ROW_DTYPE))


def _report_part(report: Progress, count: int, total: int, scene: str, part: int, parts: int) -> None:
    report(f"render {scene}, {part} of {parts}", count, total)
