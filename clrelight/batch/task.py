"""What is to be done to one stack, and what became of it: records that travel as JSON between processes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

DONE, FAILED = "done", "failed"


@dataclass(frozen=True)
class Task:
    """One job on one stack.

    Attributes
    ----------
    name : str
        Of the stack, by which the journal and the table know it: its path below the folder, without an ending.
    job : str
        A key of `verbs.VERBS`.
    source : str
        The stack: a file, or a folder of photographs.
    out : str
        The file or folder that the job writes; empty for a job that only measures.
    options : mapping
        Of the job, as its verb takes them; JSON values.
    inputs : tuple of str
        Files and folders that the result hangs on: the source, and those that options name.
    known : mapping of str to Fingerprint as JSON
        Of inputs, what the driver knows of them: who finds one as it was does not read it to know it.
    near : str
        As of `clrelight.jobs.farm.Chore`: an engine may give it to the worker that had such a one.
    """

    name: str
    job: str
    source: str
    out: str
    options: Mapping[str, Any] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    known: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    near: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return what `from_json` takes."""
        return asdict(self)

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> Task:
        """Return the task of what `to_json` gave."""
        return cls(**{**given, "inputs": tuple(given["inputs"])})


@dataclass(frozen=True)
class Outcome:
    """What became of a task.

    Attributes
    ----------
    name : str
    state : str
        ``"done"`` or ``"failed"``.
    key : str
        Digest of job, options and code, by which a later run knows whether it would do the same
        (`fingerprint.task_key`).
    error : str
        The one line that says why it failed.
    kind : str
        What failed: ``"input"`` (what the user gave), ``"device"``, ``"died"`` (the process), ``"late"`` (the time was
        up) or ``"bug"``; empty where it is done.
    inputs, outputs : mapping of str to Fingerprint as JSON
        What was read and written; empty where it failed.
    psnr : mapping of str to float
        Decibels, as a `Report` has them.
    seconds : float
        All of it, by a clock that nobody sets.
    stages : mapping of str to float
        Seconds per stage.
    notes : tuple of str
    device, worker : str
    tries : int
        How often it was begun.
    trace : str
        Of a bug, the traceback.
    """

    name: str
    state: str
    key: str = ""
    error: str = ""
    kind: str = ""
    inputs: Mapping[str, Any] = field(default_factory=dict)
    outputs: Mapping[str, Any] = field(default_factory=dict)
    psnr: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    stages: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    device: str = ""
    worker: str = ""
    tries: int = 1
    trace: str = ""

    @property
    def is_done(self) -> bool:
        """Whether the result is there."""
        return self.state == DONE

    @property
    def bytes_written(self) -> int | None:
        """Bytes of all that it wrote; None where there is no such thing."""
        return sum(int(each["bytes"]) for each in self.outputs.values()) if self.outputs else None

    def is_sound(self) -> bool:
        """Return whether every field holds what it should, as of a record that somebody else may have written."""
        texts = (self.name, self.key, self.error, self.kind, self.device, self.worker, self.trace, *self.notes)
        numbers = (self.seconds, self.tries, *self.stages.values(), *self.psnr.values())
        counts = (each.get("bytes", 0) for each in (*self.inputs.values(), *self.outputs.values()))
        return (
            self.state in (DONE, FAILED)
            and all(isinstance(text, str) for text in texts)
            and all(type(number) in (int, float) for number in numbers)
            and all(type(count) is int for count in counts)
        )

    def to_json(self) -> dict[str, Any]:
        """Return what `from_json` takes, JSON without infinities; what holds nothing is left out."""
        held = asdict(self) | {"psnr": {name: _plain(value) for name, value in self.psnr.items()}}
        return {name: value for name, value in held.items() if value not in ("", {}, (), [])}

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> Outcome:
        """Return the outcome of what `to_json` gave."""
        psnr = {name: math.nan if value is None else float(value) for name, value in given.get("psnr", {}).items()}
        return cls(**{**given, "psnr": psnr, "notes": tuple(given.get("notes", ()))})


def _plain(value: float) -> float | str | None:
    if math.isfinite(value):
        return float(value)
    return None if math.isnan(value) else str(float(value))
