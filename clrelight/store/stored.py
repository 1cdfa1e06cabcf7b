"""Arrays in an open file, read as they are indexed."""

from __future__ import annotations

import threading
import zlib
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clrelight.errors import StoreFormatError
from clrelight.store.blocks import BlockReader, Blocks, Box, box_of
from clrelight.store.walk import CHECKSUM_BYTES
from clrelight.tiles import Rectangle, check_shape, row_tiles


class StoredArray:
    """A dataset that is read when indexed, and says StoreFormatError when what is stored is damaged.

    Parameters
    ----------
    dataset : h5py.Dataset
    path : str
        For messages.
    sums_b : ndarray, uint64, optional
        Checksums of its blocks: each is checked whenever it is read. Without, HDF5 checks what it can.

    Attributes
    ----------
    shape, dtype, ndim, size
        As of an ndarray.
    chunks : tuple of int or None
        Shape of the pieces in which it is stored; tiles that are whole multiples of it read fastest.
    """

    def __init__(self, dataset: h5py.Dataset, path: str, sums_b: NDArray[np.uint64] | None = None) -> None:
        self.shape, self.dtype, self.chunks = tuple(dataset.shape), dataset.dtype, dataset.chunks
        self.ndim, self.size = len(self.shape), dataset.size
        self._dataset, self._path = dataset, path
        self._reader = None if sums_b is None else BlockReader(dataset, sums_b)
        self._one_at_a_time = threading.Lock()
        self._deflated = dataset.compression == "gzip"
        self._inflatable: set[tuple[int, ...]] = set()

    @property
    def id(self) -> h5py.h5d.DatasetID:
        """HDF5's handle."""
        return self._dataset.id

    def unchecked(self) -> StoredArray:
        """Return the array without our checksums; such as HDF5 has itself are compared still."""
        return StoredArray(self._dataset, self._path)

    def extents(self) -> list[tuple[int, int]]:
        """Return where in the file the bytes of an array of one axis lie as they are, and how many; [] if they do not.

        Places count from where HDF5 begins.
        """
        plan, itemsize = self.id.get_create_plist(), self.dtype.itemsize
        filters = [plan.get_filter(i)[0] for i in range(plan.get_nfilters())]
        if self.ndim != 1 or filters not in ([], [h5py.h5z.FILTER_FLETCHER32]):  # of which the checksum stands behind
            return []
        if plan.get_layout() == h5py.h5d.CONTIGUOUS:
            return [(self.id.get_offset(), self.size * itemsize)]
        if not self.chunks:
            return []
        found: list[tuple[int, int]] = []
        self.id.chunk_iter(lambda info: found.append((info.chunk_offset[0], info.byte_offset)))
        (extent,) = self.chunks
        return [(at, min(extent, self.size - first) * itemsize) for first, at in sorted(found)]

    def __getitem__(self, key: Any) -> NDArray:
        """Read a selection: integers, slices, and lists of integers."""
        box, rest = box_of(key, self.shape)
        out = np.empty([part.stop - part.start for part in box], self.dtype)
        self._read(box, out)
        return out[rest]

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """See `clrelight.tiles.PixelArray`."""
        check_shape(tile, out, self.shape, picked_n)
        if picked_n is None:
            self._read(box_of(np.s_[:, tile.rows, tile.columns], self.shape)[0], out)
            return
        (images, *_), _ = box_of(picked_n, self.shape)
        picked_n = np.where(picked_n < 0, picked_n + len(self), picked_n)
        if self._reader is not None:
            self._read(box_of(np.s_[images, tile.rows, tile.columns], self.shape)[0], out, picked_n)
            return
        # HDF5 reads scattered images slowly and rows of all images fast: pick after reading, a few rows at a time.
        step = self.chunks[1] if self.chunks else max(tile.shape[0], 1)
        for start, stop in row_tiles((tile.top, tile.bottom), step):
            values = self[images, start:stop, tile.columns]
            out[:, start - tile.top : stop - tile.top] = values[picked_n - images.start]

    def _read(self, box: Box, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        if not self._dataset:
            raise ValueError(f"{self._path} is closed: read its arrays while it is open")
        try:
            with self._one_at_a_time:
                if self._deflated:
                    self._check_chunks(box)
                if self._reader is not None:
                    self._reader.read_into(box, out, picked_n)
                elif out.size and out.flags.c_contiguous and self.ndim:
                    self._dataset.read_direct(out, box)
                elif out.size:
                    out[...] = self._dataset[box]
        except (OSError, RuntimeError, zlib.error) as error:
            first = (str(error).splitlines() or [type(error).__name__])[0]
            name = self._dataset.name.lstrip("/")
            raise StoreFormatError(f"{self._path}: {name} is damaged: {first}") from error

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        """Read everything."""
        whole = self[...]
        return whole if dtype is None else whole.astype(dtype, copy=False)

    def __len__(self) -> int:
        return self.shape[0]

    def _check_chunks(self, box: Box) -> None:
        """Inflate the chunks of a selection within their proper size first: HDF5 sets no bound, and reads on behind
        a chunk that comes out short.
        """
        for _, place in Blocks.of(self._dataset).touched(box):
            offset = tuple(part.start for part in place)
            if offset not in self._inflatable:
                self._check_chunk(offset)
                self._inflatable.add(offset)

    def _check_chunk(self, offset: tuple[int, ...]) -> None:
        plan = self.id.get_create_plist()
        codes = [plan.get_filter(i)[0] for i in range(plan.get_nfilters())]
        inflated = int(np.prod(self.chunks, dtype=object)) * self.dtype.itemsize
        if h5py.h5z.FILTER_FLETCHER32 in codes[: codes.index(h5py.h5z.FILTER_DEFLATE)]:
            inflated += CHECKSUM_BYTES
        if self.id.get_chunk_info_by_coord(offset).size > 2 * inflated + 1024:
            raise OSError(f"the chunk at {offset} takes more bytes than it would uncompressed")
        stored = self.id.read_direct_chunk(offset)[1]
        if len(zlib.decompressobj().decompress(stored, inflated + 1)) != inflated:
            raise OSError(f"the chunk at {offset} does not inflate to {inflated} bytes")
