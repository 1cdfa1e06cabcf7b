"""Opening HDF5 files that somebody else may have made, or damaged, or made to do harm."""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, RemoteError, StoreFormatError
from clrelight.store.attributes import read_bytes, read_scalar
from clrelight.store.blocks import SUM_DTYPE, Blocks
from clrelight.store.places import Place, placed
from clrelight.store.schemas import FIT, OTHERS, SCALE_DTYPE, SCHEMA_ATTRIBUTE, SCHEMAS, STACK, Field, Schema
from clrelight.store.seal import SEAL_ATTRIBUTE, TABLE, parse_sums, seal_of, type_text
from clrelight.store.stored import StoredArray
from clrelight.store.walk import walk

_UNSEAL = (
    "so it is damaged, or another program changed it; to trust it as it is, delete {its} attribute "
    f"{SEAL_ATTRIBUTE} and its group {TABLE.partition('/')[0]}, where it has one"
)

_MADE_BY = {
    "stack": "clrelight ingest",
    "fit": "clrelight fit",
    "encoded": "clrelight encode or pack",
    "results": "clrelight bench",
    "light": "clrelight light",
    "shrm": "clrelight shrm",
}
"""What makes a file of a kind, for those who gave another."""

MAX_ATTRIBUTES = 256
_FIRST = {
    STACK.kind: ": clrelight fit makes one of it",
    "shrm": ": clrelight shrm render makes pictures of a reflection map",
    "light": ": light goes with a fit, by --light or, in view, by --environment",
    "results": ": clrelight report makes a page of a table",
}
"""What to do with a file of another kind, where a fit is wanted."""


class Opened:
    """An open file of ours: its schema is known and everything in it that will be read was looked at.

    Attributes
    ----------
    path : str
    schema : Schema
    arrays : dict of str to StoredArray
        Every dataset that the schema knows, by its path.
    sealed : bool
        Whether this program wrote the file, with checksums of all that is read; then they were compared as far as they
        are not of the arrays' values, which are checked when they are read.
    place : Place
        Where it is.
    """

    def __init__(self, place: Place, file: h5py.File, kinds: tuple[str, ...], *, trusting: bool = False) -> None:
        self.path, self.place, path = place.path, place, place.path
        self._root = h5py.h5g.open(file.id, b"/")
        self.schema = self._check_schema(kinds)
        self.sealed = self.has(SEAL_ATTRIBUTE) and not trusting
        datasets = walk(file, place.size, self._names(trusting))
        holder = self._root
        if self.schema.sealed in datasets:
            holder = datasets[self.schema.sealed].id
            self.sealed = not trusting and h5py.h5a.exists(holder, SEAL_ATTRIBUTE.encode())
        table = datasets.pop(TABLE, None)
        self._seal, self._sums = parse_sums(_text(holder, SEAL_ATTRIBUTE)) if self.sealed else ("", None)
        if self.sealed != (table is not None or self._sums is not None):
            lost = TABLE if self.sealed else SEAL_ATTRIBUTE
            raise StoreFormatError(f"it has lost its checksums ({lost}), {self._unseal}")
        self.arrays: dict[str, StoredArray] = {}
        if not self.sealed:
            self.arrays = {name: StoredArray(dataset, path) for name, dataset in datasets.items()}
        else:
            self._open_sealed(datasets, self._sums_of(table))
        if self.sealed or self.schema.kind != STACK.kind:  # stacks of other programs are looked at by `foreign`
            self._check_arrays()
            self._check_required()

    def _names(self, trusting: bool) -> set[str]:
        """Return the names in the root to look at; another program's dataset may have the name of one of our scales."""
        names = {name.partition("/")[0] for name in (*self.schema.fields, *([] if trusting else [TABLE]))}
        return names.union(self.schema.scales) if self.sealed else names

    @property
    def _unseal(self) -> str:
        return _UNSEAL.format(its="its" if self.schema.sealed == "/" else f"its {self.schema.sealed}'s")

    def _sums_of(self, dataset: h5py.Dataset | None) -> NDArray[np.uint64]:
        if dataset is None:
            return np.empty(0, SUM_DTYPE) if self._sums is None else self._sums
        table = StoredArray(dataset, self.path)
        if table.dtype != SUM_DTYPE or table.ndim != 1:
            raise StoreFormatError(f"{TABLE} is {table.dtype.str} {table.shape}, expected {SUM_DTYPE.str} with 1 axis")
        return np.asarray(table[...])

    def _open_sealed(self, datasets: dict[str, h5py.Dataset], table_b: NDArray[np.uint64]) -> None:
        for name in datasets.keys() & self.schema.scales:
            self.arrays[name] = StoredArray(datasets.pop(name), self.path)
        counts = [Blocks.of(datasets[name]).count for name in sorted(datasets)]
        ends = list(itertools.accumulate(counts, initial=0))
        if ends[-1] != table_b.size:
            raise StoreFormatError(f"it has {table_b.size} checksums, its arrays {ends[-1]} blocks, {self._unseal}")
        for name, (start, end) in zip(sorted(datasets), itertools.pairwise(ends), strict=True):
            self.arrays[name] = StoredArray(datasets[name], self.path, table_b[start:end])
        found = {
            name: (type_text(array.dtype), array.shape, Blocks.of(datasets[name]).extent, self._array_attributes(name))
            for name, array in self.arrays.items()
            if name in datasets
        }
        if seal_of(self.schema.name, self.attributes(), found, table_b) != self._seal:
            raise StoreFormatError(f"its attributes, shapes or checksums are not as they were written, {self._unseal}")

    def _array_attributes(self, name: str) -> dict[str, Any]:
        field = self.schema.field_of(name)
        if field is None or not field.attributes:
            return {}
        if field.attributes == "floats":
            return self.floats(name)
        return {field.attributes: self.attribute(field.attributes, str, of=name)}

    def attribute(self, name: str, kind: type, of: str | None = None) -> Any:
        """Return an attribute as int, float, str or bytes, of the root or of a dataset."""
        holder = self._root if of is None else self.arrays[of].id
        if not h5py.h5a.exists(holder, name.encode()):
            raise StoreFormatError(f"it has no attribute {name}")
        held = h5py.h5a.open(holder, name.encode())
        return read_bytes(held, name) if kind is bytes else read_scalar(held, name, kind)

    def has(self, name: str) -> bool:
        """Return whether the root has an attribute."""
        return h5py.h5a.exists(self._root, name.encode())

    def attributes(self) -> dict[str, Any]:
        """Return every root attribute of the schema."""
        return {name: self.attribute(name, kind) for name, kind in self.schema.attributes.items()}

    def floats(self, of: str) -> dict[str, float]:
        """Return the scalar float attributes of a dataset, whatever their names."""
        holder = self.arrays[of].id
        found: dict[str, float] = {}
        count = h5py.h5a.get_num_attrs(holder)
        if count > MAX_ATTRIBUTES:
            raise StoreFormatError(f"{of} has {count} attributes, at most {MAX_ATTRIBUTES} are read")
        for i in range(count):
            attribute = h5py.h5a.open(holder, index=i)
            if attribute.get_type().get_class() == h5py.h5t.FLOAT:
                name = attribute.name.decode()
                found[name] = read_scalar(attribute, name, float)
        return found

    def optional(self, name: str) -> Any:
        """Return a whole array, or None if the file has none of that name."""
        return self.arrays[name][...] if name in self.arrays else None

    def _check_schema(self, kinds: tuple[str, ...]) -> Schema:
        if not self.has(SCHEMA_ATTRIBUTE):
            raise StoreFormatError(
                f"it is no clrelight file: it has no attribute {SCHEMA_ATTRIBUTE}. A stack (datasets images and "
                f"directions) becomes one by two lines of Python: f = h5py.File({self.path!r}, 'a'); "
                f"f.attrs['{SCHEMA_ATTRIBUTE}'] = '{STACK.name}'"
            )
        text = _text(self._root, SCHEMA_ATTRIBUTE)
        match = re.fullmatch(r"([a-z]{1,32})/([1-9][0-9]{0,8})", text)
        wanted = " or ".join(SCHEMAS[kind].name for kind in kinds or SCHEMAS)
        if match is None or match[1] not in SCHEMAS:
            raise StoreFormatError(f"it is of the unknown schema {text[:80]!r}, expected {wanted}")
        schema = SCHEMAS[match[1]]
        if kinds and schema.kind not in kinds:
            article = "an" if text[0] in "aeiou" else "a"
            made = f" ({_MADE_BY[kinds[0]]} makes one)" if kinds[0] in _MADE_BY else ""
            first = _FIRST.get(schema.kind, "") if FIT.kind in kinds else ""
            raise StoreFormatError(f"it is {article} {text} file, expected {wanted}{first or made}")
        newest = max((each for each in (schema, *OTHERS.values()) if each.kind == schema.kind), key=lambda s: s.version)
        if int(match[2]) > newest.version:
            raise StoreFormatError(f"{text} is newer than this program reads ({newest.name}): upgrade clrelight")
        return OTHERS.get(text, schema)

    def _check_arrays(self) -> None:
        lengths: dict[str, int] = {}
        for name, array in self.arrays.items():
            self._check_array(name, array, lengths)

    def _check_required(self) -> None:
        for name, each in self.schema.fields.items():
            if each.required and name not in self.arrays:
                raise StoreFormatError(f"it has no dataset {name}, which {self.schema.name} needs")

    def _check_array(self, name: str, array: StoredArray, lengths: dict[str, int]) -> None:
        field = self.schema.field_of(name)
        if name in self.schema.scales:
            field = Field((name,), (SCALE_DTYPE,))
        if field is None:
            raise StoreFormatError(f"it has a dataset {name}, which {self.schema.name} does not know")
        if array.dtype not in field.dtypes or array.ndim != len(field.axes):
            types = " or ".join(str(t) if t.names is None else "the row type" for t in field.dtypes)
            found = array.dtype.str if array.dtype.names is None else "compound"
            raise StoreFormatError(f"{name} is {found} {array.shape}, expected {types} with {len(field.axes)} axes")
        for axis, length in zip(field.axes, array.shape, strict=True):
            if axis and lengths.setdefault(axis, length) != length:
                raise StoreFormatError(f"{name} has {length} along {axis}, another dataset has {lengths[axis]}")


@contextmanager
def opening(path: str | os.PathLike, *kinds: str, trusting: bool = False) -> Iterator[Opened]:
    """Open a file that is of one of the `kinds` (of any without), here or behind a URL.

    Who is `trusting` takes it as it is, and compares none of its checksums but those that HDF5 has itself.

    Raises
    ------
    InputError
        If there is no such file, or it may not be read; RemoteError of a URL.
    StoreFormatError
        If it is not ours, of another kind or a newer version, damaged, or made in a way we do not read.
    """
    with placed(os.fsdecode(path)) as place:
        _forget_plugins()
        with refusing(place.path):
            file = place.open()
        with file:
            with refusing(place.path):
                opened = Opened(place, file, kinds, trusting=trusting)
            yield opened


@contextmanager
def refusing(path: str) -> Iterator[None]:
    """Turn whatever HDF5 or a check says about a file's content into one line of StoreFormatError that names it."""
    try:
        with np.errstate(all="ignore"):  # checks reject absurd numbers, and need not warn of them as well
            yield
    except RemoteError:
        raise
    except InputError as error:
        message = str(error)
        raise StoreFormatError(message if message.startswith(path) else f"{path}: {message}") from error
    # A hostile file can make h5py raise nearly anything; ours are all InputError, a full memory is the caller's.
    except Exception as error:
        if isinstance(error, MemoryError):
            raise
        first = (str(error).splitlines() or [type(error).__name__])[0]
        if "truncated file" in first:
            raise StoreFormatError(f"{path} is cut short") from error
        if "already open for write" in first:
            raise StoreFormatError(f"{path} was never closed by its writer") from error
        raise StoreFormatError(f"{path} is damaged or not ours: {first}") from error


def parse_config(text: str, name: str) -> dict[str, Any]:
    """Return the object that a JSON text holds; StoreFormatError if it holds none."""
    try:
        config = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise StoreFormatError(f"attribute {name} is not valid JSON: {error}") from None
    if not isinstance(config, dict):
        raise StoreFormatError(f"attribute {name} must be a JSON object, got {text[:80]!r}")
    return config


def _text(holder: h5py.h5g.GroupID | h5py.h5d.DatasetID, name: str) -> str:
    return str(read_scalar(h5py.h5a.open(holder, name.encode()), name, str))


def _refuse_constant(text: str) -> None:
    raise ValueError(f"{text} is no JSON value")


def _forget_plugins() -> None:
    # A file names the filters it wants, and HDF5 loads them from these folders.
    while h5py.h5pl.size():
        h5py.h5pl.remove(0)
