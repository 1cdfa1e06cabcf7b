"""Pieces of a map at which the codec `klt` tries its step: coded side by side, each as a map of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.unit_streams import Coded
from clrelight.codec.entropy.units import LEVELS, Layout, Window, lay_out, list_units
from clrelight.codec.transforms.lifting import padded_width, transform_planes
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.whitening import Planes, reshaped
from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray


@dataclass(frozen=True)
class Tried:
    """What a piece took at a step.

    Attributes
    ----------
    size : int
        Bytes of its streams.
    bits_j, error_j : ndarray, shape (n_plane,), float64
        See `clrelight.codec.entropy.unit_streams.Coded`.
    energy_j : ndarray, shape (n_plane,), float64
        Sums of squares of its planes.
    """

    size: int
    bits_j: NDArray[np.float64]
    error_j: NDArray[np.float64]
    energy_j: NDArray[np.float64]


@dataclass(frozen=True)
class Pieces:
    """Wavelet coefficients of the planes of some pieces, all of one size.

    Attributes
    ----------
    values : DeviceArray, shape (n_plane, n_piece * height, pitch), float32
        Pieces below each other, each transformed alone.
    layout : Layout
        Of the units of all pieces: those of a level follow each other, that work-items may code them at once.
    piece_t : ndarray, shape (n_stream,), int64
        Of which piece each stream is.
    energy_nj : ndarray, shape (n_piece, n_plane), float64
        Sums of squares.
    sides : tuple of int
        Height and width of a piece.
    """

    values: DeviceArray
    layout: Layout
    piece_t: NDArray[np.int64]
    energy_nj: NDArray[np.float64]
    sides: tuple[int, int]

    @classmethod
    def of(cls, pixels: Pixels, windows: Sequence[Window], planes: Planes, together: bool) -> Pieces:
        """Make the planes of windows of one size; a piece's units are one stream where they are `together`."""
        (height, width), count, many = windows[0].shape, len(planes[1]), len(windows)
        device, pitch = pixels.device, padded_width(width)
        values = device.empty((count, many * height, pitch), np.float32)
        for number, window in enumerate(windows):
            rows, columns = (window.top, window.bottom), (window.left, window.right)
            pixels.fill(values, rows, columns, planes, number * height)
        transform_planes("analyse", reshaped(values, (count * many, height, pitch)), width, LEVELS, device)
        of_all = device.download(values).reshape(count, many, height, pitch)[..., :width]
        pieces = [of_all[:, n].reshape(count, -1) for n in range(many)]
        energy_nj = np.array([np.einsum("jp,jp->j", piece, piece) for piece in pieces])  # float32 tells which axes pay
        layout, piece_t = _lay_out((height, width), many, pitch, count, together)
        finite_nj = np.minimum(energy_nj, np.finfo(np.float32).max)  # errors of such values are infinite
        return cls(values, layout, piece_t, finite_nj.astype(np.float64), (height, width))

    def host_planes(self, device: Device) -> NDArray[np.float32]:
        """Return the values, (n_plane, n_piece, height, width), which may be the pieces' own memory."""
        (count, _, pitch), (height, width) = self.values.shape, self.sides
        return device.download(self.values).reshape(count, -1, height, pitch)[..., :width]

    def share(self, coded: Coded, count: int) -> list[Tried]:
        """Return what each piece has of the streams of the first planes."""
        size_t = np.array([len(stream) for stream in coded.streams])
        found = []
        for number, energy_j in enumerate(self.energy_nj):
            mine = self.piece_t == number
            bits_j, error_j = (each[mine].sum(axis=0, dtype=np.float64) for each in (coded.bits_tj, coded.error_tj))
            found.append(Tried(int(size_t[mine].sum()), bits_j, error_j, energy_j[:count]))
        return found


def _lay_out(
    sides: tuple[int, int], many: int, pitch: int, count: int, together: bool
) -> tuple[Layout, NDArray[np.int64]]:
    """Return the layout of so many pieces below each other, and of which each stream is."""
    alone = lay_out(list_units(*sides), sides, Window(0, 0, *sides), pitch, together, [(0, count)])
    n_unit, below = len(alone.unit_uf), sides[0] * pitch
    unit_nuf = np.repeat(alone.unit_uf[None], many, axis=0)
    offsets = unit_nuf[..., [1, 2, 3, 10, 11, 12]]  # of bands, and of their parents, or -1: see ``units.clh``
    moved = offsets + (np.arange(many) * below)[:, None, None]
    unit_nuf[..., [1, 2, 3, 10, 11, 12]] = np.where(offsets < 0, offsets, moved)
    part_nt4 = alone.part_t4 + (np.arange(many) * n_unit)[:, None, None] * np.array([1, 1, 0, 0])
    # Stream after stream of one piece, of all pieces in turn: levels stay together.
    part_t4 = part_nt4.transpose(1, 0, 2).reshape(-1, 4).astype(np.int32)
    piece_t = np.tile(np.arange(many), len(alone.part_t4))
    return replace(alone, unit_uf=unit_nuf.reshape(-1, alone.unit_uf.shape[1]), part_t4=part_t4), piece_t
