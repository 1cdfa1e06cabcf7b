"""Ctrl-C, SIGTERM and SIGHUP end a command at once, and nothing unfinished is left behind.

Within `watch_interrupts` the first of them raises KeyboardInterrupt. Libraries swallow one that reaches them inside a
callback, so `raise_if_interrupted` repeats it. The next one does not wait for that: what is unfinished is removed, and
the process ends.

One thread waits for these signals, and all others have them blocked: LLVM, which compiles kernels, has handlers of its
own, which remove its files and print that there was an error. That thread wakes the main one by a signal of ours.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_WAKE = getattr(signal, "SIGRTMIN", None)  # not on macOS
_GRACE_SECONDS = 2.0
"""After the second signal, for a main thread that runs no Python: a driver that hangs, say."""
_WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}


class _Watch:
    """What has come so far: the first signal, those put off by `holding`, and what is to be removed at the end."""

    def __init__(self) -> None:
        self.first = 0
        self.last = 0
        self.held = 0
        self.put_off: list[int] = []
        self.ended = False
        self.unfinished: dict[int, Callable[[], None]] = {}


_watch = _Watch()


@contextmanager
def watch_interrupts() -> Iterator[None]:
    """Take the signals while the block runs; SIGHUP not where it is ignored, as under nohup.

    The first may come, as KeyboardInterrupt, before the block is entered or when it has just ended.
    """
    _watch.first, _watch.put_off, _watch.ended = 0, [], False
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [n for n in SIGNALS if n == signal.SIGINT or signal.getsignal(n) is not signal.SIG_IGN]
    hook = sys.unraisablehook
    # Python would print the swallowed one; it is repeated, so there is nothing to say yet.
    sys.unraisablehook = lambda event: None if event.exc_type is KeyboardInterrupt else hook(event)
    try:
        with _handled(numbers) if _WAKE is None else _awaited(numbers, _WAKE):
            yield
    finally:
        sys.unraisablehook = hook


@contextmanager
def _handled(numbers: list[int]) -> Iterator[None]:
    before = {number: signal.signal(number, lambda number, frame: _note(number)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _awaited(numbers: list[int], wake: int) -> Iterator[None]:
    handler = signal.signal(wake, lambda number, frame: _note(_watch.last))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    main, ending = threading.get_ident(), threading.Event()

    def wait() -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, [wake])
        count = 0
        while not ending.is_set():
            number = signal.sigwait([*numbers, wake])
            if number == wake or _watch.ended:
                continue
            count, _watch.last = count + 1, number
            signal.pthread_kill(main, wake)
            if count > 1 and not ending.wait(_GRACE_SECONDS):
                _end_at_once()

    waiter = threading.Thread(target=wait, name="clrelight-signals", daemon=True)
    try:
        with holding():  # half a start could not be undone
            waiter.start()
        yield
    finally:
        ending.set()
        if waiter.ident is not None:
            signal.pthread_kill(waiter.ident, wake)
        waiter.join()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(wake, handler)


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


def _note(number: int) -> None:
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
    _end_at_once()


def _end_at_once() -> None:
    _watch.first = _watch.first or _watch.last
    ending = end_watch()
    if ending is not None:
        with suppress(OSError):
            os.write(2, f"{ending[1]}\n".encode())
        os._exit(ending[0])
