"""A picture of a file: an image, or within a copy of an encoding, for programs that know HDF5 and no codec."""

from __future__ import annotations

import os
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import Encoded
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.jobs.inputs import path_text
from clrelight.jobs.outputs import claimed
from clrelight.jobs.pictures import check_display
from clrelight.jobs.report import Report, report_for
from clrelight.jobs.thumbnail import has_levels, thumbnail, thumbnail_of_encoded, thumbnail_of_fit
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
        picture_hwc = thumbnail(source, size, is_patient=True)
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


def check_preview(path: str | os.PathLike[str], out: str | os.PathLike[str] | None) -> None:
    """Raise InputError, before long work, where no picture of this name can be written beside `out`."""
    if out is None:
        raise InputError("preview is a picture beside a file: give out, the file, too")
    check_display(path_text(path, "a picture to write"))


def draw_preview(
    encoded: Encoded, fit: CoefficientMap | FitRecord, device: Device, report: Report
) -> NDArray[np.uint8]:
    """Return a small picture of what an encoding decodes to, under the light of `preview`.

    Of a large map by a codec without levels, which would have to be decoded whole, it is the fit as it went in where
    that is at hand, and a note says so.

    Raises
    ------
    InputError
        If what is encoded is no image but a list of vertices.
    """
    since = time.perf_counter()
    if min(encoded.shape[1:3]) == 1:
        raise InputError("a list of vertices has no preview; clrelight render shows it")
    record = FitRecord.of(fit) if isinstance(fit, CoefficientMap) else fit
    # What was just coded takes less to decode; a fit that is at hand takes less still.
    is_patient = has_levels(encoded.codec) or not isinstance(fit, CoefficientMap)
    picture_hwc = thumbnail_of_encoded(
        replace(encoded, record=record), encoded.codec, encoded.shape, device=device, is_patient=is_patient
    )
    if picture_hwc is None:
        assert isinstance(fit, CoefficientMap)
        report.note(f"the preview shows the fit before it was coded: {encoded.codec} has no lower resolution to decode")
        picture_hwc = thumbnail_of_fit(fit)
    report.add("preview", since)
    return picture_hwc


def write_preview(path: str | os.PathLike[str], picture_hwc: NDArray[np.uint8], report: Report) -> None:
    """Write what `draw_preview` returned; the report's ``preview`` names it, with width and height."""
    write_image(path, picture_hwc)
    height, width, _ = picture_hwc.shape
    report.facts["preview"] = {"file": os.fsdecode(path), "size": [width, height]}
