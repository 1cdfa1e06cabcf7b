"""Where codecs take coefficients from and where they put them: whole arrays, or some rows or some maps at a time.

A codec that works in parts is written once, against `Source`, `BodyWriter` and `Target`. In memory all rows and all
maps are one part; the same calls on what lies in files take as much memory as a `Room` allows.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.finite import check_sums
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.matmul import multiply_columns
from clrelight.streaming import Buffer, reading_ahead

Shape = tuple[int, int, int, int]
"""(n_coeff, height, width, channel)."""
Progress = Callable[[int, int], object]
"""Told how much of how much is done."""
Result = TypeVar("Result")

PARTS = 4
"""Pieces of a budget: the part being read, the one being coded, what is made of it, and what that takes meanwhile."""


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


class Planes(Protocol):
    """Maps of float32, put and read some at a time, or some rows of all at a time."""

    shape: tuple[int, ...]

    def put_maps(self, first: int, maps: NDArray[np.float32]) -> None:
        """Put whole maps, from number `first` on; they must not change any more."""
        ...

    def put_rows(self, first: int, rows: NDArray[np.float32]) -> None:
        """Put rows of every map, from row `first` on."""
        ...

    def maps(self, first: int, end: int) -> NDArray[np.float32]:
        """Return some maps, not to be written to."""
        ...

    def read_rows_into(self, first: int, end: int, out: NDArray[np.float32]) -> None:
        """Read rows of every map into a C-contiguous array."""
        ...


class ArrayPlanes:
    """`Planes` in memory."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape
        self._values: NDArray[np.float32] | None = None

    def put_maps(self, first: int, maps: NDArray[np.float32]) -> None:
        """See `Planes`."""
        if maps.shape == self.shape:
            self._values = maps
        else:
            self.whole()[first : first + len(maps)] = maps

    def put_rows(self, first: int, rows: NDArray[np.float32]) -> None:
        """See `Planes`."""
        if rows.shape == self.shape:
            self._values = rows
        else:
            self.whole()[:, first : first + rows.shape[1]] = rows

    def maps(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Planes`."""
        return self.whole()[first:end]

    def read_rows_into(self, first: int, end: int, out: NDArray[np.float32]) -> None:
        """See `Planes`."""
        out[...] = self.whole()[:, first:end]

    def whole(self) -> NDArray[np.float32]:
        """Return everything; memory is taken when it is first needed."""
        if self._values is None:
            self._values = np.empty(self.shape, np.float32)
        return self._values


class Room:
    """Where intermediate maps lie, and how much memory parts may take: here all that they need."""

    memory_bytes = 1 << 30
    """Bytes that a codec which chooses the size of its parts may take for them."""

    def make_planes(self, shape: tuple[int, ...]) -> Planes:
        """Return maps of a shape, to be filled."""
        return ArrayPlanes(shape)

    def part_rows(self, shape: Shape, multiple: int) -> int:
        """Return how many rows of coefficients a part has: a multiple of some, or all."""
        return shape[1]

    def part_maps(self, shape: Shape) -> int:
        """Return how many maps a part has."""
        return shape[0]

    def tell(self, done: int, total: int) -> None:
        """Hear of progress."""


class BoundedRoom(Room):
    """A room whose parts keep to a number of bytes together.

    Parameters
    ----------
    memory_bytes : int
        Bytes for `PARTS` parts.
    progress : callable, optional
        Told how many rows or maps of a pass over them are done.
    """

    def __init__(self, memory_bytes: int, progress: Progress | None = None) -> None:
        self.memory_bytes, self._part_bytes = memory_bytes, memory_bytes // PARTS
        self.progress = progress

    def part_rows(self, shape: Shape, multiple: int) -> int:
        """See `Room`; InputError where not even the fewest rows fit."""
        n_coeff, height, width, channel = shape
        row_bytes = 4 * n_coeff * width * channel
        rows = self._part_bytes // row_bytes
        least = min(multiple, height)
        if rows < least:
            raise InputError(
                f"{least} row(s) of these coefficients, {PARTS} times, take {PARTS * least * row_bytes} bytes, "
                f"more than the memory budget {self.memory_bytes}"
            )
        return height if rows >= height else rows - rows % multiple

    def part_maps(self, shape: Shape) -> int:
        """See `Room`; at least one."""
        return min(max(self._part_bytes // (4 * math.prod(shape[1:])), 1), shape[0])

    def holds(self, n_bytes: int) -> bool:
        """Return whether as much is one part, beside which there is room for others."""
        return n_bytes <= self._part_bytes

    def tell(self, done: int, total: int) -> None:
        """See `Room`."""
        if self.progress is not None:
            self.progress(done, total)


def parts_of(count: int, step: int) -> list[slice]:
    """Return consecutive slices of ``range(count)``."""
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]


def _row_parts(room: Room, shape: Shape, multiple: int, row_step: int) -> list[slice]:
    """Return the rows of each part, which begin at a multiple of `multiple`, and of `row_step` where there is room."""
    step, together = room.part_rows(shape, multiple), math.lcm(multiple, row_step)
    if together <= step < shape[1]:
        step -= step % together
    return parts_of(shape[1], step)


class Source(ABC):
    """Finite float32 coefficients to encode.

    Attributes
    ----------
    shape : tuple of int
        (n_coeff, height, width, channel).
    device : Device
    room : Room
    """

    row_step = 1
    """Rows that are read together in any case."""

    def __init__(self, shape: Shape, device: Device, room: Room) -> None:
        self.shape, self.device, self.room = shape, device, room
        self._known: dict[Hashable, Any] = {}

    @abstractmethod
    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """Return rows of all maps, C-contiguous; what was returned two calls before may be overwritten."""

    @contextmanager
    def rows(self, multiple: int = 1) -> Iterator[Iterator[tuple[int, NDArray[np.float32]]]]:
        """Lend all rows in parts, each with its first row, which is a multiple of `multiple`."""
        height, parts = self.shape[1], _row_parts(self.room, self.shape, multiple, self.row_step)
        with reading_ahead(lambda part: self.read_rows(part.start, part.stop), parts) as read:

            def told() -> Iterator[tuple[int, NDArray[np.float32]]]:
                for part, coeffs_khwc in zip(parts, read, strict=True):
                    self.check(coeffs_khwc, part.start)
                    yield part.start, coeffs_khwc
                    self.room.tell(part.stop, height)

            yield told()

    def check(self, coeffs_khwc: NDArray[np.float32], first_row: int) -> None:  # noqa: B027 - most have no reason to
        """Raise InputError where rows that were read cannot be encoded."""

    def map_parts(self) -> list[slice]:
        """Return the parts in which maps are taken."""
        return parts_of(self.shape[0], self.room.part_maps(self.shape))

    def maps(self, first: int, end: int) -> NDArray[np.float32]:
        """Return some maps (end - first, height, width, channel), C-contiguous, not to be written to."""
        return self.remember("planes", self._as_planes).maps(first, end)

    def _as_planes(self) -> Planes:
        with self.rows() as parts:
            planes = self.room.make_planes(self.shape)
            for first, coeffs_khwc in parts:
                planes.put_rows(first, coeffs_khwc)
        return planes

    def whole(self) -> NDArray[np.float32]:
        """Return all maps."""
        coeffs_khwc = np.empty(self.shape, np.float32)
        with self.rows() as parts:
            for first, rows_khwc in parts:
                coeffs_khwc[:, first : first + rows_khwc.shape[1]] = rows_khwc
        return coeffs_khwc

    def mapped(self, operator_jk: NDArray[np.float64]) -> Source:
        """Return ``operator coefficients``; InputError, once they are taken, where float32 cannot hold them."""
        return _MappedSource(self, operator_jk)

    def remember(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """Return what `make` returns, made once: what predicting and encoding both need."""
        if key not in self._known:
            self._known[key] = make()
        found: Result = self._known[key]
        return found


class ArraySource(Source):
    """Coefficients in memory, C-contiguous."""

    def __init__(self, coeffs_khwc: NDArray[np.float32], device: Device) -> None:
        super().__init__(coeffs_khwc.shape, device, Room())
        self._coeffs = coeffs_khwc

    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Source`."""
        return self._coeffs[:, first:end]

    def maps(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Source`."""
        return self._coeffs[first:end]

    def whole(self) -> NDArray[np.float32]:
        """See `Source`."""
        return self._coeffs

    def mapped(self, operator_jk: NDArray[np.float64]) -> Source:
        """See `Source`."""
        return ArraySource(check_sums(_multiply(self.device, operator_jk, self._coeffs), self.device), self.device)


class _MappedSource(Source):
    """Sums of another source's maps."""

    def __init__(self, source: Source, operator_jk: NDArray[np.float64]) -> None:
        super().__init__((len(operator_jk), *source.shape[1:]), source.device, source.room)
        self._source, self._operator, self.row_step = source, operator_jk, source.row_step

    @contextmanager
    def rows(self, multiple: int = 1) -> Iterator[Iterator[tuple[int, NDArray[np.float32]]]]:
        """See `Source`; read in parts that suit what is read."""
        with self._source.rows(multiple) as parts:
            yield ((first, self._multiplied(coeffs_khwc)) for first, coeffs_khwc in parts)

    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Source`."""
        return self._multiplied(self._source.read_rows(first, end))

    def _multiplied(self, coeffs_khwc: NDArray[np.float32]) -> NDArray[np.float32]:
        return check_sums(_multiply(self.device, self._operator, coeffs_khwc), self.device)


def _multiply(device: Device, operator_jk: NDArray[np.float64], maps_khwc: NDArray[np.float32]) -> NDArray[np.float32]:
    product_jp = multiply_columns(device, operator_jk, maps_khwc.reshape(len(maps_khwc), -1))
    return product_jp.reshape(len(operator_jk), *maps_khwc.shape[1:])


class Target(ABC):
    """Where decoded coefficients go: rows from top to bottom, or maps in any order, then `finish`.

    Nothing takes memory before the first of them comes, so that decoders look at a body first.

    Attributes
    ----------
    shape : tuple of int
        (n_coeff, height, width, channel).
    room : Room
    """

    row_step = 1
    """Rows that are best put together."""

    def __init__(self, shape: Shape, room: Room) -> None:
        self.shape, self.room = shape, room
        self._planes: Planes | None = None

    def row_parts(self, multiple: int = 1) -> list[slice]:
        """Return the rows to put together, each part beginning at a multiple of `multiple`."""
        return _row_parts(self.room, self.shape, multiple, self.row_step)

    @abstractmethod
    def put_rows(self, first: int, coeffs_khwc: NDArray[np.float32]) -> None:
        """Take rows of all maps, C-contiguous, not to be changed any more."""

    def put_maps(self, first: int, maps_khwc: NDArray[np.float32]) -> None:
        """Take whole maps, not to be changed any more."""
        if self._planes is None:
            self._planes = self.room.make_planes(self.shape)
        self._planes.put_maps(first, maps_khwc)

    def finish(self) -> None:
        """Hand on what came as maps."""
        if self._planes is None:
            return
        n_coeff, _, width, channel = self.shape
        for part in self.row_parts():
            rows_khwc = np.empty((n_coeff, part.stop - part.start, width, channel), np.float32)
            self._planes.read_rows_into(part.start, part.stop, rows_khwc)
            self.put_rows(part.start, rows_khwc)

    def mapped(self, operator_kj: NDArray[np.float64], device: Device) -> Target:
        """Return a target for maps of which the operator makes coefficients; it is to be finished as well."""
        return _MappedTarget(self, operator_kj, device)


class ArrayTarget(Target):
    """Coefficients in memory."""

    def __init__(self, shape: Shape) -> None:
        super().__init__(shape, Room())
        self._array = ArrayPlanes(shape)

    def put_rows(self, first: int, coeffs_khwc: NDArray[np.float32]) -> None:
        """See `Target`."""
        self._array.put_rows(first, coeffs_khwc)

    def put_maps(self, first: int, maps_khwc: NDArray[np.float32]) -> None:
        """See `Target`."""
        self._array.put_maps(first, maps_khwc)

    def coeffs(self) -> NDArray[np.float32]:
        """Return what was put."""
        return self._array.whole()


class _MappedTarget(Target):
    """Maps that are summed up before another target takes them."""

    def __init__(self, target: Target, operator_kj: NDArray[np.float64], device: Device) -> None:
        super().__init__((operator_kj.shape[1], *target.shape[1:]), target.room)
        self._target, self._operator, self._device, self.row_step = target, operator_kj, device, target.row_step

    def put_rows(self, first: int, coeffs_khwc: NDArray[np.float32]) -> None:
        """See `Target`."""
        self._target.put_rows(first, _multiply(self._device, self._operator, coeffs_khwc))

    def row_parts(self, multiple: int = 1) -> list[slice]:
        """See `Target`; as coefficients take them, which are no fewer."""
        return self._target.row_parts(multiple)


def buffers() -> Iterator[Buffer]:
    """Return two buffers, in turns."""
    return itertools.cycle([Buffer(), Buffer()])
