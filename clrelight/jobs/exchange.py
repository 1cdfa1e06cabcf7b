"""Write fits for other programs' viewers, and read their files as photographs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.exchange.coded_maps import CodedMap
from clrelight.exchange.ptm import read_ptm, write_ptm
from clrelight.exchange.relight_folder import write_relight_folder
from clrelight.exchange.rti import read_rti, write_rti
from clrelight.jobs.inputs import FittedLike, decoded_of, lend_fitted, opened_on, path_text, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.sampling import make_pattern
from clrelight.store import Sink, check_output, create_stack

FORMATS = ("relight", "ptm", "rti")
"""What `export_for_viewers` writes."""
LEAST_HEIGHT = 0.15
"""z of the lowest light that an archive is photographed under."""
_MOST_LIGHTS = 1000
_PIECE_BYTES = 1 << 26
_WRITERS = {"ptm": write_ptm, "rti": write_rti}
_READERS = {".ptm": read_ptm, ".rti": read_rti}


def export_for_viewers(
    source: FittedLike,
    out: str | os.PathLike[str],
    format: str,
    *,
    planes: int = 27,
    quality: int = 100,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Write a fit as OpenLIME and relight, or RTIViewer, show it (docs/textures.md).

    Parameters
    ----------
    source : path, CoefficientMap or Encoded
    out : path
        For ``"relight"`` a new folder, else a file.
    format : str
        ``"relight"``: JPEGs and ``info.json``; ``"ptm"``: a polynomial texture map; ``"rti"``: hemispherical harmonics.
    planes, quality : int
        Of a relight folder: a multiple of 3 up to 48, and the JPEGs' quality.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    Report
        Its facts hold ``files``, ``format``, ``bytes`` and, of ``"ptm"`` and ``"rti"``, ``refit``: the PSNR of display
        values that is left of the fit, at lights all over the hemisphere.

    Raises
    ------
    InputError
        If the format is unknown, the fit is no picture of 1 or 3 channels, or `out` cannot be written.
    """
    if format not in FORMATS:
        raise InputError(f"unknown format {format!r}; known are {', '.join(FORMATS)}")
    target, kept = path_text(out, "a folder or file to write"), report_for(report)
    if format != "relight":
        check_output(target, paths_among(source))
    with opened_on(device, kept) as opened, lend_fitted(source, kept) as held:
        fit = decoded_of(held, source, opened, kept, progress)
        since = time.perf_counter()
        facts: dict[str, object] = {}
        with stage(progress, "exporting") as tell:
            if format == "relight":
                files = write_relight_folder(fit, target, planes=planes, quality=quality, progress=tell)
            else:
                files = [Path(target)]
                facts["refit"] = _WRITERS[format](fit, target, progress=tell)
        kept.add("export", since)
    size = sum(file.stat().st_size for file in files)
    kept.facts = {"files": [str(file) for file in files], "format": format, "bytes": size, **facts}
    return kept


def import_archive(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    lights: int = 64,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Write a stack of what a ``.ptm`` or ``.rti`` file shows under lights spread over the hemisphere.

    Parameters
    ----------
    path : path
        A polynomial texture map of version 1.2 (RGB or LRGB, not compressed), or hemispherical harmonics.
    out : path
        The stack: 8 bits, by the sRGB curve, lights at least 9 degrees above the horizon.
    lights : int
        About how many, 4 to 1000.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    Report
        Its facts hold ``file``, ``lights`` and ``shape``.

    Raises
    ------
    InputError
        If the file is none of these, or damaged, or `out` cannot be written.
    """
    count, source, target = whole(lights, "lights"), path_text(path, "a .ptm or .rti"), path_text(out, "a stack")
    if not 4 <= count <= _MOST_LIGHTS:
        raise InputError(f"lights must be 4 to {_MOST_LIGHTS}, got {count}")
    reader = _READERS.get(Path(source).suffix.lower())
    if reader is None:
        raise InputError(f"{source}: files that end in {' or '.join(_READERS)} can be imported")
    kept = report_for(report)
    with claimed([target], [source], kept):
        since = time.perf_counter()
        found = reader(source)
        since = kept.add("read", since)
        directions_i3 = make_pattern("uniform", round(count / (1.0 - LEAST_HEIGHT)))
        directions_i3 = directions_i3[directions_i3[:, 2] >= LEAST_HEIGHT]
        blank = np.broadcast_to(np.zeros((), np.uint8), (len(directions_i3), *found.image_shape))
        stack = LightStack(blank, directions_i3, 255.0, "srgb", name=Path(source).stem)
        with create_stack(target, stack) as sink, stage(progress, "writing") as tell:
            _fill(found, directions_i3, sink, tell)
        kept.add("write", since)
    kept.facts = {"file": target, "lights": len(directions_i3), "shape": list(stack.images_ihwc.shape), **kept.facts}
    return kept


def _fill(found: CodedMap, directions_i3: NDArray[np.float64], sink: Sink, tell: Callable[[int, int], None]) -> None:
    height, width, channel = found.image_shape
    step = max(_PIECE_BYTES // (4 * channel * width * len(directions_i3)), 1)
    for first in range(0, height, step):
        tell(first, height)
        end = min(first + step, height)
        shown = found.display_values(directions_i3, first, end)
        sink[:, first:end] = np.rint(255.0 * shown).astype(np.uint8)
