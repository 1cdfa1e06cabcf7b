"""A look at everything in an HDF5 file before anything is read from it."""

from __future__ import annotations

import math
import re
from collections.abc import Container

import h5py
import numpy as np

from clrelight.errors import StoreFormatError

MAX_DEPTH = 8
MAX_OBJECTS = 100_000
MAX_CHUNK_BYTES = 256 << 20
MAX_MEMBERS = 64
CHECKSUM_BYTES = 4  # fletcher32, behind each chunk
DEFLATE_FREE_BYTES = 64 << 20
DEFLATE_RATIO = 100
"""A compressed dataset may be this many times its stored size, or `DEFLATE_FREE_BYTES`, whichever is more."""

FILTERS = {
    h5py.h5z.FILTER_DEFLATE: "deflate",
    h5py.h5z.FILTER_SHUFFLE: "shuffle",
    h5py.h5z.FILTER_FLETCHER32: "fletcher32",
}

_NAME = re.compile(rb"[A-Za-z0-9_]{1,64}")


def walk(file: h5py.File, file_bytes: int, known: Container[str]) -> dict[str, h5py.Dataset]:
    """Return datasets by their paths, having refused whatever could lead out of the file or out of memory.

    Groups are listed by name, one at a time, because a look-up by path follows links of every kind on its way. Only
    hard links to groups and datasets are taken, and no object twice, so that there is no cycle.

    Parameters
    ----------
    file : h5py.File
    file_bytes : int
        Its size.
    known : container of str
        Names in the root that are looked at; what others stand for is never opened.

    Raises
    ------
    StoreFormatError
        At the first thing that is refused.
    """
    root = h5py.h5g.open(file.id, b"/")
    found: dict[str, h5py.Dataset] = {}
    seen = {h5py.h5o.get_info(root).addr}
    pending = [(root, "", 1)]
    while pending:
        group, prefix, depth = pending.pop()
        if depth > MAX_DEPTH:
            raise StoreFormatError(f"group {prefix} lies deeper than {MAX_DEPTH}")
        if len(seen) + group.get_num_objs() > MAX_OBJECTS:
            raise StoreFormatError(f"it holds more than {MAX_OBJECTS} objects")
        for raw in list(group):
            if group.links.get_info(raw).type != h5py.h5l.TYPE_HARD:
                shown = prefix + raw[:80].decode("utf-8", "backslashreplace")
                raise StoreFormatError(f"{shown} is a soft or external link, which are not followed")
            if not prefix and raw.decode("utf-8", "replace") not in known:
                continue
            name = _checked_name(raw, prefix)
            entry = h5py.h5o.open(group, raw)
            address = h5py.h5o.get_info(entry).addr
            if address in seen:
                raise StoreFormatError(f"{name} is linked twice")
            seen.add(address)
            if isinstance(entry, h5py.h5g.GroupID):
                pending.append((entry, f"{name}/", depth + 1))
            elif isinstance(entry, h5py.h5d.DatasetID):
                _check_dataset(entry, name, file_bytes)
                found[name] = h5py.Dataset(entry)
            else:
                raise StoreFormatError(f"{name} is neither a group nor a dataset")
    return found


def _checked_name(raw: bytes, prefix: str) -> str:
    if not _NAME.fullmatch(raw):
        raise StoreFormatError(f"it has an object of the name {prefix.encode() + raw[:80]!r}, which is none of ours")
    return prefix + raw.decode()


def _check_dataset(dataset: h5py.h5d.DatasetID, name: str, file_bytes: int) -> None:
    plan = dataset.get_create_plist()
    if plan.get_layout() not in (h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS, h5py.h5d.CHUNKED):
        raise StoreFormatError(f"{name} is a virtual dataset, whose values lie elsewhere")
    if plan.get_external_count():
        raise StoreFormatError(f"{name} keeps its values in another file")
    _check_type(dataset.get_type(), name)
    if dataset.get_space().get_simple_extent_type() == h5py.h5s.NULL:
        raise StoreFormatError(f"{name} has no shape")
    filters = [plan.get_filter(i)[0] for i in range(plan.get_nfilters())]
    for code in filters:
        if code not in FILTERS or filters.count(code) > 1:
            raise StoreFormatError(
                f"{name} has filter {code}; read are {', '.join(FILTERS.values())}, once each: store it with gzip or "
                f"without compression"
            )
    _check_size(dataset, plan, name, file_bytes, filters)


def _check_size(
    dataset: h5py.h5d.DatasetID, plan: h5py.h5p.PropDCID, name: str, file_bytes: int, filters: list[int]
) -> None:
    itemsize = dataset.get_type().get_size()
    declared, stored = math.prod(dataset.shape) * itemsize, dataset.get_storage_size()
    largest = stored
    if h5py.h5z.FILTER_DEFLATE in filters:
        largest = max(DEFLATE_FREE_BYTES, DEFLATE_RATIO * stored)
    if stored > file_bytes or declared > largest:
        raise StoreFormatError(f"{name} should hold {declared} bytes, {stored} are stored")
    if plan.get_layout() == h5py.h5d.CHUNKED:
        _check_chunks(dataset, plan.get_chunk(), name, filters)


def _check_chunks(dataset: h5py.h5d.DatasetID, chunks: tuple[int, ...], name: str, filters: list[int]) -> None:
    """Refuse chunks that are missing (they read as zeros) or short (HDF5 2.0 reads on behind them and crashes)."""
    chunk_bytes = math.prod(chunks) * dataset.get_type().get_size()
    if chunk_bytes > MAX_CHUNK_BYTES:
        raise StoreFormatError(f"{name} has chunks of more than {MAX_CHUNK_BYTES >> 20} MiB")
    expected = chunk_bytes + CHECKSUM_BYTES * (h5py.h5z.FILTER_FLETCHER32 in filters)
    deflated = h5py.h5z.FILTER_DEFLATE in filters  # their sizes are checked as they are read
    count, wrong = 0, 0

    def look(info: h5py.h5d.StoreInfo) -> None:
        nonlocal count, wrong
        count += 1
        wrong += info.filter_mask != 0 or not (deflated or info.size == expected)

    dataset.chunk_iter(look)
    wanted = math.prod(-(-n // c) for n, c in zip(dataset.shape, chunks, strict=True))
    if count != wanted or wrong:
        raise StoreFormatError(f"{name} should have {wanted} chunks of {expected} bytes, {count - wrong} are so")


def _check_type(held: h5py.h5t.TypeID, name: str) -> None:
    if held.get_class() == h5py.h5t.COMPOUND:
        count = held.get_nmembers()
        if count > MAX_MEMBERS:
            raise StoreFormatError(f"{name} has rows of {count} members, at most {MAX_MEMBERS} are read")
        for i in range(count):
            member = held.get_member_type(i)
            fixed = member.get_class() == h5py.h5t.STRING and not member.is_variable_str()
            if not fixed:
                _check_number(member, name)
    else:
        _check_number(held, name)


def _check_number(held: h5py.h5t.TypeID, name: str) -> None:
    if held.get_class() == h5py.h5t.ENUM and held.get_size() == 1 and held.dtype == np.bool_:
        return  # which h5py writes as an enumeration of FALSE and TRUE
    if held.get_class() not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT) or held.get_size() > 8:
        raise StoreFormatError(f"{name} holds something else than integers and floats")
