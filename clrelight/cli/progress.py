"""Progress on a terminal."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from clrelight.cli.quiet import is_quiet
from clrelight.interrupts import raise_if_interrupted

_PATIENCE_SECONDS = 1.0


class ProgressBar:
    """A bar on standard error where that is a terminal, shown once the work has taken a second."""

    def __init__(self, what: str) -> None:
        self._state: dict[str, Any] = {"description": what, "completed": 0, "total": None}
        self._bar: Any = None
        self._closed = False
        self._lock = threading.Lock()
        # A timer shows the bar also while a long step has nothing to report yet.
        self._timer = threading.Timer(_PATIENCE_SECONDS, self._open)
        self._timer.daemon = True
        if sys.stderr.isatty() and not is_quiet():
            self._timer.start()

    def __call__(self, done: int, total: int | None, what: str | None = None) -> None:
        """Show that `done` of `total` is done; KeyboardInterrupt where one was swallowed before."""
        raise_if_interrupted()
        with self._lock:
            self._state.update({"completed": done, "total": total})
            if what is not None:
                self._state["description"] = what
            if self._bar is not None:
                self._bar.update(self._bar.task_ids[0], **self._state)

    def _open(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
        from rich.table import Column

        text = TextColumn("{task.description}", table_column=Column(no_wrap=True, overflow="ellipsis"))
        with self._lock:
            if self._closed:
                return
            self._bar = Progress(
                text,
                BarColumn(bar_width=24),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.add_task(**self._state)
            self._bar.start()

    def close(self) -> None:
        """Take the bar away."""
        self._timer.cancel()
        with self._lock:
            self._closed = True
            if self._bar is not None:
                with suppress(OSError):  # a terminal may go away
                    self._bar.stop()


@contextmanager
def progress_bar(what: str) -> Iterator[ProgressBar]:
    """Show a bar while the block runs."""
    bar = ProgressBar(what)
    try:
        yield bar
        raise_if_interrupted()
    finally:
        bar.close()
