"""Rows of an array in an HDF5 file: its chunks' bytes go straight to where they belong, and are summed there.

HDF5 reads on one thread, under h5py's lock: it copies each chunk twice, and sums it between.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
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
_FARTHEST = 1 << 62  # addresses, which a damaged file may have, of which the system takes the sum with a size


class RowReader:
    """Reads rows of a dataset of images, straight from its file where that can be done, else by HDF5.

    Parameters
    ----------
    dataset : h5py.Dataset
        Nothing may be written to it any more.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._dataset = dataset
        self._tables: list[ChunkTable | None] = []  # one, once it was asked for

    def read_into(self, first: int, end: int, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """Read ``[picked_n, first:end]`` into a C-contiguous array of that shape and the dataset's type.

        Raises OSError, as h5py does, where a chunk is damaged, and ValueError for an array of another shape.
        """
        height, *others = self._dataset.shape[1:]
        expected = (len(self._dataset) if picked_n is None else len(picked_n), end - first, *others)
        if not 0 <= first <= end <= height or out.shape != expected or not out.flags.c_contiguous:
            raise ValueError(f"expected rows of {height} in a contiguous array {expected}, got {out.shape} at {first}")
        for rows in self._read_directly(first, out, picked_n):
            key, place = np.s_[:, rows.start : rows.stop], np.s_[:, rows.start - first : rows.stop - first]
            if picked_n is None:
                self._dataset.read_direct(out, key, place)
            else:
                self._pick(rows, out[place], picked_n)

    def _read_directly(self, first: int, out: NDArray, picked_n: NDArray[np.intp] | None) -> Iterable[range]:
        """Read what can be read past HDF5; yield the ranges of rows that it must read."""
        dataset, everything = self._dataset, [range(first, first + out.shape[1])]
        if out.nbytes < LEAST_BYTES or out.dtype != dataset.dtype:
            return everything
        images_n = np.arange(len(dataset)) if picked_n is None else picked_n
        if not self._tables:
            self._tables.append(ChunkTable.of(dataset))
        table = self._tables[0]
        if table is None or len(np.unique(images_n)) < len(images_n) or not takes_sums(out.nbytes):
            return everything
        return table.read(dataset.file.id.get_vfd_handle(), first, out, images_n)

    def _pick(self, rows: range, out: NDArray, picked_n: NDArray[np.intp]) -> None:
        # HDF5 reads scattered images slowly and rows of all images fast: pick after reading, a few rows at a time.
        step = self._dataset.chunks[1] if self._dataset.chunks else len(rows)
        for start in range(rows.start, rows.stop, step):
            stop = min(start + step, rows.stop)
            out[:, start - rows.start : stop - rows.start] = self._dataset[:, start:stop][picked_n]


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
        stored_bytes = chunks[0] * chunks[1] * row_bytes + CHECKSUM_BYTES
        grid = shape[0] // chunks[0], -(-shape[1] // chunks[1])
        places: list[tuple[int, ...]] = []
        addresses: list[int] = []

        def note(chunk: h5py.h5d.StoreInfo) -> None:
            if chunk.filter_mask == 0 and chunk.size == stored_bytes and chunk.byte_offset < _FARTHEST:
                places.append(chunk.chunk_offset)
                addresses.append(chunk.byte_offset)

        dataset.id.chunk_iter(note)
        # In a damaged index HDF5 may find other chunks than it lists: the list must be just what it should be.
        if places != [(g * chunks[0], b * chunks[1], *(0,) * len(shape[2:])) for g, b in np.ndindex(grid)]:
            return None
        return cls(np.reshape(addresses, grid), chunks[0], chunks[1], row_bytes)

    def read(self, descriptor: int, first: int, out_nhwc: NDArray, images_n: NDArray[np.intp]) -> Iterator[range]:
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
        images_n : ndarray, shape (n,), int
            Which images.
        """
        end = first + out_nhwc.shape[1]
        bands = range(-(-first // self.rows), end // self.rows)  # a chunk that the array's edge cuts off has more bytes
        if not bands:
            yield range(first, end)
            return
        rows_nx = out_nhwc.reshape(len(out_nhwc), -1).view(np.uint8)
        row_of = np.full(len(self.address_gb) * self.images, -1)
        row_of[images_n] = np.arange(len(images_n))
        for group, row_of_m in enumerate(row_of.reshape(-1, self.images)):
            if (row_of_m >= 0).any():
                for band in self._read_group(descriptor, group, bands, rows_nx, row_of_m, first):
                    yield range(band * self.rows, (band + 1) * self.rows)
        for start, stop in ((first, bands.start * self.rows), (bands.stop * self.rows, end)):
            if start < stop:
                yield range(start, stop)

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
                address = int(self.address_gb[group, band])
                is_bad_b[b] = not _read_into(descriptor, address, buffers, self.images * piece + CHECKSUM_BYTES)
            shape = {"chunks": len(part), "piece": piece, "pieces": self.images}
            sums_bs = add_pieces(rows_nx, row_of_m[wanted_m], wanted_m, skipped=skipped, **shape)
            if aside_m.size:
                sums_bs += add_pieces(aside_nx, np.arange(aside_m.size), aside_m, **shape)
            is_bad_b |= checksums(sums_bs) != stored_bx.view(SUM_DTYPE)[:, 0]
            yield from (part[b] for b in np.flatnonzero(is_bad_b))


def _read_into(descriptor: int, address: int, buffers: list[Any], n_bytes: int) -> bool:
    """Fill buffers of `n_bytes` together with a file's bytes from an address on; return whether there were so many."""
    done = 0
    try:
        for i in range(0, len(buffers), _MOST_BUFFERS):
            done += os.preadv(descriptor, buffers[i : i + _MOST_BUFFERS], address + done)
    except OSError:
        return False
    return done == n_bytes
