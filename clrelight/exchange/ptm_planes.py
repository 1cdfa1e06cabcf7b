"""The planes of a polynomial texture map: as bytes in its file, or compressed by JPEG, one plane an image.

PTM file format 1.2 (Malzbender and Gelb 2001), section on compressed files: seven lines for all planes say how each is
predicted, in which order they are decoded and how long they are; behind each image stand the pixels that it got wrong.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.exchange.jpegs import JpegWriter
from clrelight.exchange.rows import Place, read_tile

TERMS = 6
_LINES = 7
_INVERTED, _MOVED = 1, 2


class StoredRows:
    """Rows, from the top, of blocks of bytes that go from the bottom up, (height, width, plane) each."""

    def __init__(self, blocks: list[NDArray[np.uint8]]) -> None:
        self._blocks = blocks
        height, width = blocks[0].shape[:2]
        self.shape = (height, width, sum(block.shape[2] for block in blocks))

    def __getitem__(self, rows: slice, /) -> NDArray[np.uint8]:
        """Return rows, (row, width, plane), uint8."""
        first, end, _ = rows.indices(self.shape[0])
        height = self.shape[0]
        return np.concatenate([block[height - end : height - first][::-1] for block in self._blocks], axis=2)


def map_planes(path: str | os.PathLike[str], at: int, shapes: list[tuple[int, int, int]]) -> StoredRows:
    """Return the planes of a file that is not compressed, read as they are sliced."""
    blocks = []
    for shape in shapes:
        blocks.append(np.memmap(path, np.uint8, "r", at, shape))
        at += shape[0] * shape[1] * shape[2]
    return StoredRows([np.asarray(block) for block in blocks])


def read_jpeg_planes(path: Path, content: bytes, at: int, height: int, width: int, count: int) -> StoredRows:
    """Return the planes of a compressed file; InputError where it says what cannot be, or is cut short.

    Parameters
    ----------
    path : Path
    content : bytes
        How the file begins, with all of its text.
    at : int
        Where the line with the quality begins.
    height, width, count : int
        Of the planes.
    """
    found = find_jpeg_planes(path, content, at, count)
    planes_phw = np.empty((count, height, width), np.uint8)
    done: set[int] = set()
    for plane in np.argsort(found.order):
        start, end = int(found.ends[plane, 0]) - found.sizes[plane], int(found.ends[plane, 0])
        planes_phw[plane] = read_tile(Place(path, start, end), (height, width), 1)[..., 0]
        base = found.references[plane]
        if base >= 0:
            if base not in done:
                raise InputError(f"{path}: plane {plane} is predicted from plane {base}, which comes later")
            known_hw = planes_phw[base]
            planes_phw[plane] += (255 - known_hw if found.transforms[plane] & _INVERTED else known_hw) - np.uint8(128)
        _correct(path, planes_phw[plane], end, found.extras[plane])
        done.add(int(plane))
    return StoredRows([np.moveaxis(planes_phw, 0, 2)])


@dataclass(frozen=True)
class Compressed:
    """Where the planes of a compressed file are, and what each is predicted from.

    Attributes
    ----------
    transforms, order, references, sizes, extras : list of int
        One of each plane: how it is predicted, when, and from which (-1 from none), the bytes of its JPEG, and of what
        corrects it.
    ends : ndarray, shape (plane, 2), int
        Where its JPEG and what corrects it end.
    """

    transforms: list[int]
    order: list[int]
    references: list[int]
    sizes: list[int]
    extras: list[int]
    ends: NDArray[np.int_]


def find_jpeg_planes(path: Path, content: bytes, at: int, count: int) -> Compressed:
    """Return where the planes of a compressed file are, of which none is decoded; see `read_jpeg_planes`."""
    told, at = _read_lines(path, content, at, count)
    transforms, motion_x, motion_y, order, references, sizes, extras = told
    if any(each & ~_INVERTED for each in transforms) or any(motion_x) or any(motion_y):
        raise InputError(f"{path} predicts planes by motion, which cannot be read: write it anew by RTIViewer")
    if sorted(order) != list(range(count)) or not all(-1 <= each < count for each in references):
        raise InputError(f"{path}: its planes are in no order, or predicted from planes that are not there")
    ends = np.cumsum([[size, extra] for size, extra in zip(sizes, extras, strict=True)]).reshape(-1, 2) + at
    length = path.stat().st_size
    if min(*sizes, *extras) < 0 or ends[-1, 1] > length or any(extra % 5 for extra in extras):
        raise InputError(f"{path}: its planes take {ends[-1, 1]} bytes, {length} are there")
    return Compressed(transforms, order, references, sizes, extras, ends)


def _read_lines(path: Path, content: bytes, at: int, count: int) -> tuple[list[list[int]], int]:
    """Return the seven lists of numbers behind the quality, and where they end."""
    numbers = rb"[ \t]*(-?\d{1,10}(?:[ \t]+-?\d{1,10}){%d})[ \t]*\r?\n" % (count - 1)
    match = re.compile(rb"[ \t]*\d{1,3}[ \t]*\r?\n" + numbers * _LINES).match(content, at)
    if match is None:
        raise InputError(f"{path}: a quality and {_LINES} lines of {count} numbers must say where its planes are")
    return [[int(word) for word in match[line].split()] for line in range(1, _LINES + 1)], match.end()


def _correct(path: Path, plane_hw: NDArray[np.uint8], at: int, size: int) -> None:
    """Put in the values that stand behind a plane: four bytes of a pixel's number, the first the highest, and one."""
    if size:
        records_n5 = np.fromfile(path, np.uint8, size, offset=at).reshape(-1, 5)
        pixels = np.ascontiguousarray(records_n5[:, :4]).view(">u4").ravel()
        if pixels.max() >= plane_hw.size:
            raise InputError(f"{path} corrects pixel {pixels.max()} of {plane_hw.size}")
        plane_hw.reshape(-1)[pixels] = records_n5[:, 4]


class JpegPlanes:
    """Planes that are compressed while their rows come, in the order that they shall have in the file.

    Meanwhile they lie in a folder of their own.
    """

    def __init__(self, folder: Path, height: int, width: int, count: int, quality: int) -> None:
        self._quality, self._folder = quality, folder
        self._writer = JpegWriter(folder, [str(plane) for plane in range(count)], height, width, quality, 1)

    def add(self, rows_phw: NDArray[np.uint8]) -> None:
        """Take the next rows, (plane, rows, width)."""
        self._writer.add(rows_phw[..., None])

    def pieces(self) -> Iterable[bytes]:
        """Yield what stands behind scales and biases, once all rows have come."""
        files = [self._folder / name for name in self._writer.finish()]
        count = len(files)
        none, sizes = " ".join(count * ["0"]), " ".join(str(file.stat().st_size) for file in files)
        numbers, alone = " ".join(map(str, range(count))), " ".join(count * ["-1"])
        yield "\n".join([str(self._quality), none, none, none, numbers, alone, sizes, none, ""]).encode("ascii")
        for file in files:
            yield file.read_bytes()

    def close(self) -> None:
        """End the threads."""
        self._writer.close()
