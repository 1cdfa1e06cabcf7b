"""From a packed view back to photographs: under the lights it was made of, or any others."""

from __future__ import annotations

import os
import time
from contextlib import closing
from dataclasses import dataclass
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
from clrelight.jobs.farm import Chore, Farm, shared_path
from clrelight.jobs.inputs import lend_encoded, opened_on, path_text, read_directions
from clrelight.jobs.outputs import check_new_folder, claimed
from clrelight.jobs.pictures import FLOAT_FORMATS
from clrelight.jobs.region import list_tiles
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.unpacking_chores import LIGHT, PART
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
    farm: Farm | None = None,
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
    farm : Farm, optional
        Other processes that relight parts of the image and write photographs; `source` is a file then.

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
    check_new_folder(path_text(out, "a folder to write"))
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
        kept.add("read", since)
        job = _Unpack(encoded.shape, directions_i3, kind, transfer or record.transfer, budget, kept, progress)
        with replacing_folder(out) as folder:
            if farm is None:
                names = job.run(folder, regions, Path(os.fsdecode(out)).parent, opened)
            elif salvage:
                raise InputError("other processes salvage nothing: let one process do it")
            else:
                names = job.share(folder, shared_path(source, "the packed file"), farm)
            _write_lights(folder, names, directions_i3)
            names = [*names, LIGHTS_FILE]
    kept.facts |= {"folder": os.fsdecode(out), "files": [os.path.join(os.fsdecode(out), name) for name in names]}
    return kept


def _check_channels(kind: str, channel: int) -> None:
    """Raise InputError, before anything is relit, where images of so many channels do not go into such files."""
    if kind == "exr" or channel == 3 or (channel == 1 and kind != "hdr"):
        return
    held = "3 channels" if kind == "hdr" else "1 or 3 channels"
    fitting = "exr" if channel != 1 else "jpg, png, tif and exr"
    raise InputError(f"{kind} holds {held}, the images have {channel}: {fitting} can hold them")


@dataclass(frozen=True)
class _Unpack:
    """Photographs that are asked for."""

    shape: tuple[int, int, int, int]
    directions_i3: NDArray[np.float64]
    kind: str
    transfer: str
    memory: int
    report: Report
    progress: Progress | None

    @property
    def names(self) -> list[str]:
        """Of the files."""
        digits = max(3, len(str(len(self.directions_i3) - 1)))
        return [f"light_{light:0{digits}}.{self.kind}" for light in range(len(self.directions_i3))]

    @property
    def is_float(self) -> bool:
        """Whether files hold linear radiance."""
        return f".{self.kind}" in FLOAT_FORMATS

    @property
    def parts(self) -> list[Region]:
        """Of the image, each decoded once."""
        return list_tiles(*self.shape[1:3], 4 * len(self.directions_i3) * self.shape[3], self.memory // 4)

    def run(self, folder: Path, regions: Regions, place: Path, device: Device) -> list[str]:
        """Write all photographs, which lie in a file without a name in `place` meanwhile; return their names."""
        since, shape = time.perf_counter(), (len(self.directions_i3), *self.shape[1:])
        dtype = np.dtype(np.float32 if self.is_float else np.uint8)
        with closing(ScratchImages(place, shape, dtype)) as images:
            with stage(self.progress, "relighting") as tell:
                for number, part in enumerate(self.parts):
                    relit_ihwc = regions.relight_region(self.directions_i3, part, device)
                    shown_ihwc = relit_ihwc if self.is_float else to_display(relit_ihwc, self.transfer)
                    for light, rows_hwc in enumerate(shown_ihwc):
                        images.write_part(light, part.top, part.left, rows_hwc)
                    tell(number + 1, len(self.parts))
            since = self.report.add("relight", since)
            with stage(self.progress, "writing images") as tell:
                for light, name in enumerate(self.names):
                    write_image(folder / name, images[light])
                    tell(light + 1, len(self.names))
            self.report.add("write", since)
        return self.names

    def share(self, folder: Path, source: str, farm: Farm) -> list[str]:
        """Have all photographs written elsewhere; return their names."""
        since, parts = time.perf_counter(), self.parts
        lights = farm.share("lights", {"directions_i3": self.directions_i3})
        curve = None if self.is_float else self.transfer
        files = [f"part-{number:06d}.npz" for number in range(len(parts))]
        relit = [
            Chore(
                PART,
                source,
                {"lights": lights, "transfer": curve, "sides": list(part.sides)},
                (lights,),
            )
            for part in parts
        ]
        paths = [os.path.join(farm.folder, file) for file in files]
        farm.write(list(zip(relit, paths, strict=True)), "relighting")
        since = self.report.add("relight", since)
        places = [[part.top, part.left] for part in parts]
        given = {"shape": list(self.shape[1:]), "parts": files, "places": places}
        written = [
            (Chore(LIGHT, source, {**given, "light": light}, tuple(paths)), os.path.join(farm.folder, name))
            for light, name in enumerate(self.names)
        ]
        farm.write(written, "writing images")
        for name in self.names:
            os.replace(os.path.join(farm.folder, name), folder / name)
        self.report.add("write", since)
        return self.names


def _write_lights(folder: Path, names: list[str], directions_i3: NDArray[np.float64]) -> None:
    lines = [f"{name} {x:.9f} {y:.9f} {z:.9f}" for name, (x, y, z) in zip(names, directions_i3, strict=True)]
    (folder / LIGHTS_FILE).write_text("\n".join([str(len(names)), *lines, ""]))
