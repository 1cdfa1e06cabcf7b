"""Ctrl-C that is not lost: libraries swallow a KeyboardInterrupt that reaches them inside a callback."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_seen = threading.Event()


@contextmanager
def watch_interrupts() -> Iterator[None]:
    """Remember an interrupt while the block runs, so that `raise_if_interrupted` can repeat it."""
    _seen.clear()
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before, hook = signal.signal(signal.SIGINT, _note), sys.unraisablehook
    # Python would print the swallowed one; it is repeated, so there is nothing to say yet.
    sys.unraisablehook = lambda event: None if event.exc_type is KeyboardInterrupt else hook(event)
    try:
        yield
    finally:
        sys.unraisablehook = hook
        signal.signal(signal.SIGINT, before)


def raise_if_interrupted() -> None:
    """Raise KeyboardInterrupt if one came before and was swallowed; called wherever progress is told."""
    if _seen.is_set():
        raise KeyboardInterrupt


def _note(number: int, frame: FrameType | None) -> None:
    _seen.set()
    raise KeyboardInterrupt
