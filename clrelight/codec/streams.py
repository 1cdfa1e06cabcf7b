"""Where codecs take coefficients from and where they put them: whole arrays, or some rows or some maps at a time.

A codec that works in parts is written once, against `Source`, `BodyWriter` and `Target`. In memory all rows and all
maps are one part; the same calls on what lies in files take as much memory as a `Workspace` allows.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH
from clrelight.codec.finite import check_sums
from clrelight.codec.workspace import ArrayPlanes, Planes, Shape, Workspace
from clrelight.device import Device
from clrelight.matmul import SampleCurve, multiply_columns
from clrelight.streaming import reading_ahead
from clrelight.tiles import read_rows_into, row_tiles

if TYPE_CHECKING:
    from clrelight.codec.formats.klt_tiles import TileCoder

Result = TypeVar("Result")


def parts_of(count: int, step: int) -> list[slice]:
    """Return consecutive slices of ``range(count)``."""
    return [slice(*part) for part in row_tiles((0, count), step)]


def _row_parts(workspace: Workspace, shape: Shape, multiple: int, row_step: int) -> list[slice]:
    """Return the rows of each part, which begin at a multiple of `multiple`, and of `row_step` where it fits."""
    step, together = workspace.part_rows(shape, multiple), math.lcm(multiple, row_step)
    if together <= step < shape[1]:
        step -= step % together
    return parts_of(shape[1], step)


@dataclass(frozen=True)
class Linear:
    """How coefficients are made of the samples that a source reads: ``synthesis analysis curve(samples)``.

    Attributes
    ----------
    analysis_ri : ndarray, shape (rank, n_sample), float64
    synthesis_kr : ndarray, shape (n_coeff, rank), float64
    curve : SampleCurve
        Turns samples into radiance; its scale is in the analysis.
    """

    analysis_ri: NDArray[np.float64]
    synthesis_kr: NDArray[np.float64]
    curve: SampleCurve


class Source(ABC):
    """Finite float32 coefficients to encode.

    Attributes
    ----------
    shape : tuple of int
        (n_coeff, height, width, channel).
    device, workspace : Device, Workspace
    """

    row_step = 1
    """Rows that are read together in any case."""
    linear: Linear | None = None
    """How coefficients hang on samples, where there is no more to it and `read_samples` gives those."""
    sample_type: np.dtype = np.dtype(np.float32)
    """Of those."""
    basis: str = SH
    """What coefficients are of (`clrelight.bases`)."""
    in_memory: NDArray[np.float32] | None = None  # all of them, C-contiguous: a device may read parts in place
    lights_i3: NDArray[np.float64] | None = None  # that they were fitted to, where these are known
    elsewhere: TileCoder | None = None
    """What codes tiles of them in other processes, where there are such; their bytes are the same."""

    def __init__(self, shape: Shape, device: Device, workspace: Workspace) -> None:
        self.shape, self.device, self.workspace = shape, device, workspace
        self._known: dict[Hashable, Any] = {}

    @abstractmethod
    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """Return rows of all maps, C-contiguous; what was returned two calls before may be overwritten."""

    def read_part(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Return some columns of rows, each from the first to the one before the end; as of `read_rows`."""
        return self.read_rows(*rows)[:, :, slice(*columns)]

    def read_some(self, row: int, columns: slice) -> NDArray[np.float32]:
        """Return some pixels of a row, (n_coeff, 1, columns, channel), as `read_rows` does; checked."""
        coeffs_khwc = self.read_rows(row, row + 1)
        self.check(coeffs_khwc, row)
        return coeffs_khwc[:, :, columns]

    def read_scattered(self, places: Sequence[tuple[int, slice]]) -> NDArray[np.float32]:
        """Return pixels of several rows, (n_coeff, 1, pixels, channel), one row after another; as `read_some`."""
        some = (self.read_some(*place) for place in places)  # rows may be overwritten
        return np.concatenate(list(some) if self.in_memory is not None else [each.copy() for each in some], axis=2)

    def read_samples(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray:
        """Return what coefficients are `linear` in, (n_sample, rows, columns, channel), C-contiguous."""
        raise NotImplementedError

    @contextmanager
    def rows(self, multiple: int = 1) -> Iterator[Iterator[tuple[int, NDArray[np.float32]]]]:
        """Lend all rows in parts, each with its first row, which is a multiple of `multiple`."""
        height, parts = self.shape[1], _row_parts(self.workspace, self.shape, multiple, self.row_step)
        with reading_ahead(lambda part: self.read_rows(part.start, part.stop), parts) as read:

            def told() -> Iterator[tuple[int, NDArray[np.float32]]]:
                for part, coeffs_khwc in zip(parts, read, strict=True):
                    self.check(coeffs_khwc, part.start)
                    yield part.start, coeffs_khwc
                    self.workspace.tell(part.stop, height)

            yield told()

    def check(self, coeffs_khwc: NDArray[np.float32], first_row: int) -> None:  # noqa: B027 - most have no reason to
        """Raise InputError where rows that were read cannot be encoded."""

    def map_parts(self) -> list[slice]:
        """Return the parts in which maps are taken."""
        return parts_of(self.shape[0], self.workspace.part_maps(self.shape))

    def maps(self, first: int, end: int) -> NDArray[np.float32]:
        """Return some maps (end - first, height, width, channel), C-contiguous, not to be written to."""
        return self.remember("planes", self._as_planes).maps(first, end)

    def _as_planes(self) -> Planes:
        with self.rows() as parts:
            planes = self.workspace.make_planes(self.shape)
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

    def __init__(
        self, coeffs_khwc: NDArray[np.float32], device: Device, basis: str = SH, lights_i3: NDArray | None = None
    ) -> None:
        super().__init__(coeffs_khwc.shape, device, Workspace())
        self._coeffs, self.in_memory = coeffs_khwc, coeffs_khwc
        self.basis, self.lights_i3 = basis, lights_i3

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
        super().__init__((len(operator_jk), *source.shape[1:]), source.device, source.workspace)
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
    workspace : Workspace
    """

    row_step = 1
    """Rows that are best put together."""

    def __init__(self, shape: Shape, workspace: Workspace) -> None:
        self.shape, self.workspace = shape, workspace
        self._planes: Planes | None = None

    def row_parts(self, multiple: int = 1) -> list[slice]:
        """Return the rows to put together, each part beginning at a multiple of `multiple`."""
        return _row_parts(self.workspace, self.shape, multiple, self.row_step)

    @abstractmethod
    def put_rows(self, first: int, coeffs_khwc: NDArray[np.float32]) -> None:
        """Take rows of all maps, C-contiguous, not to be changed any more."""

    def put_maps(self, first: int, maps_khwc: NDArray[np.float32]) -> None:
        """Take whole maps, not to be changed any more."""
        if self._planes is None:
            self._planes = self.workspace.make_planes(self.shape)
        self._planes.put_maps(first, maps_khwc)

    def finish(self) -> None:
        """Hand on what came as maps."""
        if self._planes is None:
            return
        n_coeff, _, width, channel = self.shape
        for part in self.row_parts():
            rows_khwc = np.empty((n_coeff, part.stop - part.start, width, channel), np.float32)
            read_rows_into(self._planes, part.start, part.stop, rows_khwc)
            self.put_rows(part.start, rows_khwc)

    def mapped(self, operator_kj: NDArray[np.float64], device: Device) -> Target:
        """Return a target for maps of which the operator makes coefficients; it is to be finished as well."""
        return _MappedTarget(self, operator_kj, device)


class ArrayTarget(Target):
    """Coefficients in memory."""

    def __init__(self, shape: Shape) -> None:
        super().__init__(shape, Workspace())
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
        super().__init__((operator_kj.shape[1], *target.shape[1:]), target.workspace)
        self._target, self._operator, self._device, self.row_step = target, operator_kj, device, target.row_step

    def put_rows(self, first: int, coeffs_khwc: NDArray[np.float32]) -> None:
        """See `Target`."""
        self._target.put_rows(first, _multiply(self._device, self._operator, coeffs_khwc))

    def row_parts(self, multiple: int = 1) -> list[slice]:
        """See `Target`; as coefficients take them, which are no fewer."""
        return self._target.row_parts(multiple)
