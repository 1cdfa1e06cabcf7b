"""The experiment of one stack of a batch."""

from __future__ import annotations

import os
from collections.abc import Sequence

from clrelight.device import open_device
from clrelight.experiment import paper_experiment, run_experiment
from clrelight.experiment.grid import PAPER_METHODS
from clrelight.jobs.report import Report
from clrelight.results import NO_CODEC

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
    device: str | None = None,
    report: Report,
) -> Report:
    """Measure a grid of fits and codecs of one stack, as ``clrelight bench`` does, into a results file.

    Rows that the file holds are not measured again. Lists may be texts with commas. InputError as of
    `experiment.run_experiment`.
    """
    opened = open_device(device)
    report.device = opened.info.label
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
    results = run_experiment(asked, out, device=opened, tell=report.note)
    report.facts = {"file": os.fsdecode(out), "rows": len(results.table)}
    return report


def _listed(value: object) -> list:
    if isinstance(value, str):
        return [part.strip() for part in value.split(",") if part.strip()]
    return list(value) if isinstance(value, list | tuple) else [value]


def _whole(value: object) -> int | str:
    text = str(value)
    return int(text) if text.lstrip("-").isdigit() else text
