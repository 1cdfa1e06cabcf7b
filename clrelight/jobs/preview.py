"""A picture of a file: as an image, or within a copy of an encoding, for programs that know HDF5 and no codec."""

from __future__ import annotations

import os
import time

from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.jobs.inputs import path_text
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Report, report_for
from clrelight.jobs.thumbnail import thumbnail
from clrelight.store import file_schema, read_encoded, write_encoded

_HDF5 = (".h5", ".hdf5")


def preview(
    source: str | os.PathLike[str], out: str | os.PathLike[str], *, size: int = 256, report: Report | None = None
) -> Report:
    """Write a picture of a file of ours.

    Parameters
    ----------
    source : path
        A stack (shown by its photograph nearest to a light from the upper left), a fit or an encoding (under that
        light), results, a light or a reflection map.
    out : path
        An image; or, of an encoding, ``.h5``: a copy that holds the picture, on which h5web, silx and the like open.
    size : int
        Pixels of the longer side, at most.
    report : Report, optional
        Filled.

    Returns
    -------
    Report
        Its ``facts`` are ``file``, ``size`` (width and height) and ``bytes_on_disk``.

    Raises
    ------
    InputError
        If the file is not sound or holds no picture, or `out` cannot be written.
    """
    kept = report_for(report)
    if not 1 <= size <= 4096:
        raise InputError(f"size must be from 1 to 4096 pixels, got {size}")
    within = path_text(out, "a file to write").lower().endswith(_HDF5)
    kind = file_schema(source).partition("/")[0]
    if within and kind != "encoded":
        raise InputError(f"a copy that holds a picture is for encodings, {source} is a {kind}: give OUT.png")
    with claimed([out], [source], kept):
        since = time.perf_counter()
        picture_hwc = thumbnail(source, size)
        since = kept.add("draw", since)
        if picture_hwc is None:
            raise InputError(f"{source} holds no picture, or one that takes long; relight shows it")
        if within:
            write_encoded(out, read_encoded(source)[0], picture_hwc=picture_hwc)
        else:
            write_image(out, picture_hwc)
        kept.add("write", since)
    height, width, _ = picture_hwc.shape
    kept.facts = {"file": os.fsdecode(out), "size": [width, height], "bytes_on_disk": os.stat(out).st_size}
    return kept
