"""From a packed view back to photographs: under the lights it was made of, or any others."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import check_transfer
from clrelight.codec import Encoded
from clrelight.codec.views import Region, Regions
from clrelight.device import Device
from clrelight.durable import replacing_folder
from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.jobs.inputs import lend_encoded, opened_on, read_directions
from clrelight.jobs.outputs import claimed
from clrelight.jobs.pictures import FLOAT_FORMATS
from clrelight.jobs.region import list_tiles
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.memory import IMAGE_MEMORY
from clrelight.relight import to_display
from clrelight.store.scratch_images import ScratchImages

FORMATS = ("jpg", "png", "tif", "exr", "hdr")
LIGHTS_FILE = "lights.lp"


def unpack(
    source: str | os.PathLike[str] | Encoded,
    out: str | os.PathLike[str],
    *,
    lights: str | os.PathLike[str] | None = None,
    kind: str = "jpg",
    transfer: str | None = None,
    salvage: bool = False,
    memory: int | str = IMAGE_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Write the photographs of a packed view into a new folder, with the light file that `pack` and `ingest` read.

    Each part of the image is decoded once for all lights.

    Parameters
    ----------
    source : path, URL or Encoded
        As `clrelight.jobs.pack.pack` or codec ``klt`` writes it.
    out : path
        The folder to make; one that is there must be empty.
    lights : path, optional
        Directions from a file, an ``.lp`` or a table; by default those that were fitted.
    kind : str
        One of `FORMATS`: ``jpg`` and ``png`` of 8 bits behind the transfer, the others of linear radiance in floats.
    transfer : str, optional
        ``"linear"`` or ``"srgb"``: curve of 8-bit files; by default the stack's.
    salvage : bool
        Write what is left of a damaged file: notes, and ``damaged`` in the report, say what is filled.
    memory : int or str
        Bytes of images and planes that are held.
    device, progress, report
        As of `clrelight.jobs.decode.decode`.

    Returns
    -------
    Report
        With the ``files`` that were written.

    Raises
    ------
    InputError
        If the file is damaged or of another codec, a light is none, or the folder cannot be written.
    """
    kept, budget = report_for(report), count_bytes(memory)
    if kind not in FORMATS:
        raise InputError(f"format must be one of {', '.join(FORMATS)}, got {kind!r}")
    if transfer is not None:
        check_transfer(transfer)
        if f".{kind}" in FLOAT_FORMATS:
            raise InputError(f"--transfer is for 8-bit files, but {kind} holds linear radiance: leave it out")
    given = [] if isinstance(source, Encoded) else [source]
    with (
        claimed([], given, kept),
        opened_on(device, kept) as opened,
        lend_encoded(source, kept, salvage=salvage) as packed,
    ):
        since = time.perf_counter()
        encoded, record, regions = packed.encoded, packed.record, packed.regions()
        if regions is None:
            raise InputError(f"only files of codec klt hold parts that can be decoded alone, this is {encoded.codec}")
        _check_channels(kind, encoded.shape[3])
        directions_i3 = record.directions_i3 if lights is None else read_directions(lights, kept)
        since = kept.add("read", since)
        shape = (len(directions_i3), *encoded.shape[1:])
        dtype = np.dtype(np.float32 if f".{kind}" in FLOAT_FORMATS else np.uint8)
        with (
            replacing_folder(out) as folder,
            closing(ScratchImages(Path(os.fsdecode(out)).parent, shape, dtype)) as images,
        ):
            with stage(progress, "relighting") as tell:
                parts = list_tiles(*shape[1:3], 4 * shape[0] * shape[3], budget // 4)
                for number, part in enumerate(parts):
                    _relight(images, regions, part, directions_i3, transfer or record.transfer, opened)
                    tell(number + 1, len(parts))
            since = kept.add("relight", since)
            with stage(progress, "writing images") as tell:
                names = _write(folder, images, kind, directions_i3, tell)
            kept.add("write", since)
    kept.facts |= {"folder": os.fsdecode(out), "files": [os.path.join(os.fsdecode(out), name) for name in names]}
    return kept


def _check_channels(kind: str, channel: int) -> None:
    """Raise InputError, before anything is relit, where images of so many channels do not go into such files."""
    if kind == "exr" or channel == 3 or (channel == 1 and kind != "hdr"):
        return
    held = "3 channels" if kind == "hdr" else "1 or 3 channels"
    fitting = "exr" if channel != 1 else "jpg, png, tif and exr"
    raise InputError(f"{kind} holds {held}, the images have {channel}: {fitting} can hold them")


def _relight(
    images: ScratchImages,
    regions: Regions,
    part: Region,
    directions_i3: NDArray[np.float64],
    transfer: str,
    device: Device,
) -> None:
    relit_ihwc = regions.relight_region(directions_i3, part, device)
    shown_ihwc = relit_ihwc if images.dtype == np.float32 else to_display(relit_ihwc, transfer)
    for light, rows_hwc in enumerate(shown_ihwc):
        images.write_part(light, part.top, part.left, rows_hwc)


def _write(
    folder: Path, images: ScratchImages, kind: str, directions_i3: NDArray[np.float64], tell: Callable[[int, int], None]
) -> list[str]:
    """Write all images and the light file; return their names."""
    digits = max(3, len(str(len(directions_i3) - 1)))
    names = [f"light_{light:0{digits}}.{kind}" for light in range(len(directions_i3))]
    for light, name in enumerate(names):
        write_image(folder / name, images[light])
        tell(light + 1, len(names))
    lines = [f"{name} {x:.9f} {y:.9f} {z:.9f}" for name, (x, y, z) in zip(names, directions_i3, strict=True)]
    (folder / LIGHTS_FILE).write_text("\n".join([str(len(names)), *lines, ""]))
    return [*names, LIGHTS_FILE]
