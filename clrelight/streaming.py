"""Go through more than memory holds: the next piece is read and the last one written while the caller computes.

Reading and writing HDF5 wait for each other (h5py has one lock) but not for kernels, which run without Python's lock.
"""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from typing import TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight import recycling
from clrelight.interrupts import SIGNALS

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def reading_ahead(read: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Iterator[Result]]:
    """Lend the results of `read` for each item in turn, the next of them being read while the caller has one.

    While the caller has result n, n + 1 is being read, and n + 2 is not begun: two buffers in turns are enough. What
    `read` raises comes where its result would have; the thread has ended when the block has.
    """
    if len(items) < 2:
        yield map(read, items)
        return
    with one_thread() as pool, closing(_results(pool, read, items)) as results:
        yield results


def _results(
    pool: ThreadPoolExecutor, read: Callable[[Item], Result], items: Sequence[Item]
) -> Generator[Result, None, None]:
    pending = pool.submit(read, items[0])
    for following in items[1:]:
        result = pending.result()
        pending = pool.submit(read, following)
        yield result
    yield pending.result()


@contextmanager
def writing_behind(write: Callable[[Item], None]) -> Iterator[Callable[[Item], None]]:
    """Lend a function that begins to write an item in a thread, once the one before is written.

    While the caller makes item n + 1, n is being written and n - 1 is done with: two buffers in turns are enough. What
    `write` raises comes with the next item, or at the end of the block; the thread has ended when the block has.
    """
    pending: Future[None] | None = None
    with one_thread() as pool:

        def put(item: Item) -> None:
            nonlocal pending
            if pending is not None:
                pending.result()
            pending = pool.submit(write, item)

        yield put
        if pending is not None:
            pending.result()


class Buffer:
    """Memory that tiles use one after another; it grows to the largest, which is the first."""

    def __init__(self) -> None:
        self._bytes = np.empty(0, np.uint8)

    def lend(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray:
        """Return an array in this memory, its values undefined; what was lent before is overwritten."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if size > self._bytes.size:
            self._bytes = recycling.empty((size,), np.uint8)
        return self._bytes[:size].view(dtype).reshape(shape)


def write_at(descriptor: int, content: memoryview, place: int) -> None:
    """Write every byte of what is C-contiguous at a place of a file; OSError as the system says."""
    rest = content
    while rest:
        done = os.pwrite(descriptor, rest, place)
        rest, place = rest[done:], place + done


def one_thread() -> ThreadPoolExecutor:
    """Return an executor of one thread, which leaves Ctrl-C and its like to the main one."""
    return some_threads(1)


def some_threads(most: int) -> ThreadPoolExecutor:
    """Return an executor of up to `most` threads, one a processor, which leave Ctrl-C and its like to the main one."""
    count = max(1, min(most, os.cpu_count() or 1))
    return ThreadPoolExecutor(count, thread_name_prefix="clrelight-io", initializer=_leave_interrupts)


def _leave_interrupts() -> None:
    # They must wake the main thread, which may be waiting for this one.
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
