"""The experiment of one stack of a batch."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.experiment import paper_experiment, run_experiment
from clrelight.experiment.grid import PAPER_METHODS
from clrelight.jobs.farm import Chore, Farm
from clrelight.jobs.report import Report
from clrelight.results import NO_CODEC, Results
from clrelight.store import read_results, write_results

_CODECS = (NO_CODEC, "half", "s3tc", "uniform", "wavelet")


def bench(
    source: str,
    *,
    out: str | os.PathLike[str],
    methods: str | Sequence[str] = PAPER_METHODS,
    degrees: str | int | Sequence[int | str] = (6,),
    codecs: str | Sequence[str] = _CODECS,
    rates: str | float | Sequence[float] | None = None,
    holdout: int | None = None,
    holdout_by: str = "index",
    precision: str = "mixed",
    force: bool = False,
    device: str | None = None,
    report: Report,
    farm: Farm | None = None,
) -> Report:
    """Measure a grid of fits and codecs of one stack, as ``clrelight bench`` does, into a results file.

    Rows that the file holds are not measured again, unless it is begun anew by `force`. Lists may be texts with
    commas. With a farm, its processes take a method of a degree each, into a new file. InputError as of
    `experiment.run_experiment`.
    """
    asked = paper_experiment(
        source,
        methods=tuple(map(str, _listed(methods))),
        degrees=tuple(_whole(each) for each in _listed(degrees)),
        codecs=tuple(map(str, _listed(codecs))),
        rates=None if rates is None else tuple(float(each) for each in _listed(rates)),
        holdout=holdout,
        holdout_by=holdout_by,
        precision=precision,
    )
    if farm is None:
        opened = open_device(device)
        report.device = opened.info.label
        results = run_experiment(asked, out, device=opened, force=force, tell=report.note)
    else:
        given = {"codecs": codecs, "rates": rates, "holdout": holdout, "holdout_by": holdout_by, "precision": precision}
        models = [{"methods": [m], "degrees": [d]} for m in _listed(methods) for d in _listed(degrees)]
        if os.path.lexists(out) and not force:
            raise InputError(f"{os.fsdecode(out)} is there: one process adds rows to it, several begin anew (--force)")
        results = _gathered(source, out, [{**given, **model} for model in models], report, farm)
    report.facts = {"file": os.fsdecode(out), "rows": len(results.table)}
    return report


def _gathered(
    source: str, out: str | os.PathLike[str], parts: list[dict[str, Any]], report: Report, farm: Farm
) -> Results:
    """Have parts of a grid measured, and put their rows one after another, as one process does."""
    stack = os.path.abspath(os.fsdecode(source))
    chores, paths = [], []
    for number, part in enumerate(parts):
        given = {name: list(each) if isinstance(each, tuple) else each for name, each in part.items()}
        chores.append(Chore("bench", stack, {name: each for name, each in given.items() if each is not None}))
        paths.append(os.path.join(farm.folder, f"bench-{number:04}.h5"))
    report.note(*farm.write(list(zip(chores, paths, strict=True)), "measuring"))
    found = [read_results(path) for path in paths]
    pictures: dict[str, NDArray[np.uint8]] = {}
    profiles: dict[str, NDArray[np.float64]] = {}
    for each in found:  # of what two parts have the first counts, as in one process
        pictures = {**pictures, **{name: each.pictures[name] for name in each.pictures if name not in pictures}}
        profiles = {**profiles, **{name: each.profiles[name] for name in each.profiles if name not in profiles}}
    results = Results(np.concatenate([each.table for each in found]), pictures=pictures, profiles=profiles)
    write_results(out, results)
    return results


def _listed(value: object) -> list:
    if isinstance(value, str):
        return [part.strip() for part in value.split(",") if part.strip()]
    return list(value) if isinstance(value, list | tuple) else [value]


def _whole(value: object) -> int | str:
    text = str(value)
    return int(text) if text.lstrip("-").isdigit() else text
