"""One job on one stack by the workers of an engine: what ``--engine`` of a command does."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from clrelight.batch.engine import Engine
from clrelight.batch.farmed import FOLDER, run_farmed
from clrelight.batch.journal import Journal
from clrelight.batch.run import JOURNAL, Batch, check_engine
from clrelight.batch.task import Task
from clrelight.batch.tiles import FARMED, run_tiles
from clrelight.batch.verb import Verb
from clrelight.batch.verbs import find_verb
from clrelight.durable import check_output
from clrelight.errors import InputError
from clrelight.fit import FitMethod
from clrelight.jobs.farm import ChoreError
from clrelight.jobs.inputs import lend_encoded, path_text
from clrelight.jobs.report import Progress, Report, report_for
from clrelight.jobs.sizes import size_facts
from clrelight.remote import is_remote

_PARTS = "parts"
_LEFT = (JOURNAL, "summary.csv", "summary.json")


def run_single(
    job: str,
    source: str | os.PathLike[str],
    out: str | os.PathLike[str] | None,
    *,
    options: Mapping[str, Any] | None = None,
    engine: str | Callable[[int], Engine] = "local",
    workers: int | None = None,
    device: str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Do a job on one stack, with parts done by an engine's workers: the file that the job alone would write.

    What is done stands in the folder ``NAME.shards`` beside `out` until all is: after a kill, the same call goes on.
    Of a job that only measures it lies beside `source`.

    Parameters
    ----------
    job : str
        One of `clrelight.batch.tiles.FARMED`, or ``"decode"``.
    source : path
    out : path or None
        None for a job that only measures.
    options : mapping, optional
        Of the job, as it takes them in Python.
    engine, workers, device
        As of `clrelight.batch.run.run_batch`.
    progress, report
        As of `clrelight.jobs.fit.fit`.

    Returns
    -------
    Report
        As of the job.

    Raises
    ------
    InputError
        As of the job; or if a part fails, a worker's end among them, or the engine cannot be had.
    """
    kept = report_for(report)
    verb = find_verb(job)
    given = _plain_options(verb, options or {})
    verb.check(given)
    place = path_text(source, "a file or folder")
    files = [name for name in (*verb.reads, *verb.writes) if isinstance(given.get(name), str)]
    _check_here([place, *(given[name] for name in files if name in verb.reads)])
    if isinstance(engine, str):
        check_engine(engine, workers)
    target = "" if out is None else os.path.abspath(path_text(out, "a file to write"))
    given |= {name: os.path.abspath(given[name]) for name in files}
    if target and os.path.splitext(target)[1] == FOLDER:
        raise InputError(f"{target}: parts of the work lie in a folder of such a name, choose another ending")
    if target and verb.ending:
        check_output(path_text(out, "a file to write"), [] if os.path.isdir(place) else [place])
    inputs = (os.path.abspath(place), *(given[name] for name in files if name in verb.reads))
    beside = os.path.splitext(target or inputs[0])[0]
    folder, task = Path(beside + FOLDER), Task(os.path.basename(beside), job, inputs[0], target, given, inputs)
    settings: dict[str, Any] = {
        "engine": engine,
        "workers": workers,
        "device": device,
        "keep_going": True,
        "progress": progress,
        "report": Report(),  # of a part that fails the error tells
        "shards": lambda _: str(folder / _PARTS),
    }
    try:
        if job in FARMED:
            made = run_farmed([task], folder, reports={task.name: kept}, redo=True, **settings)
        else:
            made = run_tiles([task], folder, **settings)
    except (KeyboardInterrupt, InputError):
        _leave(folder, kept)
        raise
    if made.failed:
        _leave(folder, kept)
    _raise_failures(made)
    _remove(folder)
    if job not in FARMED:
        _tell_joined(kept, inputs[0], target, settings["report"])
    if target:
        _name_as_given(kept.facts, path_text(out, "a file to write"), target)
    for name in verb.writes:
        if isinstance(kept.facts.get(name), dict):
            kept.facts[name] |= {"file": os.fsdecode((options or {})[name])}
    return kept


def _raise_failures(made: Batch) -> None:
    for each in made.failed:
        if each.kind == "bug":
            raise RuntimeError(f"{each.error}\n{each.trace}")
        raise ChoreError(each.error, each.kind)


def _tell_joined(report: Report, source: str, target: str, told: Report) -> None:
    """Report what a job does alone that tasks of rows have done: its facts on the files, and what tasks took."""
    with lend_encoded(source, Report(), parts=True) as packed:
        report.facts |= {"file": target, **size_facts(packed.encoded)}
    report.seconds, report.device = told.seconds, told.device


def _name_as_given(facts: dict[str, Any], given: str, target: str) -> None:
    """Name what was written as it was asked for, not as the workers know it."""
    base, known = os.path.dirname(given), os.path.dirname(target)
    if "files" in facts:
        facts["files"] = [os.path.join(base, os.path.relpath(each, known)) for each in facts["files"]]
    facts |= {name: given for name in ("file", "folder") if name in facts}


def _check_here(paths: Sequence[str]) -> None:
    """Raise InputError where workers find no file of such a name."""
    for path in paths:
        if is_remote(path):
            raise InputError(f"workers read files of their own machine, {path} is none: fetch it first")
        if not os.path.exists(path):
            raise InputError(f"there is no file or folder {path}")


def _plain_options(verb: Verb, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return those options that are given, as JSON has them."""
    given: dict[str, Any] = {}
    for name, value in options.items():
        if isinstance(value, FitMethod):
            given |= {name: value.id, **_plain_options(verb, value.to_config())}
        elif isinstance(value, os.PathLike):
            given[name] = os.fsdecode(value)
        elif isinstance(value, np.ndarray):
            given[name] = value.tolist()
        elif isinstance(value, tuple):
            given[name] = json.loads(json.dumps(value))
        elif value is not None and (value is not False or verb.is_on(name)):
            given[name] = value
    return given


def _leave(folder: Path, report: Report) -> None:
    """Say that parts which are done stay for the same call; where none is, leave nothing."""
    try:
        journal = Journal(folder / JOURNAL)
    except InputError:  # somebody else has begun
        return
    is_begun = any(each.is_done for each in journal.outcomes.values())
    if not is_begun:
        _remove(folder)
    journal.close()
    if is_begun:
        report.note(f"what is done stays in {folder}: the same command goes on from there; else remove it")


def _remove(folder: Path) -> None:
    """Remove what lies in the folder of ours, and the folder where nothing else does."""
    shutil.rmtree(folder / _PARTS, ignore_errors=True)
    with suppress(OSError):
        for name in _LEFT:
            (folder / name).unlink(missing_ok=True)
        folder.rmdir()
