"""JPEGs of codes: three planes to a file as they are, no colour subsampled."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.image_sink import check_allowed, has_memory
from clrelight.streaming import some_threads

MOST_SIDE = 65535
"""Pixels that a JPEG's header can count."""
_PIECE_BYTES = 1 << 20
_PUNCH = 3
"""FALLOC_FL_PUNCH_HOLE and FALLOC_FL_KEEP_SIZE of Linux."""
_C: Any = ctypes.CDLL(None) if os.name == "posix" else None


class JpegFile:
    """A JPEG that takes scanlines. libjpeg ends the process where a disk is full: it fills memory, we write.

    Parameters
    ----------
    file : Path
    spec : oiio.ImageSpec

    Raises
    ------
    InputError
        If the file cannot be made.
    OSError
        From every call, what the system says against writing.
    """

    def __init__(self, file: Path, spec: oiio.ImageSpec) -> None:
        self._output: Any = oiio.ImageOutput.create("x.jpg")
        name, self._at = str(file), 0
        self._held: BinaryIO | None = None
        if has_memory():
            check_allowed(spec.image_bytes())
            self._file, self._held = open(file, "wb"), os.fdopen(os.memfd_create("clrelight-jpeg"), "rb")  # noqa: SIM115
            name = f"/proc/self/fd/{self._held.fileno()}"
        if not self._output or not self._output.open(name, spec):
            raise InputError(f"cannot write {file.name}: {oiio.geterror() or 'the folder takes no file'}")

    def write_scanlines(self, first: int, end: int, z: int, pixels: NDArray[np.uint8]) -> bool:
        """As OpenImageIO's; what is finished goes to the disk, and memory has it no longer."""
        is_well = bool(self._output.write_scanlines(first, end, z, pixels))
        self._move()
        return is_well

    def close(self) -> bool:
        """As OpenImageIO's."""
        is_well = bool(self._output.close())
        self._move()
        if self._held is not None:
            self._file.close()
            self._held.close()
        return is_well

    def geterror(self) -> str:
        """As OpenImageIO's."""
        return str(self._output.geterror())

    def _move(self) -> None:
        if self._held is None:
            return
        begin, descriptor = self._at, self._held.fileno()
        while piece := os.pread(descriptor, _PIECE_BYTES, self._at):
            self._file.write(piece)
            self._at += len(piece)
        # The pages go, places stay: libjpeg writes on behind them. Where that is not to be had they stay until the end.
        with suppress(AttributeError):
            _C.fallocate64(descriptor, _PUNCH, ctypes.c_int64(begin), ctypes.c_int64(self._at - begin))


def open_jpeg(file: Path, height: int, width: int, quality: int, channels: int = 3) -> JpegFile:
    """Return a JPEG that takes scanlines; InputError if the file cannot be made."""
    spec = oiio.ImageSpec(width, height, channels, "uint8")
    spec.attribute("Compression", f"jpeg:{quality}")
    spec.attribute("jpeg:subsampling", "4:4:4")
    spec.attribute("oiio:ColorSpace", "sRGB")  # codes are written as they are
    return JpegFile(file, spec)


def write_jpeg(file: Path, pixels_hwc: NDArray[np.uint8], quality: int) -> None:
    """Write one image, (height, width, 1 or 3); InputError where the disk refuses."""
    height, width, channels = pixels_hwc.shape
    output = open_jpeg(file, height, width, quality, channels)
    if not output.write_scanlines(0, height, 0, np.ascontiguousarray(pixels_hwc)):
        raise InputError(f"cannot write {file.name}: {output.geterror()}")
    close_jpeg(file, output)


def close_jpeg(file: Path, output: JpegFile) -> None:
    """Finish a file; InputError where the disk refuses."""
    if not output.close():
        raise InputError(f"cannot write {file.name}: {output.geterror()}")


class JpegWriter:
    """Images of one size and a few channels that become a file each, several at once.

    Parameters
    ----------
    folder : Path
    images : sequence of str
        Their names, without an ending.
    height, width : int
    quality : int
        1 to 100.
    channels : int
        1 or 3.
    """

    def __init__(
        self, folder: Path, images: Sequence[str], height: int, width: int, quality: int, channels: int = 3
    ) -> None:
        if max(height, width) > MOST_SIDE:
            raise InputError(f"a JPEG has at most {MOST_SIDE} pixels a side, this is {width} × {height}: write tiles")
        self._files = [folder / f"{image}.jpg" for image in images]
        self._outputs = [open_jpeg(file, height, width, quality, channels) for file in self._files]
        self._pool = some_threads(len(self._files))
        self._row = 0

    def add(self, rows_nhwc: NDArray[np.uint8]) -> None:
        """Take the next rows, (image, rows, width, channel)."""
        end = self._row + rows_nhwc.shape[1]
        for _ in self._pool.map(self._write, range(len(rows_nhwc)), rows_nhwc):
            pass
        self._row = end

    def finish(self) -> list[Path]:
        """Finish all files; return their names."""
        for file, output in zip(self._files, self._outputs, strict=True):
            close_jpeg(file, output)
        return [Path(file.name) for file in self._files]

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown(cancel_futures=True)

    def _write(self, number: int, rows_hwc: NDArray[np.uint8]) -> None:
        output = self._outputs[number]
        if not output.write_scanlines(self._row, self._row + len(rows_hwc), 0, np.ascontiguousarray(rows_hwc)):
            raise InputError(f"cannot write {self._files[number].name}: {output.geterror()}")
