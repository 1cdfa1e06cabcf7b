"""Reflection maps under turned light, as files."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

import numpy as np

from clrelight.errors import InputError
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.harmonics.rotations import make_rotations
from clrelight.jobs.inputs import path_text, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.pictures import name_pictures
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.surface.frames import rotation_of
from clrelight.shrm.record import Shrm
from clrelight.shrm.rotation import map_degree, turn_shrm
from clrelight.store import read_shrm, write_shrm

_TURNS_AT_ONCE = 64


def rotate_reflection(
    source: Shrm | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    rotate: tuple[str, Sequence[float]] | float | None = None,
    turntable: int | None = None,
    about: Sequence[float] = (0.0, 0.0, 1.0),
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Write a reflection map under turned light, or many while the light goes round once.

    The matrices are made once, and turn all maps of all coefficients (`shrm.rotation.turn_shrm`).

    Parameters
    ----------
    source : Shrm or path
    out : path
        Several need a number field such as ``%03d``.
    rotate : float or (str, numbers), optional
        Degrees about z, or a form and numbers of `harmonics.rotation.rotation_matrix`.
    turntable : int, optional
        So many maps, the light going round once after `rotate`.
    about : three numbers
        Axis of the turntable.
    progress, report : optional

    Raises
    ------
    InputError
        If nothing is to be turned, the axis is none, the map has too few rows, or `out` cannot be written.
    """
    kept = report_for(report)
    target = path_text(out, "a reflection map to write")
    if rotate is None and turntable is None:
        raise InputError("say how the light turns: --rotate, --turntable N or both")
    if turntable is not None and turntable < 1:
        raise InputError(f"a turntable has 1 map at least, got {turntable}")
    count = turntable or 1
    if count > 1 and "%" not in os.path.basename(target):
        raise InputError(f"{count} maps need a number field in their name, such as turned%03d.h5, got {target!r}")
    names = name_pictures(target, count)
    turned = np.eye(3) if rotate is None else rotation_of(rotate)
    matrices_i33 = np.stack([rotation_matrix("axis", (*about, 360.0 * i / count)) @ turned for i in range(count)])
    with claimed(names, paths_among(source), kept):
        since = time.perf_counter()
        shrm = source if isinstance(source, Shrm) else read_shrm(source)
        since = kept.add("read", since)
        done = 0
        with stage(progress, "turning") as tell:
            for first in range(0, count, _TURNS_AT_ONCE):
                rotations = make_rotations(matrices_i33[first : first + _TURNS_AT_ONCE], map_degree(shrm))
                for made in turn_shrm(shrm, rotations):
                    since = kept.add("turn", since)
                    write_shrm(names[done], made)
                    since = kept.add("write", since)
                    done += 1
                    tell(done, count)
    kept.facts = {"files": names, "degree": shrm.degree, "order": shrm.order, "frame": "global"}
    return kept
