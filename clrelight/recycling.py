"""Arrays in the memory of others that are gone: new memory costs the system a fault, and zeros, for every page."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.memory import ARRAY_MEMORY

_LEAST = 1 << 18
"""Bytes below which the C library recycles by itself."""
_KEPT = ARRAY_MEMORY // 2
"""Bytes that lie unused at most, see `kept_within`: what a codec needs of a map in memory and needs again for the next.
What was given back first goes first."""

_LINE = 64
"""Bytes of a line of the caches, and of the longest vectors."""
_SHARE = 4
"""Of a budget of memory, this part of it may lie unused."""

_unused: deque[NDArray[np.uint8]] = deque()
_bounds: list[int] = []
"""Of the budgets that are being kept to now."""


@contextmanager
def kept_within(memory_bytes: int) -> Iterator[None]:
    """Let no more lie unused, while the block runs, than a budget has room for beside what is in use.

    The least of several budgets counts: what lies unused belongs to nobody.
    """
    bound = memory_bytes // _SHARE
    _bounds.append(bound)
    _drop_beyond(bound)
    try:
        yield
    finally:
        _bounds.remove(bound)


def empty(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray:
    """Return an array whose values are undefined, as `numpy.empty` does.

    Once nothing refers to it or to a view of it, its memory is kept for the next array of about its size, or somewhat
    less; any thread may ask, and any may be the last to refer.
    """
    dtype = np.dtype(dtype)
    size = math.prod(shape) * dtype.itemsize
    if not is_kept(size):
        return _aligned(size).view(dtype).reshape(shape) if size > _KEPT else np.empty(shape, dtype)
    block = _take(_class_of(size))
    lease = (ctypes.c_ubyte * size).from_buffer(block.data)
    weakref.finalize(lease, _give_back, block).atexit = False
    return np.frombuffer(memoryview(lease), dtype).reshape(shape)


def is_kept(size: int) -> bool:
    """Return whether memory of so many bytes is used again."""
    return _LEAST <= size <= _KEPT


def zeros(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray:
    """Return zeros, as `numpy.zeros` does; what is too large to be kept is not there before it is used."""
    if math.prod(shape) * np.dtype(dtype).itemsize > _KEPT:
        return np.zeros(shape, dtype)
    made = empty(shape, dtype)
    made[...] = 0
    return made


def copied(array: NDArray) -> NDArray:
    """Return a copy, C-contiguous."""
    made = empty(array.shape, array.dtype)
    made[...] = array
    return made


def _class_of(size: int) -> int:
    """Return the next size of three leading bits: what differs by less than that shares memory."""
    step = 1 << max(size.bit_length() - 3, 0)
    return -(-size // step) * step


def _take(size: int) -> NDArray[np.uint8]:
    # Each step is whole under the interpreter's lock: no thread waits for another, not even for its own garbage.
    for looked_at in range(len(_unused)):
        try:
            block = _unused.pop()  # the last is the likeliest to be in a cache
        except IndexError:
            break
        if size <= block.size <= size + size // 2:
            _unused.rotate(-looked_at)  # what was given back first is to go first, as ever
            return block
        _unused.appendleft(block)
    return _aligned(size)


def _aligned(size: int) -> NDArray[np.uint8]:
    """Return new memory that begins where a line of the caches does: a kernel's vectors lie in one then, not in two."""
    block = np.empty(size + _LINE, np.uint8)
    return block[-block.ctypes.data % _LINE :][:size]


def _give_back(block: NDArray[np.uint8]) -> None:
    bound = min([_KEPT, *_bounds])
    if block.size <= bound:
        _unused.append(block)
        _drop_beyond(bound)


def _drop_beyond(bound: int) -> None:
    with suppress(IndexError):  # other threads took the rest meanwhile
        while sum(each.size for each in list(_unused)) > bound:
            _unused.popleft()
