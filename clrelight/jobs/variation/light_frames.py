"""Photographs whose lights are to be found: a folder's or a stack's, of which small parts are taken at a time."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import check_transfer
from clrelight.conventions import default_peak
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.image_header import ImageHeader
from clrelight.image_names import list_series
from clrelight.image_set import read_headers
from clrelight.images import BAND_BYTES, read_bands
from clrelight.jobs.inputs import StackLike, lend_stack, path_text
from clrelight.jobs.report import Report
from clrelight.tiles import row_tiles
from clrelight.variation.maps import SampleReader


@dataclass(frozen=True)
class Frames:
    """Photographs of one view.

    Attributes
    ----------
    names : tuple of str
        What an ``.lp`` file calls them.
    stack : LightStack
        Their sizes, peak and curve; of a folder without samples.
    headers : list of ImageHeader, optional
        Of a folder.
    is_lit : bool
        Whether the stack's directions are those of its lights.
    """

    names: tuple[str, ...]
    stack: LightStack
    headers: list[ImageHeader] | None
    is_lit: bool

    @property
    def shape_hw(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.stack.image_shape[:2]

    def most(self) -> float:
        """Return the radiance from which on samples are clipped; inf of floats."""
        return SampleReader(self.stack).most

    def take(
        self,
        window_xywh: tuple[int, int, int, int],
        factor: int = 1,
        lights: Sequence[int] | None = None,
        tell: Callable[[int, int], object] = lambda done, total: None,
    ) -> NDArray[np.float32]:
        """Return linear grey of a part of some photographs, means of blocks of `factor` pixels squared.

        Returns
        -------
        ndarray, shape (n_light, ceil(height / factor), ceil(width / factor)), float32
        """
        x, y, width, height = window_xywh
        chosen = list(range(len(self.names))) if lights is None else list(lights)
        shape = -(-height // factor), -(-width // factor)
        sums_ihw = np.zeros((len(chosen), *shape), np.float32)
        reader, starts = SampleReader(self.stack), np.arange(0, width, factor)
        for where, row, codes_irwc in self._blocks(chosen, y, y + height):
            grey_irw = reader.linear(codes_irwc[:, :, x : x + width].reshape(len(codes_irwc), -1, codes_irwc.shape[3]))
            grey_irw = grey_irw.mean(axis=0).reshape(len(codes_irwc), -1, width)
            if not np.isfinite(grey_irw).all():
                raise InputError(f"{self.names[chosen[where.start]]} holds values that are not finite")
            across_irw = np.add.reduceat(grey_irw, starts, axis=2)
            first = row - y
            at = (np.arange(first, first + across_irw.shape[1])) // factor
            edges = np.flatnonzero(np.diff(at, prepend=-1))
            sums_ihw[where, at[edges]] += np.add.reduceat(across_irw, edges, axis=1)
            tell(where.stop if first + across_irw.shape[1] >= height else where.start, len(chosen))
        rows = np.minimum(factor, height - factor * np.arange(shape[0]))
        columns = np.minimum(factor, width - factor * np.arange(shape[1]))
        sums_ihw /= (rows[:, None] * columns).astype(np.float32)
        return sums_ihw

    def _blocks(self, lights: list[int], first: int, end: int) -> Iterator[tuple[slice, int, NDArray]]:
        if self.headers is not None:
            for at, light in enumerate(lights):
                for row, band_hwc in read_bands(self.headers[light], (first, end)):
                    yield slice(at, at + 1), row, band_hwc[None]
            return
        _, width, channel = self.stack.image_shape
        step = max(1, BAND_BYTES // (width * channel * self.stack.n_light * self.stack.images_ihwc.dtype.itemsize))
        for row, stop in row_tiles((first, end), step):
            rows_ihwc = self.stack.read_rows(row, stop)
            yield slice(0, len(lights)), row, rows_ihwc[lights]


@contextmanager
def lend_frames(source: StackLike, transfer: str, report: Report) -> Iterator[Frames]:
    """Lend the photographs of a folder, which needs no lights, or those of a stack.

    InputError if there are none, they are not alike, or a folder's curve is unknown.
    """
    if isinstance(source, str | os.PathLike) and pathlib.Path(os.fsdecode(source)).is_dir():
        check_transfer(transfer)
        folder = pathlib.Path(path_text(source, "a folder"))
        paths = list_series(folder)
        headers = read_headers(list(paths), None, False)
        head = headers[0]
        blank_ihwc = np.broadcast_to(np.zeros((), head.dtype), (len(headers), head.height, head.width, head.channels))
        up_i3 = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(headers), 3))
        stack = LightStack(blank_ihwc, up_i3, default_peak(head.dtype), transfer)
        yield Frames(tuple(path.name for path in paths), stack, headers, False)
        return
    with lend_stack(source, report) as stack:
        names = tuple(f"image{i:04d}" for i in range(stack.n_light))
        yield Frames(names, replace(stack), None, True)
