"""HDF5 files and datasets as h5py's own verbs do not make them."""

from __future__ import annotations

import os

import h5py
import numpy as np

_META_BYTES = 64
"""Pieces in which HDF5 takes room for its own records in a small file; by default they are 2 KiB."""
_MOST_ATTRIBUTES = 64
"""Of the root, in its header; a heap of their own takes kilobytes."""


def create_in_memory(name: str, block_bytes: int) -> h5py.File:
    """Return a new file in memory, which grows by so many bytes, and leaves few of its own unused."""
    access = _access()
    access.set_fapl_core(block_bytes, False)
    access.set_meta_block_size(_META_BYTES)
    return _create(name, access)


def create_on_disk(path: str | os.PathLike[str]) -> h5py.File:
    """Return a new file without a lock or a cache: every chunk goes there when it is written, with one copy less."""
    access = _access()
    access.set_file_locking(False, True)
    access.set_cache(*access.get_cache()[:2], 0, 1.0)
    return _create(os.fspath(path), access)


def create_compact(file: h5py.File, name: str, shape: tuple[int, ...], dtype: np.dtype) -> h5py.Dataset:
    """Return a new dataset whose values, less than 64 KiB, lie among HDF5's own records."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.COMPACT)
    properties.set_obj_track_times(False)
    links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    links.set_create_intermediate_group(True)
    space, held = h5py.h5s.create_simple(shape), h5py.h5t.py_create(dtype, logical=True)
    return h5py.Dataset(h5py.h5d.create(file.id, name.encode(), held, space, properties, links))


def _access() -> h5py.h5p.PropFAID:
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_LATEST, h5py.h5f.LIBVER_LATEST)
    access.set_fclose_degree(h5py.h5f.CLOSE_STRONG)
    return access


def _create(name: str, access: h5py.h5p.PropFAID) -> h5py.File:
    creation = h5py.h5p.create(h5py.h5p.FILE_CREATE)
    creation.set_attr_phase_change(_MOST_ATTRIBUTES, 0)
    creation.set_obj_track_times(False)
    return h5py.File(h5py.h5f.create(os.fsencode(name), h5py.h5f.ACC_TRUNC, creation, access))
