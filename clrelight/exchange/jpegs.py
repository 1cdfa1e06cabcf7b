"""JPEGs of codes: three planes to a file as they are, no colour subsampled."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from clrelight.errors import InputError

MOST_SIDE = 65535
"""Pixels that a JPEG's header can count."""


def open_jpeg(file: Path, height: int, width: int, quality: int, channels: int = 3) -> Any:
    """Return an OpenImageIO output that takes scanlines; InputError if the file cannot be made."""
    spec = oiio.ImageSpec(width, height, channels, "uint8")
    spec.attribute("Compression", f"jpeg:{quality}")
    spec.attribute("jpeg:subsampling", "4:4:4")
    spec.attribute("oiio:ColorSpace", "sRGB")  # codes are written as they are
    output = oiio.ImageOutput.create("x.jpg")
    if not output or not output.open(str(file), spec):
        raise InputError(f"cannot write {file.name}: {oiio.geterror() or 'the folder takes no file'}")
    return output


def write_jpeg(file: Path, pixels_hwc: NDArray[np.uint8], quality: int) -> None:
    """Write one image, (height, width, 1 or 3); InputError where the disk refuses."""
    height, width, channels = pixels_hwc.shape
    output = open_jpeg(file, height, width, quality, channels)
    if not output.write_scanlines(0, height, 0, np.ascontiguousarray(pixels_hwc)):
        raise InputError(f"cannot write {file.name}: {output.geterror()}")
    close_jpeg(file, output)


def close_jpeg(file: Path, output: Any) -> None:
    """Finish a file; InputError where the disk refuses."""
    if not output.close():
        raise InputError(f"cannot write {file.name}: {output.geterror()}")


class JpegWriter:
    """Images of one size that become a file each.

    Parameters
    ----------
    folder : Path
    images : sequence of str
        Their names, without an ending.
    height, width : int
    quality : int
        1 to 100.
    """

    def __init__(self, folder: Path, images: Sequence[str], height: int, width: int, quality: int) -> None:
        if max(height, width) > MOST_SIDE:
            raise InputError(f"a JPEG has at most {MOST_SIDE} pixels a side, this is {width} × {height}: write tiles")
        self._files = [folder / f"{image}.jpg" for image in images]
        self._outputs = [open_jpeg(file, height, width, quality) for file in self._files]
        self._row = 0

    def add(self, rows_hwp: NDArray[np.uint8]) -> None:
        """Take the next rows, (rows, width, 3 · image)."""
        end = self._row + len(rows_hwp)
        for number, (file, output) in enumerate(zip(self._files, self._outputs, strict=True)):
            pixels = np.ascontiguousarray(rows_hwp[:, :, 3 * number : 3 * number + 3])
            if not output.write_scanlines(self._row, end, 0, pixels):
                raise InputError(f"cannot write {file.name}: {output.geterror()}")
        self._row = end

    def finish(self) -> list[Path]:
        """Finish all files; return their names."""
        for file, output in zip(self._files, self._outputs, strict=True):
            close_jpeg(file, output)
        return [Path(file.name) for file in self._files]
