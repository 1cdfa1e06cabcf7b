"""The experiment of one stack of a batch, or of a file that says what to measure."""

from __future__ import annotations

import inspect
import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.experiment import Experiment, load_experiment, paper_experiment, run_experiment
from clrelight.experiment.grid import PAPER_METHODS
from clrelight.experiment.scenes import check_names
from clrelight.jobs.farm import Chore, Farm
from clrelight.jobs.report import Report
from clrelight.results import NO_CODEC, Results
from clrelight.store import read_results, write_results
from datasets_synth.scenes import SCENES

_CODECS = (NO_CODEC, "half", "s3tc", "uniform", "wavelet")


BENCH_PART = "bench-part"
_ALL = -1


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
    commas. An experiment's ``.toml`` as the source says all of this itself. With a farm, its processes take a method of
    a degree each, of what is rendered a method, into a new file. InputError as of `experiment.run_experiment`.
    """
    asked = {"methods": methods, "degrees": degrees, "codecs": codecs, "rates": rates, "holdout": holdout}
    asked |= {"holdout_by": holdout_by, "precision": precision}
    experiment = _experiment(source, asked)
    if farm is None:
        opened = open_device(device)
        report.device = opened.info.label
        results = run_experiment(experiment, out, device=opened, force=force, tell=report.note)
    else:
        if os.path.lexists(out) and not force:
            raise InputError(f"{os.fsdecode(out)} is there: one process adds rows to it, several begin anew (--force)")
        check_names(experiment)
        results = _gathered(source, experiment, asked, out, report, farm)
    report.facts = {"file": os.fsdecode(out), "rows": len(results.table)}
    return report


def bench_part(
    source: str,
    *,
    out: str | os.PathLike[str],
    some: Sequence[int],
    asked: Mapping[str, Any],
    device: str | None = None,
    report: Report,
) -> Report:
    """Measure a part of what `bench` does: of some scene, method and degree, by their numbers; -1 are all degrees."""
    experiment, (scene, method, degree) = _experiment(source, asked), some
    name = experiment.scenes[scene]
    part = replace(
        experiment,
        scenes=(name,),
        synth={name: experiment.synth[name]} if name in experiment.synth else {},
        methods=(experiment.methods[method],),
        degrees=experiment.degrees if degree == _ALL else (experiment.degrees[degree],),
    )
    opened = open_device(device)
    report.device = opened.info.label
    run_experiment(part, out, device=opened, force=True, tell=report.note)
    return report


def _experiment(source: str, asked: Mapping[str, Any]) -> Experiment:
    if os.path.splitext(os.fsdecode(source))[1].lower() == ".toml":
        for name, value in asked.items():
            if value is not None and _plain(value) != _plain(_USUAL[name]):
                raise InputError(f"{name}: {os.fsdecode(source)} says itself what to measure")
        return load_experiment(source)
    rates = asked["rates"]
    return paper_experiment(
        source,
        methods=tuple(map(str, _listed(asked["methods"]))),
        degrees=tuple(_whole(each) for each in _listed(asked["degrees"])),
        codecs=tuple(map(str, _listed(asked["codecs"]))),
        rates=None if rates is None else tuple(float(each) for each in _listed(rates)),
        holdout=asked["holdout"],
        holdout_by=asked["holdout_by"],
        precision=asked["precision"],
    )


def _parts_of(experiment: Experiment) -> list[tuple[int, int, int]]:
    """Return parts in the order of their rows; what is rendered is for each, so it has few."""
    parts = []
    for number, scene in enumerate(experiment.scenes):
        degrees = [_ALL] if scene in SCENES else range(len(experiment.degrees))
        parts += [(number, *rest) for rest in itertools.product(range(len(experiment.methods)), degrees)]
    return parts


def _gathered(
    source: str,
    experiment: Experiment,
    asked: Mapping[str, Any],
    out: str | os.PathLike[str],
    report: Report,
    farm: Farm,
) -> Results:
    """Have parts of a grid measured, and put their rows one after another, as one process does."""
    place, given = os.path.abspath(os.fsdecode(source)), {name: _plain(value) for name, value in asked.items()}
    chores = []
    for number, some in enumerate(_parts_of(experiment)):
        scene = experiment.scenes[some[0]]
        reads = () if scene in SCENES or os.path.abspath(scene) == place else (os.path.abspath(scene),)
        chore = Chore(BENCH_PART, place, {"some": list(some), "asked": given}, reads)
        chores.append((chore, os.path.join(farm.folder, f"bench-{number:04}.h5")))
    report.note(*farm.write(chores, "measuring"))
    found = [read_results(path) for _, path in chores]
    pictures: dict[str, NDArray[np.uint8]] = {}
    profiles: dict[str, NDArray[np.float64]] = {}
    for each in found:  # of what two parts have the first counts, as in one process
        pictures = {**pictures, **{name: each.pictures[name] for name in each.pictures if name not in pictures}}
        profiles = {**profiles, **{name: each.profiles[name] for name in each.profiles if name not in profiles}}
    results = Results(np.concatenate([each.table for each in found]), pictures=pictures, profiles=profiles)
    write_results(out, results)
    return results


_USUAL = {name: each.default for name, each in inspect.signature(bench).parameters.items()}


def _plain(value: object) -> object:
    """Return what JSON makes of a value."""
    return list(value) if isinstance(value, tuple) else value


def _listed(value: object) -> list:
    if isinstance(value, str):
        return [part.strip() for part in value.split(",") if part.strip()]
    return list(value) if isinstance(value, list | tuple) else [value]


def _whole(value: object) -> int | str:
    text = str(value)
    return int(text) if text.lstrip("-").isdigit() else text
