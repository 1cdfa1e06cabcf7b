"""The process of a local worker: a line of JSON in, a task done, lines of JSON out.

It ends when the driver closes its end of the pipe, as the system does for one that was killed: what is not finished is
removed, and the process is gone within some seconds.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
import time
from typing import IO, Any

from clrelight.interrupts import end_watch, raise_if_interrupted, watch_interrupts

_EVERY_SECONDS = 0.5
_GRACE_SECONDS = 1.0


def main() -> None:
    """Do tasks until the driver has no more, or is no more."""
    # What libraries print must not mix with what we tell.
    telling = os.fdopen(os.dup(1), "w", encoding="ascii")
    os.dup2(2, 1)
    code = 0
    try:
        with watch_interrupts():
            _work(telling, _lines_of(sys.stdin))
    except BaseException as error:
        ending = end_watch()
        if ending is None and not isinstance(error, BrokenPipeError):
            raise
        code = ending[0] if ending else 1
    end_watch()
    if code:
        os._exit(code)


def _work(telling: IO[str], lines: queue.Queue[str | None]) -> None:
    # Now, for NumPy's threads would take signals that only the watching one is to get.
    from clrelight.batch.perform import perform

    _loaded.set()
    last = 0.0

    def tell(done: int, total: int | None, what: str) -> None:
        nonlocal last
        raise_if_interrupted()
        if (now := time.monotonic()) - last >= _EVERY_SECONDS:
            last = now
            _print(telling, {"at": f"{what} {done} of {total}" if total else what})

    while (line := lines.get()) is not None:
        work = json.loads(line)
        _busy.set()
        if _left.is_set():  # who gave it does not wait for it
            return
        outcome = perform(work["task"], work["key"], work["code"], work["device"], tell)
        raise_if_interrupted()
        _busy.clear()
        _print(telling, {"outcome": outcome})


_loaded, _busy, _left = threading.Event(), threading.Event(), threading.Event()
"""Whether there is something that could be unfinished, whether there is, and whether the driver is gone."""


def _print(telling: IO[str], message: dict[str, Any]) -> None:
    telling.write(json.dumps(message) + "\n")
    telling.flush()


def _lines_of(stream: IO[str]) -> queue.Queue[str | None]:
    """Return lines as they come, then None; where that is in the midst of a task, the task is ended as by SIGTERM."""
    lines: queue.Queue[str | None] = queue.Queue()

    def read() -> None:
        for line in stream:
            lines.put(line)
        if not _loaded.is_set():
            os._exit(1)  # loading what nobody will ask for takes seconds
        _left.set()  # before it is looked whether there is a task: one that begins now sees it
        lines.put(None)
        while _busy.is_set():
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(_GRACE_SECONDS)

    threading.Thread(target=read, name="clrelight-driver", daemon=True).start()
    return lines
