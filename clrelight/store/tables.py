"""``results/1``: the table of an experiment with its pictures and profiles."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, StoreFormatError
from clrelight.results import Results
from clrelight.store.opening import Opened, opening, refusing
from clrelight.store.schemas import RESULTS
from clrelight.store.writing import Draft, drafting

MAX_ITEMS = 40_000
"""Of pictures, and of profiles: a reader takes no more than 100 000 objects."""

_CHUNK_ROWS = 512


def write_results(path: str | os.PathLike, results: Results) -> None:
    """Write results; the keys of pictures and profiles hold slashes, so they are attributes of numbered datasets.

    Raises
    ------
    InputError
        If a picture or a profile is not of the type that `Results` says, or the file cannot be written.
    """
    _check_items("pictures", results.pictures, np.uint8, 3)
    _check_items("profiles", results.profiles, np.float64, 1)
    items: list[NDArray] = [*results.pictures.values(), *results.profiles.values()]
    n_bytes = results.table.nbytes + sum(item.nbytes + 4096 for item in items)
    with drafting(path, RESULTS, n_bytes) as draft:
        draft.dataset("table", results.table, chunks=(min(len(results.table), _CHUNK_ROWS),))
        _write_items(draft, "pictures/p", results.pictures)
        _write_items(draft, "profiles/c", results.profiles)


def read_results(path: str | os.PathLike) -> Results:
    """Read results; errors as of `open_fit`."""
    with opening(path, "results") as opened, refusing(opened.path):
        return results_of(opened)


def results_of(opened: Opened) -> Results:
    """Return the results in an open file; StoreFormatError if they are not sound."""
    return Results(opened.arrays["table"][...], _read_items(opened, "pictures/"), _read_items(opened, "profiles/"))


def _check_items(group: str, items: Mapping[str, NDArray], dtype: type, ndim: int) -> None:
    if len(items) > MAX_ITEMS:
        raise InputError(f"at most {MAX_ITEMS} {group} fit a file, got {len(items)}")
    for key, item in items.items():
        if item.dtype != dtype or item.ndim != ndim or not item.size:
            raise InputError(
                f"{group}: {key} must be {np.dtype(dtype)} with {ndim} axes, got {item.dtype} {item.shape}"
            )


def _write_items(draft: Draft, prefix: str, items: Mapping[str, NDArray]) -> None:
    for i, (key, item) in enumerate(items.items()):
        draft.attributes({"key": key}, of=draft.dataset(f"{prefix}{i:05d}", item))


def _read_items(opened: Opened, prefix: str) -> dict[str, NDArray]:
    items: dict[str, NDArray] = {}
    for name in sorted(n for n in opened.arrays if n.startswith(prefix)):
        key = opened.attribute("key", str, of=name)
        if key in items:
            raise StoreFormatError(f"{name} has the key {key!r} of another one")
        items[key] = opened.arrays[name][...]
    return items
