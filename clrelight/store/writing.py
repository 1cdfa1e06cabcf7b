"""Writing HDF5 so that a file is whole, covered by checksums, and the same bytes for the same input."""

from __future__ import annotations

import json
import os
import struct
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.durable import Part, naming, replacing, syncing
from clrelight.errors import InputError
from clrelight.store.attributes import text_bytes
from clrelight.store.blocks import SUM_DTYPE, BlockReader, BlockWriter, box_of
from clrelight.store.creating import create_compact, create_in_memory, create_on_disk
from clrelight.store.nexus import describe
from clrelight.store.schemas import SCALE_DTYPE, SCALED_AXES, SCHEMA_ATTRIBUTE, Schema
from clrelight.store.seal import MOST_IN_TEXT, SEAL_ATTRIBUTE, TABLE, seal_of, sums_text, type_text
from clrelight.store.superblock import closed
from clrelight.tiles import Rectangle, check_shape

IN_MEMORY_BYTES = 64 << 20
"""Files of fewer bytes are built in memory, which holds them three times, and where a full disk cannot reach HDF5."""

CHUNK_BYTES = 1 << 20
_TABLE_CHUNK = 1 << 17  # checksums
FAR_OVER_BYTES = 8 << 20
"""A chunk of one row that is larger than this is split along its first axis."""

RESERVE_SHARE, RESERVE_BYTES = 64, 4 << 20
"""A large file reserves this share of its arrays and these bytes more, for what HDF5 adds."""

COMPACT_BYTES = 8 << 10
_SUPERBLOCK = struct.Struct("<8xB19xQ")  # versions 2 and 3: the version at byte 8, the end of the file at 28


class Sink:
    """An array of a file being written, to be filled by slices, each element once.

    Attributes
    ----------
    shape, dtype, chunks
        As of an HDF5 dataset. Filling whole chunks at a time is fast when the file is too large for memory.
    """

    def __init__(self, target: BlockWriter | NDArray, dataset: h5py.Dataset, wrote: Callable[[int], None]) -> None:
        self.shape, self.dtype, self.chunks = tuple(dataset.shape), dataset.dtype, dataset.chunks
        self._target, self._dataset, self._wrote = target, dataset, wrote
        self._reader: BlockReader | None = None
        self._extent = np.broadcast_to(np.False_, self.shape)  # takes no memory, says what a key selects
        self._missing = self._extent.size

    def __setitem__(self, key: Any, values: ArrayLike) -> None:
        """Write values of exactly the selected shape and this dtype; nothing is converted or broadcast."""
        self.fill(key, np.asarray(values))

    def fill(self, key: Any, values: NDArray) -> None:
        """Write ``self[key] = values``; the key selects a contiguous part."""
        selected = self._extent[key].shape
        if values.dtype != self.dtype or values.shape != selected:
            raise TypeError(f"expected {self.dtype} {selected}, got {values.dtype} {values.shape}")
        if isinstance(self._target, BlockWriter):
            box, _ = box_of(key, self.shape)
            self._target.write(box, values.reshape([part.stop - part.start for part in box]))
        else:
            self._target[key] = values
        self._missing -= values.size
        self._wrote(values.nbytes)

    def __getitem__(self, key: Any) -> NDArray:
        """Read back what was filled, before the file is finished."""
        return self._dataset[key] if isinstance(self._target, BlockWriter) else self._target[key]

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        """See `clrelight.tiles.PixelArray`: read back what was filled."""
        check_shape(tile, out, self.shape, picked_n)
        if not isinstance(self._target, BlockWriter) or self._missing:
            out[...] = self[:, tile.rows, tile.columns][slice(None) if picked_n is None else picked_n]
        else:
            self._reader = self._reader or BlockReader(self._dataset, self._target.sums())
            self._reader.read_into(box_of(np.s_[:, tile.rows, tile.columns], self.shape)[0], out, picked_n)

    def check_filled(self) -> None:
        """Raise ValueError if fewer elements were written than there are."""
        if self._missing > 0:
            raise ValueError(f"{self._missing} of {self._extent.size} elements of an array were never written")


class Draft:
    """An HDF5 file being written: attributes, datasets with named axes, sinks, and the seal over them all."""

    def __init__(self, file: h5py.File, schema: Schema, wrote: Callable[[int], None] | None = None) -> None:
        self._file, self._schema = file, schema
        self._in_memory, self._wrote = wrote is None, wrote or (lambda n_bytes: None)
        self._sinks: list[Sink] = []
        self._pending: list[tuple[BlockWriter, NDArray]] = []
        self._writers: dict[str, BlockWriter] = {}
        self._attributes: dict[str, dict[str, int | float | str | bytes]] = {}
        self.attributes({SCHEMA_ATTRIBUTE: schema.name})

    def attributes(self, values: Mapping[str, int | float | str | bytes], of: str = "/") -> None:
        """Write attributes of the root or of the object named `of`: scalars, and bytes as arrays of uint8."""
        for name, value in values.items():
            if isinstance(value, bytes):
                data = np.frombuffer(value, np.uint8)
            elif isinstance(value, str):
                text = text_bytes(name, value)
                data = np.array(text, dtype=h5py.string_dtype("utf-8", max(1, len(text))))
            else:
                data = np.array(value, dtype="<i8" if isinstance(value, int) else "<f8")
            self._file[of].attrs.create(name, data)
            self._attributes.setdefault(of, {})[name] = value

    def dataset(self, name: str, data: NDArray, axes: Sequence[str] = (), chunks: tuple[int, ...] | None = None) -> str:
        """Write a whole array; return its name."""
        # A file that is sent is as small as can be: short arrays lie among HDF5's own records, without holes between.
        compact = self._in_memory and not self._schema.is_scaled and 0 < data.nbytes <= COMPACT_BYTES
        writer = self._create(name, data.shape, data.dtype, axes, chunks, compact)[1]
        writer.write(writer.blocks.everything, data)
        return name

    def sink(self, name: str, shape: tuple[int, ...], dtype: Any, axes: Sequence[str], chunks: tuple[int, ...]) -> Sink:
        """Make an array to be filled by slices until the file is finished."""
        dataset, writer = self._create(name, shape, np.dtype(dtype), axes, chunks)
        target: BlockWriter | NDArray = writer
        if self._in_memory:  # fill an array, write its blocks once
            target = np.zeros(shape, dataset.dtype)
            self._pending.append((writer, target))
        self._sinks.append(Sink(target, dataset, self._wrote))
        return self._sinks[-1]

    @property
    def file(self) -> h5py.File:
        """The file, for what no schema knows and no seal covers."""
        return self._file

    def finish(self) -> None:
        """Write what is still in memory, and the seal; ValueError if a sink was not filled."""
        for sink in self._sinks:
            sink.check_filled()
        while self._pending:
            writer, array = self._pending.pop(0)
            writer.write(writer.blocks.everything, array)
        if self._schema.is_scaled:
            describe(self._file, self._schema)
        self._seal()

    def _seal(self) -> None:
        sealed = {name: self._writers[name] for name in sorted(self._writers) if self._schema.field_of(name)}
        table_b = np.concatenate([np.empty(0, SUM_DTYPE), *(writer.sums() for writer in sealed.values())])
        arrays = {
            name: (
                type_text(self._file[name].dtype),
                writer.blocks.shape,
                writer.blocks.extent,
                self._attributes.get(name, {}),
            )
            for name, writer in sealed.items()
        }
        held = {name: self._attributes["/"][name] for name in self._schema.attributes}
        seal = seal_of(self._schema.name, held, arrays, table_b)
        if self._schema.has_table or len(table_b) > MOST_IN_TEXT:
            self.dataset(TABLE, table_b, chunks=(min(len(table_b), _TABLE_CHUNK),))
        else:
            seal += sums_text(table_b)
        self.attributes({SEAL_ATTRIBUTE: seal}, of=self._schema.sealed)

    def _create(
        self,
        name: str,
        shape: tuple[int, ...],
        dtype: np.dtype,
        axes: Sequence[str],
        chunks: tuple[int, ...] | None,
        compact: bool = False,
    ) -> tuple[h5py.Dataset, BlockWriter]:
        chunking = None if 0 in shape else chunks or shape  # an empty dataset has no chunk
        dtype = dtype.newbyteorder("<")
        if compact:
            dataset = create_compact(self._file, name, shape, dtype)
        else:
            dataset = self._file.create_dataset(name, shape=shape, dtype=dtype, chunks=chunking, track_times=False)
        for i, axis in enumerate(axes):
            if axis in SCALED_AXES and self._schema.is_scaled:
                if axis not in self._file:
                    self.dataset(axis, np.arange(shape[i], dtype=SCALE_DTYPE))
                    self._file[axis].make_scale(axis)
                dataset.dims[i].attach_scale(self._file[axis])
        self._writers[name] = BlockWriter(dataset)
        return dataset, self._writers[name]


@contextmanager
def drafting(path: str | os.PathLike, schema: Schema, n_bytes: int) -> Iterator[Draft]:
    """Write a file of a schema; it stands at `path` once the block has ended well.

    Parameters
    ----------
    path : path
        Where the file is to stand.
    schema : Schema
        What kind of file it is.
    n_bytes : int
        Estimate of the file's size; from `IN_MEMORY_BYTES` on it is streamed to disk, on space that is reserved first.

    Raises
    ------
    InputError
        As `durable.replacing` does, and if the disk is full.
    """
    build = _built_in_memory if n_bytes < IN_MEMORY_BYTES else _streamed
    with replacing(path) as part, build(path, part, n_bytes, schema) as draft:
        yield draft


def drafted_bytes(schema: Schema, fill: Callable[[Draft], None]) -> int:
    """Return how large a file is that `fill` writes; nothing is written to a disk."""
    with create_in_memory(uuid.uuid4().hex, 1 << 16) as file:
        draft = Draft(file, schema)
        fill(draft)
        draft.finish()
        file.flush()
        return len(file.id.get_file_image())


@contextmanager
def _built_in_memory(path: str | os.PathLike, part: Part, n_bytes: int, schema: Schema) -> Iterator[Draft]:
    # HDF5 takes two files of one name for the same, also in memory: a name that nobody has. It is not stored.
    with create_in_memory(uuid.uuid4().hex, max(1 << 16, n_bytes // 8)) as file:
        draft = Draft(file, schema)
        yield draft
        draft.finish()
        file.flush()
        image = file.id.get_file_image()
    for piece in closed(image):
        part.write(piece)


@contextmanager
def _streamed(path: str | os.PathLike, part: Part, n_bytes: int, schema: Schema) -> Iterator[Draft]:
    with create_on_disk(part.path) as file:
        # HDF5 crashes the process when it closes a file on a full disk: every byte is reserved before the first.
        with naming(path):
            part.reserve(n_bytes + n_bytes // RESERVE_SHARE + RESERVE_BYTES)
        with syncing(path, part.descriptor) as wrote:
            draft = Draft(file, schema, wrote)
            yield draft
            draft.finish()
    with naming(path):
        version, size = _SUPERBLOCK.unpack(os.pread(part.descriptor, _SUPERBLOCK.size, 0))
        if version not in (2, 3) or os.fstat(part.descriptor).st_size < size:
            raise OSError(f"HDF5 left it at superblock {version} and {size} bytes")
        os.ftruncate(part.descriptor, size)  # gives back what was reserved in excess
    with naming(path), h5py.File(part.path, "r", locking=False):
        pass


def chunk_shape(shape: tuple[int, ...], itemsize: int, first: int | None = None) -> tuple[int, ...]:
    """Return chunks of (first axis, some rows, width, channel) of about 1 MiB, made for reading tiles of rows.

    Parameters
    ----------
    shape : tuple of int
        (n, height, width, channel).
    itemsize : int
        Bytes of an element.
    first : int, optional
        Extent along the first axis; all of it without, or less where a single row would be far over 1 MiB.
    """
    n, height, width, channel = shape
    row_bytes = width * channel * itemsize
    extent = n if first is None else max(1, min(n, first))
    if extent * row_bytes > FAR_OVER_BYTES:
        extent = min(extent, even_part(n, CHUNK_BYTES // row_bytes))
    return extent, even_part(height, CHUNK_BYTES // (extent * row_bytes)), width, channel


def padded_bytes(shape: tuple[int, ...], chunks: tuple[int, ...], itemsize: int) -> int:
    """Return the bytes that an array takes on disk: chunks at the edges are stored whole."""
    return int(np.prod([-(-n // c) * c for n, c in zip(shape, chunks, strict=True)], dtype=object)) * itemsize


def config_text(config: Mapping[str, Any]) -> str:
    """Return options as JSON with sorted keys; InputError if they are not JSON values."""
    try:
        return json.dumps(dict(config), sort_keys=True, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"a configuration must be JSON values, got {config!r}: {error}") from None


def even_part(n: int, largest: int) -> int:
    """Return the size of equal parts of `n`, none over `largest`: unequal ones waste space in the last chunk."""
    parts = -(-n // max(1, min(n, largest)))
    return -(-n // parts)
