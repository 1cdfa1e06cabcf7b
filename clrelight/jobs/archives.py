"""Read files of other programs' viewers as photographs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.exchange.coded_maps import CodedMap
from clrelight.exchange.ptm import read_ptm
from clrelight.exchange.relight_folder import INFO
from clrelight.exchange.relight_reading import RelightFolder, read_relight_folder
from clrelight.exchange.rti import read_rti
from clrelight.jobs.inputs import path_text, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.memory import TILE_BYTES
from clrelight.sampling import make_pattern
from clrelight.store import Sink, create_stack
from clrelight.tiles import row_tiles

LEAST_HEIGHT = 0.15
"""z of the lowest light that an archive is photographed under."""
_MOST_LIGHTS = 1000
_READERS: dict[str, Callable[[str], CodedMap | RelightFolder]] = {".ptm": read_ptm, ".rti": read_rti}


def import_archive(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    lights: int = 64,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Write a stack of what a ``.ptm`` or ``.rti`` file, or a relight folder shows under lights over the hemisphere.

    Parameters
    ----------
    path : path
        A polynomial texture map of version 1.2 (RGB or LRGB, also compressed by JPEG), hemispherical harmonics, or a
        folder with ``info.json`` and planes, whole or in tiles.
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
    reader = archive_reader(source)
    if reader is None and not Path(source).exists():
        raise InputError(f"there is no file or folder {source}")
    if reader is None:
        raise InputError(f"{source}: folders of relight, and files that end in {' or '.join(_READERS)} can be imported")
    kept = report_for(report)
    inputs = [source]
    if reader is read_relight_folder:
        place = Path(source).parent if Path(source).name == INFO else Path(source)
        inputs += [str(each) for each in place.iterdir()]
    with claimed([target], inputs, kept):
        since = time.perf_counter()
        found = reader(source)
        since = kept.add("read", since)
        directions_i3 = make_pattern("uniform", round(count / (1.0 - LEAST_HEIGHT)))
        directions_i3 = directions_i3[directions_i3[:, 2] >= LEAST_HEIGHT]
        blank = np.broadcast_to(np.zeros((), np.uint8), (len(directions_i3), *found.image_shape))
        name = Path(source).resolve().parent.name if Path(source).name == INFO else Path(source).stem
        stack = LightStack(blank, directions_i3, 255.0, "srgb", name=name)
        with create_stack(target, stack) as sink, stage(progress, "writing") as tell:
            _fill(found, directions_i3, sink, tell)
        kept.add("write", since)
    kept.facts = {"file": target, "lights": len(directions_i3), "shape": list(stack.images_ihwc.shape), **kept.facts}
    return kept


def archive_reader(source: str) -> Callable[[str], CodedMap | RelightFolder] | None:
    """Return what reads an archive, by its name; None where it is none."""
    if Path(source).is_dir() or Path(source).name == INFO:
        return read_relight_folder
    return _READERS.get(Path(source).suffix.lower())


def _fill(
    found: CodedMap | RelightFolder, directions_i3: NDArray[np.float64], sink: Sink, tell: Callable[[int, int], None]
) -> None:
    height, width, channel = found.image_shape
    step = max(TILE_BYTES // (4 * channel * width * len(directions_i3)), 1)
    for first, end in row_tiles((0, height), step):
        tell(first, height)
        shown = found.display_values(directions_i3, first, end)
        sink[:, first:end] = np.rint(255.0 * shown).astype(np.uint8)
