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
        As `clrelight.store.writing` makes them.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        shape, chunks = dataset.shape, dataset.chunks
        self._id, self._dtype, self._chunks = dataset.id, dataset.dtype, chunks
        self._takes = len(shape) > 1 and (shape[0], *shape[2:]) == (chunks[0], *chunks[2:])
        self._sum_of: dict[int, np.uint32] = {}  # by a chunk's first row
        self._chunk_x = np.empty(0, np.uint8)  # a chunk and its checksum

    def sum_rows(self, first: int, rows_nhwc: NDArray) -> None:
        """Take the sums of the whole chunks among rows from `first` on; nothing where HDF5 must take them."""
        if not self._takes or rows_nhwc.dtype != self._dtype or not rows_nhwc.flags.c_contiguous:
            return
        # A chunk that the array's edge cuts off is stored whole: not by these bytes alone.
        chunk_rows = self._chunks[1]
        bands = range(-(-first // chunk_rows), (first + rows_nhwc.shape[1]) // chunk_rows)
        if not (bands and takes_sums(rows_nhwc.nbytes)):
            return
        rows_nx = rows_nhwc.reshape(len(rows_nhwc), -1).view(np.uint8)
        row_bytes = rows_nx.shape[1] // rows_nhwc.shape[1]
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
        """Write ``[:, rows]`` if that is a whole chunk whose sum was taken; return whether it was."""
        if not self._sum_of or values.shape != self._chunks or len(key) != 2 or key[0] != slice(None):
            return False
        summed = self._sum_of.pop(key[1].start, None)
        if summed is None:
            return False
        if not self._chunk_x.size:
            self._chunk_x = np.empty(values.nbytes + CHECKSUM_BYTES, np.uint8)
        self._chunk_x[:-CHECKSUM_BYTES].view(self._dtype).reshape(values.shape)[...] = values
        self._chunk_x[-CHECKSUM_BYTES:].view(SUM_DTYPE)[0] = summed
        self._id.write_direct_chunk((0, key[1].start, *(0,) * (values.ndim - 2)), self._chunk_x)
        return True
