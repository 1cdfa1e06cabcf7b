"""A file on another machine as one that is read here, of which little is fetched and nothing twice."""

from __future__ import annotations

import io
from bisect import bisect_right, insort
from collections.abc import Iterable, Iterator

from clrelight.errors import RemoteError
from clrelight.remote.server import Answer, Server

_FIRST_BYTES = 1 << 15
"""What the first request is for: HDF5's records and the tables of a payload, in most files."""
_BLOCK_BYTES = 1 << 12
_MOST_AHEAD = 1 << 22
"""Reading goes ahead by a block, and twice as far each time it goes on where it was; no further than this."""
_NEAR_BYTES = 1 << 13
"""Ranges that are less apart are fetched as one: about what a request costs in time."""
_HELD_BYTES = 1 << 26
"""Bytes that are kept, beside those in use."""


class RangedFile:
    """A file behind a URL; also what `h5py.File` takes for a file.

    Parameters
    ----------
    url : str

    Attributes
    ----------
    size : int
        Bytes of the file.
    fetched_bytes, requests : int
        What was fetched so far, and in how many requests.

    Raises
    ------
    RemoteError
        In one line that names the file, whenever it cannot be read, or is not the one any more that it was at first.
    """

    def __init__(self, url: str) -> None:
        self._url, self._server = url, Server(url)
        self.fetched_bytes = self.requests = self._held = self._at = self._last = 0
        self._ahead = _BLOCK_BYTES
        self._starts: list[int] = []
        self._pieces: dict[int, bytes] = {}  # in the order of their coming
        first = self._get(0, _FIRST_BYTES)
        self.size, self._stamp = first.size, first.stamp
        self._keep(0, first.content)

    def close(self) -> None:
        """End the connection."""
        self._server.close()

    def read_at(self, start: int, end: int) -> bytes:
        """Return bytes `start` to `end`, or to where the file ends before."""
        end = min(end, self.size)
        if start >= end:
            return b""
        if next(self._missing(start, end), None) is not None:
            self._forget()
            ahead = self._reach(start, end)
            content = bytearray(self._held_parts(start, end))
            for gap in list(self._missing(*ahead)):
                piece = self._fetch(*gap)
                _copy(piece, gap[0], content, start)
            return bytes(content)
        return bytes(self._held_parts(start, end))

    def prefetch(self, ranges: Iterable[tuple[int, int]]) -> None:
        """Fetch ranges that are asked for next, those near each other at once."""
        gaps = [gap for start, end in sorted(ranges) for gap in self._missing(start, min(end, self.size))]
        runs: list[tuple[int, int]] = []
        for start, end in gaps:
            if runs and start <= runs[-1][1] + _NEAR_BYTES:
                runs[-1] = runs[-1][0], max(end, runs[-1][1])
            else:
                runs.append((start, end))
        self._forget()
        for run in runs:
            for gap in list(self._missing(*run)):
                self._fetch(*gap)

    def _reach(self, start: int, end: int) -> tuple[int, int]:
        """Return whole blocks, and those ahead of who reads on."""
        self._ahead = min(2 * self._ahead, _MOST_AHEAD) if self._last - _BLOCK_BYTES <= start <= self._last else 0
        self._ahead = max(self._ahead, _BLOCK_BYTES)
        first = start // _BLOCK_BYTES * _BLOCK_BYTES
        self._last = min(max(first + self._ahead, -(-end // _BLOCK_BYTES) * _BLOCK_BYTES), self.size)
        return first, self._last

    def _missing(self, start: int, end: int) -> Iterator[tuple[int, int]]:
        """Yield the parts of a range that are not held."""
        place = max(bisect_right(self._starts, start) - 1, 0)
        while start < end:
            begin = self._starts[place] if place < len(self._starts) else end
            if start < begin:
                yield start, min(begin, end)
            if begin < end:
                start = max(start, begin + len(self._pieces[begin]))
            else:
                return
            place += 1

    def _held_parts(self, start: int, end: int) -> bytearray:
        content = bytearray(end - start)
        for place in range(max(bisect_right(self._starts, start) - 1, 0), len(self._starts)):
            begin = self._starts[place]
            if begin >= end:
                break
            _copy(self._pieces[begin], begin, content, start)
        return content

    def _fetch(self, start: int, end: int) -> bytes:
        answer = self._get(start, end)
        if (answer.size, answer.stamp) != (self.size, self._stamp):
            raise RemoteError(f"{self._url} changed while it was read: begin again")
        self._keep(start, answer.content)
        return answer.content

    def _get(self, start: int, end: int) -> Answer:
        answer = self._server.get(start, end)
        self.requests += 1
        self.fetched_bytes += len(answer.content)
        return answer

    def _keep(self, start: int, content: bytes) -> None:
        if content:
            insort(self._starts, start)
            self._pieces[start] = content
            self._held += len(content)

    def _forget(self) -> None:
        """Let the oldest go."""
        while self._held > _HELD_BYTES:
            oldest = next(iter(self._pieces))
            self._held -= len(self._pieces.pop(oldest))
            self._starts.remove(oldest)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """See `io.RawIOBase`."""
        self._at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self.size}[whence]
        return self._at

    def tell(self) -> int:
        """See `io.RawIOBase`."""
        return self._at

    def read(self, size: int = -1) -> bytes:
        """See `io.RawIOBase`."""
        content = self.read_at(self._at, self.size if size < 0 else self._at + size)
        self._at += len(content)
        return content

    def readinto(self, buffer: memoryview) -> int:
        """See `io.RawIOBase`."""
        content = self.read(len(buffer))
        buffer[: len(content)] = content
        return len(content)

    def flush(self) -> None:
        """See `io.RawIOBase`; nothing is ever written."""


def _copy(piece: bytes, begin: int, content: bytearray, start: int) -> None:
    """Copy what of a piece, which begins somewhere in the file, lies in a range from `start` on."""
    first, end = max(begin, start), min(begin + len(piece), start + len(content))
    if first < end:
        content[first - start : end - start] = piece[first - begin : end - begin]
