"""The parts of `unpack` as jobs: a part of the image under all lights, and a photograph of all parts."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from clrelight.codec.views import Region
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.jobs.farm import read_arrays, read_one_array, write_arrays
from clrelight.jobs.inputs import lend_encoded, opened_on
from clrelight.jobs.report import Report, report_for
from clrelight.relight import to_display

PART, LIGHT = "unpack-part", "unpack-light"


def relight_part(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    lights: str,
    sides: Sequence[int],
    transfer: str | None,
    device: Device | str | None = None,
    report: Report | None = None,
) -> Report:
    """Relight a part of a packed view.

    Parameters
    ----------
    source : path
        The encoded file.
    out : path
        Gets an array (rows, columns, channel) for each light, called by its number.
    lights : path
        Of arrays, ``directions_i3`` among them.
    sides : top, left, bottom, right
    transfer : str or None
        The curve of 8-bit images; None: linear radiance in floats.
    device, report
        As of `clrelight.jobs.unpack.unpack`.

    Raises
    ------
    InputError
        If the file is damaged there.
    """
    kept = report_for(report)
    with opened_on(device, kept) as opened, lend_encoded(source, kept, parts=True) as packed:
        regions, directions_i3 = packed.regions_of(os.fsdecode(source)), read_arrays(lights)["directions_i3"]
        relit_ihwc = regions.relight_region(directions_i3, Region(*sides), opened)
    shown_ihwc = relit_ihwc if transfer is None else to_display(relit_ihwc, transfer)
    write_arrays(out, {str(light): rows_hwc for light, rows_hwc in enumerate(shown_ihwc)})
    return kept


def write_light(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    light: int,
    shape: Sequence[int],
    parts: Sequence[str],
    places: Sequence[Sequence[int]],
    report: Report | None = None,
) -> Report:
    """Write a photograph from its parts.

    Parameters
    ----------
    source : path
        The encoded file, which is not read.
    out : path
        The picture, whose ending says what it is.
    light : int
    shape : height, width, channel
    parts : sequence of path
        Of `relight_part`, in the folder of `out`.
    places : sequence of (top, left)
        Of each part.
    report : Report, optional

    Raises
    ------
    InputError
        If a part or the picture cannot be read or written.
    """
    folder = os.path.dirname(os.fsdecode(out))
    image_hwc = None
    for name, (top, left) in zip(parts, places, strict=True):
        rows_hwc = read_one_array(os.path.join(folder, name), str(light))
        if image_hwc is None:
            image_hwc = np.empty(tuple(shape), rows_hwc.dtype)
        image_hwc[top : top + rows_hwc.shape[0], left : left + rows_hwc.shape[1]] = rows_hwc
    if image_hwc is None:
        raise InputError("a photograph has no parts")
    write_image(out, image_hwc)
    return report_for(report)
