"""Write the file of a fit whose rows lie in shards: what it is of, where its rows are, and their seals."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence

import h5py
import numpy as np

from clrelight.dataset import FitRecord
from clrelight.errors import InputError
from clrelight.store.fits import write_record
from clrelight.store.opening import Opened, opening
from clrelight.store.schemas import FIT, TILES
from clrelight.store.shards import MOST_SHARDS, TILED, seal_in, shard_name
from clrelight.store.writing import drafting


def write_tiles(
    path: str | os.PathLike[str], record: FitRecord, folder: str | os.PathLike[str], ends: Sequence[int]
) -> None:
    """Write the file of a fit whose rows lie in shards, which are opened and looked at.

    Parameters
    ----------
    path : path
    record : FitRecord
        Of the whole fit.
    folder : path
        Beside the file, where the shards lie under their names (`shards.shard_name`).
    ends : sequence of int
        Behind the last row of each shard, from top to bottom.

    Raises
    ------
    InputError
        If the file cannot be written; StoreFormatError if a shard is not sound.
    """
    place, beside = os.path.abspath(os.fsdecode(folder)), os.path.dirname(os.path.abspath(os.fsdecode(path)))
    if os.path.dirname(place) != beside:
        raise InputError(f"the shards in {place} do not lie in a folder beside {os.fsdecode(path)}")
    if not 0 < len(ends) <= MOST_SHARDS:
        raise InputError(f"a fit has from 1 to {MOST_SHARDS} shards, got {len(ends)}: make them larger")
    seals, layouts = [], _Layouts(ends[-1])
    for first, end in zip([0, *ends], ends, strict=False):
        name = shard_name(first, end)
        with opening(os.path.join(place, name), FIT.kind) as opened:
            seals.append(seal_in(opened))
            layouts.add(f"{os.path.basename(place)}/{name}", opened, first, end)
    manifest = {"folder": os.path.basename(place), "ends": list(ends), "seals": seals}
    with drafting(path, TILES, 4096 * (4 + len(ends))) as draft:
        write_record(draft, record, "config")
        draft.attributes({"shards": json.dumps(manifest, separators=(",", ":"))})
        layouts.write(draft.file)


class _Layouts:
    """What HDF5 is told of where rows lie, for other programs."""

    def __init__(self, height: int) -> None:
        self._height = height
        self._made: dict[str, tuple[np.dtype, tuple[int, ...], h5py.h5p.PropDCID]] = {}

    def add(self, file: str, opened: Opened, first: int, end: int) -> None:
        """Say that some rows of each array lie in an open file."""
        for name, axis in TILED.items():
            if name not in opened.arrays:
                continue
            held = opened.arrays[name]
            if name not in self._made:
                properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
                properties.set_obj_track_times(False)
                if name == "coefficients":  # no black where a file is missing
                    properties.set_fill_value(np.array(np.nan, held.dtype))
                shape = (*held.shape[:axis], self._height, *held.shape[axis + 1 :])
                self._made[name] = held.dtype, shape, properties
            _, shape, properties = self._made[name]
            rows = h5py.h5s.create_simple(shape)
            rows.select_hyperslab((*(0,) * axis, first, *(0,) * (len(shape) - axis - 1)), held.shape)
            properties.set_virtual(rows, file.encode(), name.encode(), h5py.h5s.create_simple(held.shape))

    def write(self, file: h5py.File) -> None:
        """Make the datasets."""
        for name, (dtype, shape, properties) in self._made.items():
            held = h5py.h5t.py_create(dtype, logical=True)
            h5py.h5d.create(file.id, name.encode(), held, h5py.h5s.create_simple(shape), properties)
