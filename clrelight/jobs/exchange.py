"""Write fits for other programs' viewers."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import bytes_to_decode, decode_stream
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.directions import unit_directions
from clrelight.errors import InputError, unknown
from clrelight.exchange.channels import write_channels
from clrelight.exchange.ktx2 import write_ktx2
from clrelight.exchange.light_json import write_light_json
from clrelight.exchange.picture_tiles import PICTURES, bands_of_fit, bands_of_image, write_picture_tiles
from clrelight.exchange.ptm import write_ptm
from clrelight.exchange.relight_folder import FolderForm, write_relight_folder
from clrelight.exchange.rti import write_rti
from clrelight.images import IMAGE_EXTENSIONS
from clrelight.jobs.inputs import FittedLike, Packed, decoded_of, lend_fitted, opened_on, path_text, paths_among
from clrelight.jobs.outputs import check_new_folder
from clrelight.jobs.parts import check_memory, fits
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.thumbnail import LIGHT
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import check_output, read_light
from clrelight.store.coding import PlanesTarget
from clrelight.store.scratch import scratch_workspace

FORMATS = ("relight", "ptm", "rti", "ktx2", "channels", "channels-half", "json", *PICTURES)
"""What `export_for_viewers` writes."""
_FOLDERS = ("relight", *PICTURES)
_ANY_BASIS = ("relight", "ptm", "rti", *PICTURES)
"""What is made of display values, and so of any basis."""
_COMPONENTS = {"channels": "float", "channels-half": "half"}
_QUALITY = {"relight": 100, **dict.fromkeys(PICTURES, 90)}


def export_for_viewers(
    source: FittedLike,
    out: str | os.PathLike[str],
    format: str,
    *,
    planes: int = 27,
    quality: int | None = None,
    colorspace: str = "mrgb",
    tiles: str | None = None,
    url: str | None = None,
    light: Sequence[float] | None = None,
    memory: int | str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Write a fit as viewers show it: of relightable pictures, or of pictures in tiles (docs/textures.md).

    Parameters
    ----------
    source : path, CoefficientMap or Encoded
        For ``"json"`` a light file; for ``"deepzoom"`` and ``"iiif"`` also an image file of 8 bits.
    out : path
        For ``"relight"``, ``"deepzoom"`` and ``"iiif"`` a new folder, else a file.
    format : str
        ``"relight"``: planes and ``info.json``; ``"ptm"``: a polynomial texture map; ``"rti"``: hemispherical ones;
        ``"ktx2"``: BC6H blocks; ``"channels"``, ``"channels-half"``: one EXR image of all coefficients; ``"json"``:
        the nine coefficients of a light file; ``"deepzoom"``, ``"iiif"``: one picture in tiles.
    planes : int
        Of a relight folder: a multiple of 3 up to 48.
    quality : int, optional
        Of JPEGs, 1 to 100; default: 100 of planes, 90 of pictures. A ``"ptm"`` is compressed where it is given.
    colorspace : str
        Of a relight folder: ``"mrgb"`` or ``"mycc"``.
    tiles : str, optional
        Of a relight folder: ``"deepzoom"``, ``"google"``, ``"zoomify"``, ``"tarzoom"``, ``"itarzoom"`` or ``"iiif"``.
    url : str, optional
        Where the folder will be found: IIIF images name their own address.
    light : three numbers, optional
        Direction to the light of a picture in tiles; default: from the upper left.
    memory : int or str, optional
        Bytes for coefficients of an encoding, such as ``"1GiB"``, what is larger being decoded to a file without a
        name; a codec that needs more is refused. Without it they take 256 MiB, and such a codec says so in a note.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    Report
        Its facts hold ``files`` (of tiles, what describes them), ``format``, ``bytes`` and, of ``"ptm"`` and ``"rti"``,
        ``refit``: the PSNR of display values that is left of the fit, at lights all over the hemisphere.

    Raises
    ------
    InputError
        If the format is unknown, the fit is no picture of 1 or 3 channels, or `out` cannot be written.
    """
    if format not in FORMATS:
        raise unknown("format", format, FORMATS)
    if url is None and "iiif" in (format, tiles):
        raise InputError("IIIF images name their own address: say where the folder will be found, as --url https://...")
    made = _QUALITY.get(format, 100) if quality is None else quality
    form = FolderForm(planes, made, colorspace, tiles, url or "")
    target, kept = path_text(out, "a folder or file to write"), report_for(report)
    _check_target(target, format, paths_among(source))
    if isinstance(source, str | os.PathLike) and format in PICTURES and is_image(source):
        if light is not None:
            raise InputError(f"{os.fsdecode(source)} is a picture already: --light is for fits and encodings")
        files = _write_picture(bands_of_image(source), target, format, form, kept, progress)
        return _told(kept, files, target, format)
    facts: dict[str, object] = {}
    if format == "json":
        since, files = time.perf_counter(), [Path(target)]
        write_light_json(read_light(path_text(source, "a light file")), target)
        kept.add("export", since)
        return _told(kept, files, target, format)
    limit = None if memory is None else count_bytes(memory)
    with opened_on(device, kept) as opened, _lent(source, target, format, limit, opened, kept, progress) as held:
        if isinstance(held, Packed):  # blocks that are passed on as they are
            since, files = time.perf_counter(), [Path(target)]
            write_ktx2(target, held.encoded, opened)
            kept.add("export", since)
        elif format in PICTURES:
            files = _write_picture(bands_of_fit(held, _direction(light)), target, format, form, kept, progress)
        else:
            since = time.perf_counter()
            with stage(progress, "exporting") as tell:
                if format == "relight":
                    files = write_relight_folder(held, target, form, opened, progress=tell)
                else:
                    files, facts = [Path(target)], _write_file(held, target, format, quality, opened, tell)
            kept.add("export", since)
    return _told(kept, files, target, format, facts)


def is_image(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is named as an image."""
    return Path(os.fsdecode(path)).suffix.lower() in IMAGE_EXTENSIONS


def _check_target(target: str, format: str, inputs: Sequence[str | os.PathLike[str]]) -> None:
    ending = os.path.splitext(target)[1].lower()
    if ending in (".ptm", ".rti", ".ktx2") and ending != f".{format}":
        raise InputError(f"{target} would be a file of format {format} under another one's name: end it otherwise")
    if format in _FOLDERS:
        check_new_folder(target)
    else:
        check_output(target, inputs)


@contextmanager
def _lent(
    source: FittedLike,
    target: str,
    format: str,
    memory: int | None,
    device: Device,
    report: Report,
    progress: Progress | None,
) -> Iterator[CoefficientMap | Packed]:
    """Lend the coefficients; those of a large encoding from a file beside the target, blocks of bc6h as they are."""
    folder = Path(target).absolute().parent
    with (
        scratch_workspace(folder, memory or DEFAULT_MEMORY) as workspace,
        lend_fitted(source, report, workspace=workspace, any_basis=format in _ANY_BASIS) as held,
    ):
        if not isinstance(held, Packed):
            yield decoded_of(held, source, device, report, progress)
            return
        encoded = held.encoded
        if format == "ktx2" and encoded.codec == "bc6h":
            yield held
            return
        report.note(*check_memory(f"decoding {encoded.codec}", bytes_to_decode(encoded), memory))
        if fits(workspace, encoded.shape):
            yield decoded_of(held, source, device, report, progress)
            return
        since = time.perf_counter()
        with stage(progress, f"decoding {encoded.codec}") as workspace.progress:
            planes = PlanesTarget(encoded.shape, device, workspace, codec_id=encoded.codec)
            decode_stream(encoded, planes, device)
        report.add("decode", since)
        yield held.record.to_map(planes.planes)


def _direction(light: Sequence[float] | None) -> NDArray[np.float64]:
    if light is None:
        return LIGHT
    given = np.asarray(light, np.float64).reshape(-1)
    if given.shape != (3,):
        raise InputError(f"a light is three numbers x, y, z, got {given.size}")
    return unit_directions(given[None], lambda _: "the light", option="a light")[0]


def _write_picture(
    picture: tuple[tuple[int, int], Any],
    target: str,
    format: str,
    form: FolderForm,
    report: Report,
    progress: Progress | None,
) -> list[Path]:
    since = time.perf_counter()
    with stage(progress, "exporting") as tell:
        files = write_picture_tiles(*picture, target, format, quality=form.quality, url=form.url, progress=tell)
    report.add("export", since)
    return files


def _write_file(
    fit: CoefficientMap,
    target: str,
    format: str,
    quality: int | None,
    device: Device,
    tell: Callable[[int, int], None],
) -> dict[str, object]:
    """Write a fit as one file; return what is to be told of it."""
    if format == "ptm":
        return {"refit": write_ptm(fit, target, device, quality=quality, progress=tell)}
    if format == "rti":
        return {"refit": write_rti(fit, target, device, progress=tell)}
    if format == "ktx2":
        write_ktx2(target, fit, device, progress=tell)
    else:
        write_channels(fit, target, _COMPONENTS[format], progress=tell)
    return {}


def _told(
    report: Report, files: list[Path], target: str, format: str, facts: dict[str, object] | None = None
) -> Report:
    folder = format in _FOLDERS
    everything = [file for file in Path(target).rglob("*") if file.is_file()] if folder else files
    size = sum(file.stat().st_size for file in everything)
    told = {"files": [str(file) for file in files], "format": format, "bytes": size, **(facts or {})}
    report.facts = {**told, **({"tiles": len(everything) - len(files)} if len(everything) > len(files) else {})}
    return report
