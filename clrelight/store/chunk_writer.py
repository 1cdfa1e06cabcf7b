"""Whole chunks, written past HDF5's filters: their checksums are taken on a device."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clrelight.store.fletcher import SUM_DTYPE, add_pieces, checksums, takes_sums
from clrelight.store.walk import CHECKSUM_BYTES


class ChunkWriter:
    """Writes chunks of whole rows of a dataset that has the filter fletcher32 and no other.

    Parameters
    ----------
    dataset : h5py.Dataset
        As `clrelight.store.writing` makes them; its last axes are height, width and channel.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._id, self._dtype, self._chunks = dataset.id, dataset.dtype, dataset.chunks
        self._axis = dataset.ndim - 3  # of rows
        others = [i for i in range(dataset.ndim) if i != self._axis]
        self._takes = self._axis >= 0 and all(dataset.shape[i] == self._chunks[i] for i in others)
        self._sum_of: dict[int, np.uint32] = {}  # by a chunk's first row
        self._chunk_x = np.empty(0, np.uint8)  # a chunk and its checksum

    def sum_rows(self, first: int, rows: NDArray) -> None:
        """Take the sums of the whole chunks among rows from `first` on; nothing where HDF5 must take them."""
        if not self._takes or rows.dtype != self._dtype or not rows.flags.c_contiguous:
            return
        # A chunk that the array's edge cuts off is stored whole: not by these bytes alone.
        n_rows, chunk_rows = rows.shape[self._axis], self._chunks[self._axis]
        bands = range(-(-first // chunk_rows), (first + n_rows) // chunk_rows)
        if not (bands and takes_sums(rows.nbytes)):
            return
        rows_nx = rows.reshape(-1, rows[0].size if self._axis else rows.size).view(np.uint8)
        row_bytes = rows_nx.shape[1] // n_rows
        images_n = np.arange(len(rows_nx))
        sums_bs = add_pieces(
            rows_nx,
            images_n,
            images_n,
            chunks=len(bands),
            piece=chunk_rows * row_bytes,
            pieces=len(rows_nx),
            skipped=(bands.start * chunk_rows - first) * row_bytes,
        )
        self._sum_of.update(zip((band * chunk_rows for band in bands), checksums(sums_bs), strict=True))

    def write(self, key: Any, values: NDArray) -> bool:
        """Write ``[rows]`` or ``[:, rows]`` if that is a whole chunk whose sum was taken; return whether it was."""
        *before, rows = key if isinstance(key, tuple) else (key,)
        if values.shape != self._chunks or len(before) != self._axis or not isinstance(rows, slice):
            return False
        summed = self._sum_of.pop(rows.start, None)
        if summed is None:
            return False
        if not self._chunk_x.size:
            self._chunk_x = np.empty(values.nbytes + CHECKSUM_BYTES, np.uint8)
        self._chunk_x[:-CHECKSUM_BYTES].view(self._dtype).reshape(values.shape)[...] = values
        self._chunk_x[-CHECKSUM_BYTES:].view(SUM_DTYPE)[0] = summed
        self._id.write_direct_chunk((*(0,) * self._axis, rows.start, 0, 0), self._chunk_x)
        return True
