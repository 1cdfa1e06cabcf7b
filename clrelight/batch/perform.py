"""Do one task in this process, and say what became of it: what every engine's workers run."""

from __future__ import annotations

import functools
import os
import socket
import time
import traceback
from collections.abc import Mapping
from typing import Any

from clrelight.batch.fingerprint import code_digest, look_at, read_content, take_fingerprint
from clrelight.batch.task import DONE, FAILED, Outcome, Task
from clrelight.batch.verbs import find_verb
from clrelight.errors import BusyError, DeviceError, InputError, KernelBuildError
from clrelight.jobs.farm import ChoreError, Farm
from clrelight.jobs.pictures import list_pictures
from clrelight.jobs.report import Progress, Report

_WAIT_SECONDS = 10.0


def perform(
    given: Mapping[str, Any],
    key: str,
    code: str,
    device: str | None,
    progress: Progress | None = None,
    farm: Farm | None = None,
    report: Report | None = None,
) -> dict[str, Any]:
    """Do a task and return its outcome, both as JSON; whatever the job raises is a failure of this task.

    Parameters
    ----------
    given : mapping
        `Task.to_json`.
    key : str
        Of the task, as the driver has it.
    code : str
        The driver's `code_digest`: a worker with other code refuses, or results would hang on who made them.
    device : str, optional
        As ``--device`` names it.
    progress : callable, optional
        Told how far the job is, as a `Report`'s reader is.
    farm : Farm, optional
        What does parts of the job.
    report : Report, optional
        Filled; else its own.
    """
    since = time.perf_counter()
    task, worker = Task.from_json(given), worker_name()
    report = Report() if report is None else report
    try:
        if code_digest() != code:
            raise InputError(f"{worker} has another clrelight than the batch: install the same there")
        inputs, outputs = _work(task, device, report, progress, farm)
        outcome = Outcome(
            task.name,
            DONE,
            key,
            inputs=inputs,
            outputs=outputs,
            psnr={name: float(value) for name, value in report.psnr.items()},
            stages={name: round(float(value), 6) for name, value in report.seconds.items()},
            notes=tuple(report.notes),
        )
    except Exception as error:
        outcome = Outcome(task.name, FAILED, key, **_told(error))
    told = outcome.to_json()
    told |= {"seconds": round(time.perf_counter() - since, 6), "worker": worker, "device": report.device or ""}
    return told


def worker_name() -> str:
    """Return machine and process of this worker."""
    return f"{socket.gethostname()}:{os.getpid()}"


def _work(
    task: Task, device: str | None, report: Report, progress: Progress | None, farm: Farm | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Do the job; return fingerprints of what was read and written."""
    before = {path: look_at(path) for path in task.inputs}
    if task.out:
        _make_folders(task)
    filled = _run(task, device, report, progress, farm)
    if isinstance(filled, Mapping) and not report.psnr:  # of a job that returns its decibels
        report.psnr = dict(filled)
    inputs = {}
    for path, seen in before.items():
        known = task.known.get(path, {})
        if known.get("stat") == seen[2]:
            inputs[path] = dict(known)
        else:  # of files that were just read the contents are in memory still
            inputs[path] = {"bytes": seen[0], "files": seen[1], "stat": seen[2], "content": _content_of(path, seen[2])}
        if look_at(path) != seen:
            raise InputError(f"{path} has changed while it was read: do it again")
    return inputs, {path: take_fingerprint(path).to_json() for path in outputs_of(task)}


@functools.lru_cache(maxsize=64)
def _content_of(path: str, seen: str) -> str:
    """Return the digest of what lies at a path and looks as it did; the tiles of one stack ask for it once."""
    return read_content(path)


def _run(task: Task, device: str | None, report: Report, progress: Progress | None, farm: Farm | None) -> Any:
    """Do the job, after waiting for one who is still at it: a worker whose driver is gone, say, soon is too."""
    end = time.monotonic() + _WAIT_SECONDS
    while True:
        try:
            return find_verb(task.job).run(task, device, report, progress, farm)
        except BusyError:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)


def outputs_of(task: Task) -> list[str]:
    """Return every file and folder that a task writes."""
    verb = find_verb(task.job)
    more = [str(task.options[name]) for name in verb.writes if task.options.get(name)]
    # A fit in tiles that stay where they are is not whole without them.
    tiles = [str(task.options["shards"])] if task.options.get("virtual") else []
    outs = [task.out] if task.out else []
    return [*(list_pictures(task.out) if verb.writes_many and task.out else outs), *more, *tiles]


def _make_folders(task: Task) -> None:
    for path in outputs_of(task):
        try:
            os.makedirs(os.path.dirname(path) or ".", exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def _told(error: Exception) -> dict[str, Any]:
    """Return kind and line of what a job raised; of a bug, the traceback too."""
    if isinstance(error, DeviceError):
        return {"kind": "device", "error": _line(error)}
    if isinstance(error, ChoreError):
        return {"kind": error.kind, "error": _line(error)}
    if isinstance(error, InputError):
        return {"kind": "input", "error": _line(error)}
    if isinstance(error, MemoryError):
        return {"kind": "input", "error": f"out of memory ({_line(error)}); ask for less at once (memory, degree)"}
    if isinstance(error, OSError):
        place = f"{os.fsdecode(error.filename)}: " if error.filename else ""
        return {"kind": "input", "error": f"{place}{error.strerror or error}"}
    kind = "device" if isinstance(error, KernelBuildError) else "bug"
    return {"kind": kind, "error": f"{type(error).__name__}: {_line(error)}", "trace": traceback.format_exc()}


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:1000]
