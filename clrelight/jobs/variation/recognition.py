"""Say whose photographs these are: distances to the pictures that each subject of a gallery can show."""

from __future__ import annotations

import csv as csv_format
import io
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import check_transfer
from clrelight.durable import replacing
from clrelight.errors import InputError
from clrelight.jobs.inputs import path_text, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.variation.gallery import Subject, read_gallery, read_linear, shrink
from clrelight.threads import on_one_thread
from clrelight.variation.recognition import SPACES

_LEAST_PIXELS = 32
"""That all subjects share; nine numbers a channel are fitted to them."""
PIXELS = ("common", "all")
PathLike = str | os.PathLike[str]


@dataclass(frozen=True)
class Recognised:
    """Distances of photographs to subjects.

    Attributes
    ----------
    photographs, subjects, spaces : tuple of str
    distance_spn : ndarray, shape (space, photograph, subject), float64
        What the subject's pictures leave of the photograph, as a share of its root mean square.
    """

    photographs: tuple[str, ...]
    subjects: tuple[str, ...]
    spaces: tuple[str, ...]
    distance_spn: NDArray[np.float64]

    def ranks(self, space: str, photograph: int) -> list[tuple[str, float, float | None]]:
        """Return subjects, the nearest first: name, distance, and by how much the next is further away."""
        distance_n = self.distance_spn[self.spaces.index(space), photograph]
        order = np.argsort(distance_n, kind="stable")
        further = [*np.diff(distance_n[order]).tolist(), None]
        return [(self.subjects[n], float(distance_n[n]), more) for n, more in zip(order, further, strict=True)]


def recognise(
    gallery: PathLike,
    photographs: Sequence[PathLike],
    *,
    spaces: Sequence[str] = ("9d",),
    pixels: str = "common",
    side: int = 256,
    transfer: str = "linear",
    green: str = "up",
    csv: PathLike | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Recognised:
    """Return how far photographs are from what each subject of a gallery can show under any distant light.

    Parameters
    ----------
    gallery : path
        A folder. Each folder in it is a subject, of a picture ``normals`` and maybe ``albedo``, or of photographs,
        under known lights where an ``.lp`` file is beside them; each ``.h5`` file is one, a stack.
    photographs : sequence of path
        Of the same view and size.
    spaces : sequence of str
        Of `clrelight.variation.recognition.SPACES`.
    pixels : str
        ``"common"``: those inside the masks of all subjects, so that outlines and backgrounds tell nothing;
        ``"all"``: those inside any, where a subject is black beside its own.
    side : int
        Pixels of the longer side that pictures are shrunk to.
    transfer : str
        Of photographs: ``"linear"`` or ``"srgb"``.
    green : str
        Which way the second channel of normals grows.
    csv : path, optional
        A table of all distances.
    progress, report
        As of other verbs.

    Raises
    ------
    InputError
        If a subject or a photograph cannot be read, or is black, sizes differ, or the subjects share hardly a pixel.
    """
    kept, since = report_for(report), time.perf_counter()
    names = tuple(spaces)
    check_transfer(transfer)
    unknown = [name for name in names if name not in SPACES]
    if unknown or not names:
        raise InputError(f"spaces are {', '.join(SPACES)}, got {', '.join(unknown) or 'none'}")
    if pixels not in PIXELS:
        raise InputError(f"pixels must be {' or '.join(PIXELS)}, got {pixels!r}")
    if whole(side, "side") < 8:
        raise InputError(f"side must be at least 8 pixels, got {side}")
    if isinstance(photographs, str | os.PathLike) or not photographs:
        raise InputError("expected a list of one or more photographs")
    with claimed([csv], paths_among(*photographs), kept):
        folder = Path(path_text(gallery, "a gallery"))
        with stage(progress, "reading the gallery"):
            subjects, factor = read_gallery(folder, side, transfer, green, kept)
        inside_hw = _shared(subjects, pixels)
        seen = [_photograph(each, factor, transfer, inside_hw, folder) for each in photographs]
        if any(each.shape[1] == 1 for each in seen) and any(subject.channels > 1 for subject in subjects):
            kept.note("some photographs are grey: all pictures are compared in grey")
            subjects = [each.grey() for each in subjects]
            seen = [each.mean(axis=1, keepdims=True) for each in seen]
        since = kept.add("read", since)
        distance_spn = np.empty((len(names), len(seen), len(subjects)))
        with on_one_thread(), stage(progress, "comparing") as tell:
            for n, subject in enumerate(subjects):
                found = subject.spaces(inside_hw, names)
                for s, name in enumerate(names):
                    distance_spn[s, :, n] = [found[name].distance(each) for each in seen]
                tell(n + 1, len(subjects))
        kept.add("compare", since)
        result = Recognised(
            tuple(os.fsdecode(each) for each in photographs), tuple(each.name for each in subjects), names, distance_spn
        )
        _tell(result, subjects, inside_hw, factor, kept)
        if csv is not None:
            _write_csv(csv, result)
            kept.facts["file"] = os.fsdecode(csv)
    return result


def _shared(subjects: Sequence[Subject], pixels: str) -> NDArray[np.bool_]:
    masks = np.stack([each.mask_hw for each in subjects])
    inside_hw: NDArray[np.bool_] = (np.logical_and if pixels == "common" else np.logical_or).reduce(masks, axis=0)
    if np.count_nonzero(inside_hw) < _LEAST_PIXELS:
        raise InputError(
            f"the subjects share {np.count_nonzero(inside_hw)} pixels, expected at least {_LEAST_PIXELS}: do they lie "
            "alike? (pixels all compares outlines too)"
        )
    return inside_hw


def _photograph(
    path: PathLike, factor: int, transfer: str, inside_hw: NDArray[np.bool_], folder: Path
) -> NDArray[np.float32]:
    values_hwc = read_linear(path_text(path, "a photograph"), transfer)
    small_hwc = shrink(values_hwc, factor)
    if small_hwc.shape[:2] != inside_hw.shape:
        raise InputError(
            f"{os.fsdecode(path)} is {values_hwc.shape[1]}×{values_hwc.shape[0]}, unlike the subjects of {folder}"
        )
    if not small_hwc[inside_hw].any():
        raise InputError(f"{os.fsdecode(path)} is black where the subjects are: it shows nobody")
    return small_hwc[inside_hw]


def _tell(
    result: Recognised, subjects: Sequence[Subject], inside_hw: NDArray[np.bool_], factor: int, report: Report
) -> None:
    if factor > 1:
        report.note(f"pictures were shrunk by {factor}")
    report.facts |= {
        "subjects": [{"name": each.name, "kind": each.kind} for each in subjects],
        "pixels": int(np.count_nonzero(inside_hw)),
        "photographs": [
            {
                "photograph": photograph,
                "space": space,
                "subject": ranks[0][0],
                "distance": ranks[0][1],
                "margin": ranks[0][2],
                "ranks": [{"subject": name, "distance": distance} for name, distance, _ in ranks],
            }
            for p, photograph in enumerate(result.photographs)
            for space in result.spaces
            for ranks in [result.ranks(space, p)]
        ],
    }


def _write_csv(path: PathLike, result: Recognised) -> None:
    text = io.StringIO()
    table = csv_format.writer(text, lineterminator="\n")
    table.writerow(["photograph", "space", "rank", "subject", "distance", "margin"])
    for p, photograph in enumerate(result.photographs):
        for space in result.spaces:
            for rank, (name, distance, margin) in enumerate(result.ranks(space, p), start=1):
                table.writerow([photograph, space, rank, name, distance, "" if margin is None else margin])
    with replacing(os.fsdecode(path)) as part:
        part.write(text.getvalue().encode("utf-8"))
