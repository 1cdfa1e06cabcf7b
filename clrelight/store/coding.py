"""Coefficients in files as codecs take them and give them, part by part."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH
from clrelight.codec.finite import check_coefficients
from clrelight.codec.registry import check_decoded
from clrelight.codec.streams import Source, Target
from clrelight.codec.workspace import Workspace
from clrelight.device import Device
from clrelight.store.stored import StoredArray
from clrelight.streaming import Buffer
from clrelight.tiles import read_rows_into


class StoredSource(Source):
    """The coefficients of an open fit, read as they are needed and looked at before they are used."""

    def __init__(
        self,
        stored_khwc: StoredArray,
        device: Device,
        workspace: Workspace,
        basis: str = SH,
        lights_i3: NDArray[np.float64] | None = None,
    ) -> None:
        super().__init__(stored_khwc.shape, device, workspace)
        self.basis, self.lights_i3 = basis, lights_i3
        self._stored, self._buffers = stored_khwc, _buffers()
        if stored_khwc.chunks:
            self.row_step = stored_khwc.chunks[1]

    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Source`."""
        n_coeff, _, width, channel = self.shape
        coeffs_khwc = next(self._buffers).lend((n_coeff, end - first, width, channel), self._stored.dtype)
        return read_rows_into(self._stored, first, end, coeffs_khwc).astype(np.float32, copy=False)

    @contextmanager
    def rows(self, multiple: int = 1) -> Iterator[Iterator[tuple[int, NDArray[np.float32]]]]:
        """See `Source`."""
        with super().rows(multiple) as parts:
            yield parts
        self._buffers = _buffers()  # a codec that goes on with maps has their memory

    def check(self, coeffs_khwc: NDArray[np.float32], first_row: int) -> None:
        """Raise InputError that names a coefficient which is not finite."""
        check_coefficients(coeffs_khwc, self.device, first_row)


class RowTarget(Target):
    """Hands on decoded rows, from top to bottom, once they are seen to be finite.

    Parameters
    ----------
    write : callable
        Takes the first row, and rows of all maps that do not change any more.
    codec_id : str
        For messages.
    row_step : int
        Rows that are best written together.
    """

    def __init__(
        self,
        shape: tuple[int, int, int, int],
        device: Device,
        workspace: Workspace,
        write: Callable[[int, NDArray[np.float32]], None],
        *,
        codec_id: str,
        row_step: int = 1,
    ) -> None:
        super().__init__(shape, workspace)
        self._device, self._write, self._codec_id, self.row_step = device, write, codec_id, row_step

    def put_rows(self, first: int, coeffs_khwc: NDArray[np.float32]) -> None:
        """See `Target`."""
        check_decoded(coeffs_khwc, self._codec_id, self._device)
        self._write(first, coeffs_khwc)
        self.workspace.tell(first + coeffs_khwc.shape[1], self.shape[1])


class PlanesTarget(Target):
    """Keeps decoded coefficients in maps of the workspace, for them to be read again."""

    def __init__(
        self, shape: tuple[int, int, int, int], device: Device, workspace: Workspace, *, codec_id: str
    ) -> None:
        super().__init__(shape, workspace)
        self.planes = workspace.make_planes(shape)
        self._device, self._codec_id = device, codec_id

    def put_rows(self, first: int, coeffs_khwc: NDArray[np.float32]) -> None:
        """See `Target`."""
        check_decoded(coeffs_khwc, self._codec_id, self._device)
        self.planes.put_rows(first, coeffs_khwc)

    def put_maps(self, first: int, maps_khwc: NDArray[np.float32]) -> None:
        """See `Target`."""
        check_decoded(maps_khwc, self._codec_id, self._device)
        self.planes.put_maps(first, maps_khwc)


def _buffers() -> Iterator[Buffer]:
    """Return two buffers, in turns."""
    return itertools.cycle([Buffer(), Buffer()])
