"""Write fits for other programs' viewers, and read their files as photographs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import Bc6h, encode
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.exchange.channels import write_channels
from clrelight.exchange.coded_maps import CodedMap
from clrelight.exchange.ktx2 import write_ktx2
from clrelight.exchange.light_json import write_light_json
from clrelight.exchange.ptm import read_ptm, write_ptm
from clrelight.exchange.relight_folder import INFO, write_relight_folder
from clrelight.exchange.relight_reading import RelightFolder, read_relight_folder
from clrelight.exchange.rti import read_rti, write_rti
from clrelight.jobs.inputs import FittedLike, Packed, decoded_of, lend_fitted, opened_on, path_text, paths_among, whole
from clrelight.jobs.outputs import check_new_folder, claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.sampling import make_pattern
from clrelight.store import Sink, check_output, create_stack, read_light
from clrelight.tiles import row_tiles

FORMATS = ("relight", "ptm", "rti", "ktx2", "channels", "channels-half", "json")
"""What `export_for_viewers` writes."""
LEAST_HEIGHT = 0.15
"""z of the lowest light that an archive is photographed under."""
_MOST_LIGHTS = 1000
_PIECE_BYTES = 1 << 26
_REFITS = {"ptm": write_ptm, "rti": write_rti}
_COMPONENTS = {"channels": "float", "channels-half": "half"}
_READERS: dict[str, Callable[[str], CodedMap | RelightFolder]] = {".ptm": read_ptm, ".rti": read_rti}


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
        For ``"json"`` a light file.
    out : path
        For ``"relight"`` a new folder, else a file.
    format : str
        ``"relight"``: JPEGs and ``info.json``; ``"ptm"``: a polynomial texture map; ``"rti"``: hemispherical harmonics;
        ``"ktx2"``: BC6H blocks; ``"channels"``, ``"channels-half"``: one EXR image of all coefficients; ``"json"``:
        the nine coefficients of a light file.
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
    ending = os.path.splitext(target)[1].lower()
    if ending in (".ptm", ".rti", ".ktx2") and ending != f".{format}":
        raise InputError(f"{target} would be a file of format {format} under another one's name: end it otherwise")
    if format == "relight":
        check_new_folder(target)
    else:
        check_output(target, paths_among(source))
    since, files = time.perf_counter(), [Path(target)]
    facts: dict[str, object] = {}
    if format == "json":
        write_light_json(read_light(path_text(source, "a light file")), target)
        kept.add("export", since)
    else:
        with opened_on(device, kept) as opened, lend_fitted(source, kept) as held:
            blocks = held.encoded if isinstance(held, Packed) and held.encoded.codec == "bc6h" else None
            if format == "ktx2" and blocks is not None:  # they are passed on as they are
                write_ktx2(target, blocks)
                kept.add("export", since)
            else:
                fit = decoded_of(held, source, opened, kept, progress)
                since = time.perf_counter()
                with stage(progress, "exporting") as tell:
                    if format == "relight":
                        files = write_relight_folder(fit, target, planes=planes, quality=quality, progress=tell)
                    else:
                        facts = _write_file(fit, target, format, opened, tell)
                kept.add("export", since)
    size = sum(file.stat().st_size for file in files)
    kept.facts = {"files": [str(file) for file in files], "format": format, "bytes": size, **facts}
    return kept


def _write_file(
    fit: CoefficientMap, target: str, format: str, device: Device, tell: Callable[[int, int], None]
) -> dict[str, object]:
    """Write a fit as one file; return what is to be told of it."""
    if format in _REFITS:
        return {"refit": _REFITS[format](fit, target, progress=tell)}
    if format == "ktx2":
        write_ktx2(target, encode(fit.to_float32().coeffs_khwc, Bc6h(), device))
    else:
        write_channels(fit, target, _COMPONENTS[format], progress=tell)
    return {}


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
        A polynomial texture map of version 1.2 (RGB or LRGB, not compressed), hemispherical harmonics, or a folder with
        ``info.json`` and planes.
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
    is_folder = Path(source).is_dir() or Path(source).name == INFO
    reader = read_relight_folder if is_folder else _READERS.get(Path(source).suffix.lower())
    if reader is None:
        raise InputError(f"{source}: folders of relight, and files that end in {' or '.join(_READERS)} can be imported")
    kept = report_for(report)
    inputs = [source]
    if is_folder:
        place = Path(source).parent if Path(source).name == INFO else Path(source)
        inputs += [str(each) for each in place.iterdir()]
    with claimed([target], inputs, kept):
        since = time.perf_counter()
        found = reader(source)
        since = kept.add("read", since)
        directions_i3 = make_pattern("uniform", round(count / (1.0 - LEAST_HEIGHT)))
        directions_i3 = directions_i3[directions_i3[:, 2] >= LEAST_HEIGHT]
        blank = np.broadcast_to(np.zeros((), np.uint8), (len(directions_i3), *found.image_shape))
        name = Path(source).parent.name if Path(source).name == INFO else Path(source).stem
        stack = LightStack(blank, directions_i3, 255.0, "srgb", name=name)
        with create_stack(target, stack) as sink, stage(progress, "writing") as tell:
            _fill(found, directions_i3, sink, tell)
        kept.add("write", since)
    kept.facts = {"file": target, "lights": len(directions_i3), "shape": list(stack.images_ihwc.shape), **kept.facts}
    return kept


def _fill(
    found: CodedMap | RelightFolder, directions_i3: NDArray[np.float64], sink: Sink, tell: Callable[[int, int], None]
) -> None:
    height, width, channel = found.image_shape
    step = max(_PIECE_BYTES // (4 * channel * width * len(directions_i3)), 1)
    for first, end in row_tiles((0, height), step):
        tell(first, height)
        shown = found.display_values(directions_i3, first, end)
        sink[:, first:end] = np.rint(255.0 * shown).astype(np.uint8)
