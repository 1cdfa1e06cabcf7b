"""``shrm/1``: reflection maps with coefficients of the view."""

from __future__ import annotations

import os

from clrelight.shrm.record import Shrm
from clrelight.store.opening import Opened, opening, parse_config, refusing
from clrelight.store.schemas import SHRM
from clrelight.store.writing import chunk_shape, config_text, drafting, padded_bytes

_AXES = ("coefficient", "height", "width", "channel")


def write_shrm(path: str | os.PathLike, shrm: Shrm) -> None:
    """Write a reflection map; InputError if the file cannot be written."""
    maps_khwc = shrm.maps_khwc
    chunks = chunk_shape(maps_khwc.shape, maps_khwc.itemsize)
    with drafting(path, SHRM, padded_bytes(maps_khwc.shape, chunks, maps_khwc.itemsize)) as draft:
        draft.attributes({"frame": shrm.frame, "degree": shrm.degree, "centre": shrm.centre})
        draft.attributes({"source": shrm.source, "axes": shrm.axes, "config": config_text(shrm.config)})
        draft.sink("maps", maps_khwc.shape, maps_khwc.dtype, _AXES, chunks)[...] = maps_khwc


def read_shrm(path: str | os.PathLike) -> Shrm:
    """Read a reflection map; errors as of `open_fit`."""
    with opening(path, "shrm") as opened, refusing(opened.path):
        return shrm_of(opened)


def shrm_of(opened: Opened) -> Shrm:
    """Return the reflection map in an open file; StoreFormatError or InputError if it is not sound."""
    held = opened.attributes()
    config = parse_config(held["config"], "config")
    maps_khwc = opened.arrays["maps"][...]
    return Shrm(maps_khwc, held["frame"], held["degree"], held["centre"], held["source"], held["axes"], config)
