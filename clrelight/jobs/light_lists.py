"""Write the lights of stacks, fits and encodings as ``.lp`` files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.directions import unit_directions
from clrelight.errors import InputError
from clrelight.jobs.inputs import FittedLike, Packed, lend_fitted, lend_stack, path_text, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.pictures import name_pictures
from clrelight.jobs.report import Report, report_for
from clrelight.light_files import read_light_file, write_lp
from clrelight.store import file_schema

_OURS = (".h5", ".hdf5")
_NO_NAME = ("#", "%", "//", '"', "'")
"""What readers take for a comment, or a quote that ends somewhere."""


def export_lights(
    source: FittedLike | LightStack,
    out: str | os.PathLike[str],
    *,
    names: str = "%03d.png",
    report: Report | None = None,
) -> Report:
    """Write the directions of lights as an ``.lp`` file: a number of lines, then a name, x, y and z of each.

    Parameters
    ----------
    source : path, LightStack, CoefficientMap or Encoded
        The lights of a stack, those that a fit was made of, or those of a light file in any form that ``ingest`` reads.
    out : path
    names : str
        What images are called, with a number field that counts from 0; a light file's own names are kept.
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    Report
        Its facts hold ``file`` and ``lights``.

    Raises
    ------
    InputError
        If there are no lights, or `out` cannot be written.
    """
    target, kept = path_text(out, "an .lp file"), report_for(report)
    with claimed([target], paths_among(source), kept):
        known, directions_i3 = _lights(source, kept)
        if not len(directions_i3):
            raise InputError("it holds no directions of lights")
        called = list(known) or name_pictures(names, len(directions_i3))
        if any(len(each.split()) != 1 or each.startswith(_NO_NAME) for each in called):
            raise InputError("names of images in an .lp file have no blanks in them, nor begin with one of # % \" ' //")
        write_lp(target, called, directions_i3)
    kept.facts = {"file": target, "lights": len(directions_i3), "bytes": os.path.getsize(target), **kept.facts}
    return kept


def _lights(source: FittedLike | LightStack, report: Report) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    if isinstance(source, LightStack):
        return (), source.directions_i3
    if isinstance(source, str | os.PathLike):
        path = Path(os.fsdecode(source))
        if path.suffix.lower() not in _OURS and path.is_file():
            file = read_light_file(path)
            report.note(*file.notes, *file.count_notes())
            return file.names, unit_directions(file.directions_i3, file.label, allow_below=True)
        if file_schema(path).startswith("stack/"):
            with lend_stack(path, report) as stack:
                return (), stack.directions_i3
    with lend_fitted(source, report, any_basis=True, parts=True) as held:
        record: CoefficientMap = held.record if isinstance(held, Packed) else held  # type: ignore[assignment]
        return (), np.asarray(record.directions_i3)
