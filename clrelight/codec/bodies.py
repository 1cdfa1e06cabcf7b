"""What a payload holds behind its header: bytes, or what gives or takes bytes a part at a time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


class Body(Protocol):
    """Payload and side tables to decode: bytes, or what is read when sliced."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> bytes: ...


def columns_of(body: Body, count: int, first: int, end: int) -> NDArray[np.uint8]:
    """Return bytes `first` to `end` of each of `count` equal parts of a body, (count, end - first), aligned."""
    size = len(body) // count
    if (first, end) == (0, size):
        return np.require(np.frombuffer(body[:], np.uint8).reshape(count, size), requirements="A")
    parts_nb = np.empty((count, end - first), np.uint8)
    for i, part in enumerate(parts_nb):
        part[:] = np.frombuffer(body[i * size + first : i * size + end], np.uint8)
    return parts_nb


@runtime_checkable
class FarBody(Body, Protocol):
    """A body that is not at hand: parts that are asked for next are better fetched together."""

    def prefetch(self, parts: Sequence[tuple[int, int]]) -> None:
        """Fetch what lies between the first byte and the end of each part."""
        ...


def expect_parts(body: Body, parts: Sequence[tuple[int, int]]) -> None:
    """Say which parts of a body are asked for next."""
    if isinstance(body, FarBody):
        body.prefetch(parts)


class _Rest:
    """What of a body stands behind its first bytes."""

    def __init__(self, body: Body, start: int) -> None:
        self._body, self._start = body, start

    def __len__(self) -> int:
        return len(self._body) - self._start

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(len(self))
        return self._body[self._start + start : self._start + stop]


class _Front:
    """The first bytes of a body."""

    def __init__(self, body: Body, end: int) -> None:
        self._body, self._end = body, end

    def __len__(self) -> int:
        return self._end

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(self._end)
        return self._body[start:stop]

    def prefetch(self, parts: Sequence[tuple[int, int]]) -> None:
        """See `FarBody`."""
        expect_parts(self._body, parts)


def front_of(body: Body, end: int) -> Body:
    """Return the first bytes of a body."""
    return body[:end] if isinstance(body, bytes) else _Front(body, end)


def rest_of(body: Body, start: int) -> Body:
    """Return what of a body stands behind its first `start` bytes."""
    return body[start:] if isinstance(body, bytes) else _Rest(body, start)


class BodyWriter(ABC):
    """A body being written: what leads it, its size, then its bytes at any place and in any order."""

    def __init__(self) -> None:
        self._head = b""

    def lead(self, head: bytes) -> None:
        """Put bytes in front; places count from behind them."""
        self._head += head

    def reserve(self, n_bytes: int) -> None:
        """Say how many bytes come behind those that lead; before the first is written."""
        self._allocate(len(self._head) + n_bytes)
        if self._head:
            self._put(0, np.frombuffer(self._head, np.uint8))

    def write(self, at: int, values: NDArray) -> None:
        """Write a C-contiguous array's bytes."""
        self._put(len(self._head) + at, values.reshape(-1).view(np.uint8))

    def write_all(self, content: bytes) -> None:
        """Reserve and write everything."""
        self.reserve(len(content))
        if content:
            self.write(0, np.frombuffer(content, np.uint8))

    def write_columns(self, size: int, first: int, parts_nb: NDArray) -> None:
        """Write row i of a C-contiguous array from byte ``i size + first`` on."""
        flat_nb = parts_nb.reshape(len(parts_nb), -1).view(np.uint8)
        if flat_nb.shape[1] == size:
            self.write(0, flat_nb)
            return
        for i, part in enumerate(flat_nb):
            self.write(i * size + first, part)

    @abstractmethod
    def _allocate(self, n_bytes: int) -> None: ...

    @abstractmethod
    def _put(self, at: int, values_b: NDArray[np.uint8]) -> None: ...


class MemoryBody(BodyWriter):
    """A body that becomes bytes."""

    def __init__(self) -> None:
        super().__init__()
        self._bytes = np.empty(0, np.uint8)

    def to_bytes(self) -> bytes:
        """Return what was written."""
        return self._bytes.tobytes()

    def _allocate(self, n_bytes: int) -> None:
        self._bytes = np.empty(n_bytes, np.uint8)

    def _put(self, at: int, values_b: NDArray[np.uint8]) -> None:
        if values_b.size == self._bytes.size:
            self._bytes = values_b  # all of it: copied once, to bytes
        else:
            self._bytes[at : at + values_b.size] = values_b
