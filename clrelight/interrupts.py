"""Ctrl-C, SIGTERM and SIGHUP end a command at once, and nothing unfinished is left behind.

Within `watch_interrupts` the first of them raises KeyboardInterrupt. Libraries swallow one that reaches them inside a
callback, so `raise_if_interrupted` repeats it. The next one does not wait for that: what is unfinished is removed, and
the process ends.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}


class _Watch:
    """What has come so far: the first signal, those put off by `holding`, and what is to be removed at the end."""

    def __init__(self) -> None:
        self.first = 0
        self.held = 0
        self.put_off: list[int] = []
        self.ended = False
        self.unfinished: dict[int, Callable[[], None]] = {}


_watch = _Watch()


@contextmanager
def watch_interrupts() -> Iterator[None]:
    """Take the signals while the block runs; SIGHUP not where it is ignored, as under nohup."""
    _watch.first, _watch.put_off, _watch.ended = 0, [], False
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [n for n in SIGNALS if n == signal.SIGINT or signal.getsignal(n) is not signal.SIG_IGN]
    before, hook = {number: signal.signal(number, _note) for number in numbers}, sys.unraisablehook
    # Python would print the swallowed one; it is repeated, so there is nothing to say yet.
    sys.unraisablehook = lambda event: None if event.exc_type is KeyboardInterrupt else hook(event)
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def raise_if_interrupted() -> None:
    """Raise KeyboardInterrupt if one came before and was swallowed; called wherever progress is told."""
    if _watch.first and not _watch.ended:
        raise KeyboardInterrupt


@contextmanager
def holding() -> Iterator[None]:
    """Put a signal off until the block ends, so that what it makes is noted, or what it removes is gone."""
    if threading.current_thread() is not threading.main_thread():  # the others never see one
        yield
        return
    _watch.held += 1
    try:
        yield
    finally:
        _watch.held -= 1
        if _watch.put_off and not _watch.held:
            _act(_watch.put_off.pop(0))


def at_end(remove: Callable[[], None]) -> int:
    """Have something removed if the program is ended while it is unfinished; return what `forget` takes."""
    key = id(remove)
    _watch.unfinished[key] = remove
    return key


def forget(key: int) -> None:
    """Leave alone what is finished, or removed already."""
    _watch.unfinished.pop(key, None)


def end_watch() -> tuple[int, str] | None:
    """Remove what is unfinished, and note no more signals; return the exit code and a line if there was one."""
    _watch.ended = True
    while _watch.unfinished:
        with suppress(OSError):
            _watch.unfinished.popitem()[1]()
    if not _watch.first:
        return None
    word = _WORDS[signal.Signals(_watch.first).name]
    return 128 + _watch.first, f"clrelight: {word}; files that were not finished are discarded"


def _note(number: int, frame: FrameType | None) -> None:
    if _watch.ended:
        return
    if _watch.held:
        _watch.put_off.append(number)
    else:
        _act(number)


def _act(number: int) -> None:
    if not _watch.first:
        _watch.first = number
        raise KeyboardInterrupt
    ending = end_watch()
    if ending is not None:
        with suppress(OSError):
            os.write(2, f"{ending[1]}\n".encode())
        os._exit(ending[0])
