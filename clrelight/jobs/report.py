"""What a job tells: a report for the one who asked for one, notes while it works, and how far it is."""

from __future__ import annotations

import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clrelight.described import describe

Progress = Callable[[int, int | None, str], object]
"""Told how much of how much of which stage is done; how much there is may not be known yet."""

_PACKAGE = str(Path(__file__).resolve().parents[1])


class Note(UserWarning):
    """What the command line prints as a note; a verb that is handed no `Report` warns of it."""


@dataclass(repr=False)
class Report:
    """What a job did and what it cost: of ``--json``, the object.

    Attributes
    ----------
    facts : dict
        What the verb itself has to tell, such as ``method`` and ``condition``, or ``encoded_bytes``; and ``file`` or
        ``files``, where it wrote any.
    psnr : dict of str to float
        ``mean_fitted``, ``pooled_fitted`` in decibel, and ``mean_holdout``, ``pooled_holdout`` where lights are held
        out; empty where nothing was measured.
    seconds : dict of str to float
        Per stage.
    notes : list of str
        What the user should know.
    device : str, optional
        Where it was computed.
    tell : callable, optional
        Told each note as it arises.
    """

    facts: dict[str, Any] = field(default_factory=dict)
    psnr: dict[str, float] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    device: str | None = None
    tell: Callable[[str], object] | None = field(default=None, repr=False, compare=False)

    def add(self, stage: str, since: float) -> float:
        """Add the time since `since` to a stage, and return now."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now

    def note(self, *notes: str) -> None:
        """Keep notes and tell them, each once."""
        for each in notes:
            if each in self.notes:
                continue
            self.notes.append(each)
            if self.tell is not None:
                self.tell(each)

    def __repr__(self) -> str:
        """Return what was done, one thing a line, as the command line and notebooks show it."""
        lines = {name: value if isinstance(value, str) else describe(value) for name, value in self.facts.items()}
        lines |= {f"psnr {name}": f"{value:.2f} dB" for name, value in self.psnr.items()}
        if self.seconds:
            lines["seconds"] = f"{sum(self.seconds.values()):.2f}"
        if self.device is not None:
            lines["device"] = self.device
        width = max(map(len, lines), default=0)
        told = [f"  {name:<{width}}  {value}" for name, value in lines.items()]
        return "\n".join(["Report", *told, *(f"  note: {note}" for note in self.notes)])

    def to_json(self) -> dict[str, Any]:
        """Return what ``--json`` prints."""
        measured = {"psnr": self.psnr} if self.psnr else {}
        return {**self.facts, **measured, "notes": self.notes, "seconds": self.seconds, "device": self.device}


def report_for(report: Report | None) -> Report:
    """Return the report that a job fills: the caller's, or a new one whose notes are warned of."""
    return Report(tell=_warn) if report is None else report


def _warn(note: str) -> None:
    # At the line that called the package, whatever lies between it and here.
    level = 1
    for depth, (frame, _) in enumerate(traceback.walk_stack(sys._getframe()), start=1):
        if frame.f_code.co_filename.startswith(_PACKAGE):
            level = depth + 1
    warnings.warn(note, Note, stacklevel=level)


@contextmanager
def stage(progress: Progress | None, what: str) -> Iterator[Callable[[int, int], None]]:
    """Tell that a stage begins, lend what tells how much of how much of it is done, and tell its end."""
    if progress is None:
        yield lambda done, total: None
        return
    last: tuple[int, int | None] = 0, None

    def tell(done: int, total: int) -> None:
        nonlocal last
        last = done, total
        progress(done, total, what)

    progress(*last, what)
    yield tell
    progress(*last, what)  # who watches for interrupts that libraries swallow repeats them here
