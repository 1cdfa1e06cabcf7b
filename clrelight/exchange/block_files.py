"""Blocks of codec `bc6h` on their way into files of others: coefficients are read and encoded rows at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import Bc6h, Encoded
from clrelight.codec.bodies import BodyWriter
from clrelight.codec.finite import check_coefficients
from clrelight.codec.registry import encode_stream
from clrelight.codec.streams import Source
from clrelight.codec.workspace import PARTS, BoundedWorkspace
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.memory import DEFAULT_MEMORY, PIECE_BYTES
from clrelight.streaming import write_at


class BlockFiles(BodyWriter):
    """A body that goes into files, an equal part of it into each.

    Parameters
    ----------
    files : sequence of int or Path
        Descriptors of open files, or files that are there and opened one at a time: a map may have more textures than
        a process may have files open.
    start : int
        Where its part begins in each.
    """

    def __init__(self, files: Sequence[int | Path], start: int) -> None:
        super().__init__()
        self._files, self._start, self._size = files, start, 1

    def _allocate(self, n_bytes: int) -> None:
        self._size = max(n_bytes // len(self._files), 1)

    def _put(self, at: int, values_b: NDArray[np.uint8]) -> None:
        rest = values_b.data
        while rest:
            number, place = divmod(at, self._size)
            piece = rest[: self._size - place]
            with _opened(self._files[number]) as descriptor:
                write_at(descriptor, piece, self._start + place)
            rest, at = rest[len(piece) :], at + len(piece)


@contextmanager
def _opened(file: int | Path) -> Iterator[int]:
    if isinstance(file, int):
        yield file
        return
    with open(file, "r+b", buffering=0) as opened:
        yield opened.fileno()


def put_blocks(
    held: CoefficientMap | Encoded,
    files: BlockFiles,
    device: Device,
    *,
    scale: float = 1.0,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write the blocks of a map, or those of an encoding by `bc6h` as they are.

    Parameters
    ----------
    held : CoefficientMap or Encoded
    files : BlockFiles
    device : Device
        Where blocks are made.
    scale : float
        What coefficients are divided by before.
    progress : callable, optional
        Called with rows done and in all.

    Raises
    ------
    InputError
        If a coefficient is not finite, or too large for binary16.
    """
    if isinstance(held, CoefficientMap):
        encode_stream(_Scaled(held, scale, device, progress), Bc6h(), files)
        return
    files.reserve(len(held.body))
    for at in range(0, len(held.body), PIECE_BYTES):
        files.write(at, np.frombuffer(held.body[at : at + PIECE_BYTES], np.uint8))


class _Scaled(Source):
    """The coefficients of a map divided by a power of two, read as they are needed."""

    def __init__(
        self, fit: CoefficientMap, scale: float, device: Device, progress: Callable[[int, int], None] | None
    ) -> None:
        n_coeff, height, width, channel = (fit.n_coeff, *fit.image_shape)
        least = PARTS * 4 * 4 * math.prod((n_coeff, width, channel))  # four rows, which blocks are made of
        shape = (n_coeff, height, width, channel)
        super().__init__(shape, device, BoundedWorkspace(max(DEFAULT_MEMORY, least), progress))
        self._fit, self._scale = fit, np.float32(scale)

    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Source`."""
        n_coeff, _, width, channel = self.shape
        rows_khwc = self._fit.read_rows(first, end, np.empty((n_coeff, end - first, width, channel), np.float32))
        return rows_khwc if self._scale == 1.0 else np.divide(rows_khwc, self._scale, out=rows_khwc)

    def check(self, coeffs_khwc: NDArray[np.float32], first_row: int) -> None:
        """Raise InputError that names a coefficient which is not finite."""
        check_coefficients(coeffs_khwc, self.device, first_row)
