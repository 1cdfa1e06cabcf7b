"""Rows of a stored array, read past HDF5: its chunks' bytes go straight to where they belong, and are summed there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from clrelight.store.fletcher import SUM_DTYPE, add_pieces, checksums, takes_sums
from clrelight.store.walk import CHECKSUM_BYTES

LEAST_BYTES = 4 << 20
"""Fewer bytes are left to HDF5: a device may have to be opened first."""

ASIDE_BYTES = 16 << 20
"""Memory for images that nobody asked for, which share chunks with others."""

_MOST_BUFFERS = 1024  # of one call of the system (IOV_MAX)


@dataclass(frozen=True)
class ChunkTable:
    """Where in its file the chunks of an array lie.

    Attributes
    ----------
    address_gb : ndarray, shape (groups of images, bands of rows), int64
        Where the bytes of a chunk begin; a chunk is a band of whole rows of a group of images, its checksum behind.
    images, rows : int
        Of a chunk.
    row_bytes : int
        Of one row of one image.
    """

    address_gb: NDArray[np.int64]
    images: int
    rows: int
    row_bytes: int

    @classmethod
    def of(cls, dataset: h5py.Dataset) -> Self | None:
        """Return the table of a dataset, or None if only HDF5 can read it: it has other filters, other chunks."""
        plan, shape, chunks = dataset.id.get_create_plist(), dataset.shape, dataset.chunks
        if (
            dataset.file.id.get_access_plist().get_driver() != h5py.h5fd.SEC2
            or [plan.get_filter(i)[0] for i in range(plan.get_nfilters())] != [h5py.h5z.FILTER_FLETCHER32]
            or chunks is None
            or len(shape) < 2
            or shape[2:] != chunks[2:]
            or shape[0] % chunks[0]
        ):
            return None
        row_bytes = int(np.prod(shape[2:], dtype=np.int64)) * dataset.dtype.itemsize
        address_gb = np.full((shape[0] // chunks[0], -(-shape[1] // chunks[1])), -1, np.int64)
        stored_bytes = chunks[0] * chunks[1] * row_bytes + CHECKSUM_BYTES

        def note(chunk: h5py.h5d.StoreInfo) -> None:
            if chunk.filter_mask == 0 and chunk.size == stored_bytes:
                place = chunk.chunk_offset[0] // chunks[0], chunk.chunk_offset[1] // chunks[1]
                address_gb[place] = chunk.byte_offset

        dataset.id.chunk_iter(note)
        return cls(address_gb, chunks[0], chunks[1], row_bytes)

    def read(self, descriptor: int, first: int, out_nhwc: NDArray, lights_n: NDArray[np.intp]) -> Iterator[range]:
        """Read rows from `first` on of some images, each once; yield the ranges of rows that HDF5 must still read.

        Whatever is not just as it should be is left to HDF5, for it to say so or to know better.

        Parameters
        ----------
        descriptor : int
            Of the file.
        first : int
            First row.
        out_nhwc : ndarray, shape (n, rows, ...)
            C-contiguous, of the array's type.
        lights_n : ndarray, shape (n,), int
            Which images.
        """
        end = first + out_nhwc.shape[1]
        whole = range(-(-first // self.rows), end // self.rows)  # a last band that is cut off has other bytes too
        if not (whole and takes_sums(out_nhwc.nbytes)):
            yield range(first, end)
            return
        if first < whole.start * self.rows:
            yield range(first, whole.start * self.rows)
        rows_nx = out_nhwc.reshape(len(out_nhwc), -1).view(np.uint8)
        row_of = np.full(len(self.address_gb) * self.images, -1)
        row_of[lights_n] = np.arange(len(lights_n))
        for group, row_of_m in enumerate(row_of.reshape(-1, self.images)):
            if (row_of_m >= 0).any():
                for band in self._read_group(descriptor, group, whole, rows_nx, row_of_m, first):
                    yield range(band * self.rows, (band + 1) * self.rows)
        if end > whole.stop * self.rows:
            yield range(whole.stop * self.rows, end)

    def _read_group(
        self,
        descriptor: int,
        group: int,
        bands: range,
        rows_nx: NDArray[np.uint8],
        row_of_m: NDArray[np.intp],
        first: int,
    ) -> Iterator[int]:
        """Read bands of a group whose image m goes to row ``row_of_m[m]``, or aside; yield those not as they should."""
        piece = self.rows * self.row_bytes
        wanted_m, aside_m = np.flatnonzero(row_of_m >= 0), np.flatnonzero(row_of_m < 0)
        step = len(bands)
        if aside_m.size:
            step = max(1, min(step, ASIDE_BYTES // (aside_m.size * piece)))
        aside_nx = np.empty((aside_m.size, step * piece), np.uint8)
        source_m = row_of_m.copy()
        source_m[aside_m] = len(rows_nx) + np.arange(aside_m.size)
        sources = source_m.tolist()
        for start in range(bands.start, bands.stop, step):
            part = bands[start - bands.start :][:step]
            skipped = part.start * piece - first * self.row_bytes
            stored_bx, is_bad_b = np.zeros((len(part), CHECKSUM_BYTES), np.uint8), np.zeros(len(part), np.bool_)
            for b, band in enumerate(part):
                here, aside = slice(skipped + b * piece, skipped + (b + 1) * piece), slice(b * piece, (b + 1) * piece)
                pieces = [*rows_nx[:, here], *aside_nx[:, aside]]
                buffers = [*(pieces[source] for source in sources), stored_bx[b]]
                is_bad_b[b] = not _read_into(descriptor, int(self.address_gb[group, band]), buffers)
            shape = {"chunks": len(part), "piece": piece, "pieces": self.images}
            sums_bs = add_pieces(rows_nx, row_of_m[wanted_m], wanted_m, skipped=skipped, **shape)
            if aside_m.size:
                sums_bs += add_pieces(aside_nx, np.arange(aside_m.size), aside_m, **shape)
            is_bad_b |= checksums(sums_bs) != stored_bx.view(SUM_DTYPE)[:, 0]
            yield from (part[b] for b in np.flatnonzero(is_bad_b))


def _read_into(descriptor: int, address: int, buffers: list[Any]) -> bool:
    """Fill buffers of bytes with a file's bytes from an address on; return whether there were so many."""
    try:
        for i in range(0, len(buffers), _MOST_BUFFERS):
            some = buffers[i : i + _MOST_BUFFERS]
            n_bytes = sum(map(len, some))
            if address < 0 or os.preadv(descriptor, some, address) != n_bytes:
                return False
            address += n_bytes
    except OSError:
        return False
    return True
