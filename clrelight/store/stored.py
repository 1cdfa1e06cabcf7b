"""Arrays in an open file, read as they are indexed."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clrelight.errors import StoreFormatError
from clrelight.store.chunk_table import RowReader
from clrelight.store.walk import CHECKSUM_BYTES


class StoredArray:
    """A dataset that is read when indexed, and says StoreFormatError when what is stored is damaged.

    Attributes
    ----------
    shape, dtype, ndim, size
        As of an ndarray.
    chunks : tuple of int or None
        Shape of the pieces in which it is stored; tiles that are whole multiples of it read fastest.
    """

    def __init__(self, dataset: h5py.Dataset, path: str) -> None:
        self.shape, self.dtype, self.chunks = tuple(dataset.shape), dataset.dtype, dataset.chunks
        self.ndim, self.size = len(self.shape), dataset.size
        self._dataset, self._path = dataset, path
        self._rows = RowReader(dataset)
        self._deflated = dataset.compression == "gzip"
        self._inflatable: set[tuple[int, ...]] = set()

    @property
    def id(self) -> h5py.h5d.DatasetID:
        """HDF5's handle."""
        return self._dataset.id

    def __getitem__(self, key: Any) -> NDArray:
        """Read a selection: whatever h5py takes as an index."""
        with self._reading(key):
            return self._dataset[key]

    def read_rows_into(self, first: int, end: int, out: NDArray) -> None:
        """Read ``[:, first:end]`` into a C-contiguous array of that shape and this dtype."""
        with self._reading(np.s_[:, first:end]):
            self._rows.read_into(first, end, out)

    def read_some_into(self, picked_n: NDArray[np.intp], first: int, end: int, out: NDArray) -> None:
        """Read ``[picked_n, first:end]`` into a C-contiguous array of that shape and this dtype."""
        with self._reading(np.s_[:, first:end]):
            self._rows.read_into(first, end, out, picked_n)

    @contextmanager
    def _reading(self, key: Any) -> Iterator[None]:
        if not self._dataset:
            raise ValueError(f"{self._path} is closed: read its arrays while it is open")
        try:
            if self._deflated:
                self._check_chunks(key)
            yield
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

    def _check_chunks(self, key: Any) -> None:
        """Inflate the chunks of a selection within their proper size first: HDF5 sets no bound, and reads on behind
        a chunk that comes out short.
        """
        pieces = key if isinstance(key, tuple) else (key,)
        at = next((i for i, piece in enumerate(pieces) if piece is Ellipsis), None)
        if at is not None:
            pieces = (*pieces[:at], *[slice(None)] * (self.ndim - len(pieces) + 1), *pieces[at + 1 :])
        pieces = (*pieces, *[slice(None)] * (self.ndim - len(pieces)))
        ranges = [_chunk_starts(*each) for each in zip(pieces, self.shape, self.chunks, strict=False)]
        for offset in itertools.product(*ranges):
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


def _chunk_starts(piece: Any, n: int, chunk: int) -> range:
    """Return the offsets of the chunks that an index along one axis may touch."""
    if isinstance(piece, slice):
        start, stop, _ = piece.indices(n)
    elif isinstance(piece, int | np.integer):
        start = int(piece) % n
        stop = start + 1
    else:
        start, stop = 0, n
    return range(start // chunk * chunk, stop, chunk)
