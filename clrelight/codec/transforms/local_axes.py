"""Principal axes turned so that few planes hold what differs at each place of an image.

Principal axes make planes uncorrelated over the whole image. Bits are spent place by place: where a shadow's edge needs
a direction between two axes, both planes have samples there. Of all rotations of the axes, which cost the image the
same, those are cheaper whose planes are uncorrelated within small cells, as far as one rotation can be for all of them.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.transforms.lifting import list_subbands
from clrelight.threads import on_one_thread

CELL = 2
"""Side of the cells, in samples of a subband."""
_FLOOR = 0.2
"""Squared steps that a sample's energy is seen above: what is far below a step takes no bits, however it is turned."""
_LOUD = 0.3
"""Squared steps that some plane of a cell must hold; the others stay 0, whatever the rotation."""
_VALUES, _FIRST_VALUES, _FOR_A_PAIR = 1 << 20, 1 << 18, 32
"""Samples of all planes that a rotation is found by, and that its first passes look at, at most; and for each pair of
planes, if these are more."""
MOST_TURNED = 160
"""Axes that are turned, the loudest: the time grows with the square of their number, and so do places that tell."""
_PART_VALUES = 1 << 16
"""Samples that are turned together."""
_PASSES, _LAST = 16, 4
"""How many passes look at few samples, and how many at all."""
_PART, _MOMENTUM, _LEAST_CURVATURE, _LARGEST_TURN = 0.6, 0.6, 0.05, 0.3
_COARSE, _ENERGIES, _HALVINGS = 0.14, 1 << 16, 12
"""Squared steps below which energies hardly take bits; energies that tell a step, and how often its range is halved."""


def cut_cells(planes_jnyx: NDArray[np.float32], levels: int) -> NDArray[np.float32]:
    """Return the cells of the subbands of transformed pieces, (n_plane, CELL**2, n_cell), filled up with zeros.

    Parameters
    ----------
    planes_jnyx : ndarray, shape (n_plane, n_piece, height, width), float32
        Wavelet coefficients, in place as `list_subbands` says.
    levels : int
        How often they were split.
    """
    count, many, height, width = planes_jnyx.shape
    found = []
    for band in list_subbands(height, width, levels):
        part = planes_jnyx[:, :, band.rows, band.columns]
        down, across = -(-part.shape[2] // CELL), -(-part.shape[3] // CELL)
        room = np.zeros((count, many, down * CELL, across * CELL), np.float32)
        room[:, :, : part.shape[2], : part.shape[3]] = part
        split = room.reshape(count, many, down, CELL, across, CELL).transpose(0, 3, 5, 1, 2, 4)
        found.append(split.reshape(count, CELL * CELL, -1))
    return np.concatenate(found, axis=2)


def turn_axes(cells_jsc: NDArray[np.float32], step: float) -> NDArray[np.float64]:
    """Return the rotation after which planes of cells take the fewest bits, about; rows are the new axes.

    What is made least is the sum over cells c and planes of ``log(E + 0.2 step^2)``, E the mean square of the cell's
    samples: joint approximate diagonalisation of the cells' covariances (Pham, SIAM J. Matrix Anal. Appl. 22(4), 2001),
    among rotations alone, so that an error of any plane costs what it did. Each pass takes Pham's approximate Newton
    step of all pairs of planes at once, part of it and part of the step before.

    Parameters
    ----------
    cells_jsc : ndarray, shape (n_plane, n_sample, n_cell), float32
        As `cut_cells` has them.
    step : float
        The quantiser's.

    Returns
    -------
    ndarray, shape (n_plane, n_plane), float64
        The identity where no rotation was found that is better.
    """
    count, samples, _ = cells_jsc.shape
    if count < 2:
        return np.eye(count)
    with np.errstate(over="ignore"):  # infinite where values are near float32's end
        loudest_c = _sums_of_squares(cells_jsc).max(axis=0)
    loud = np.flatnonzero((loudest_c > _LOUD * step**2) & np.isfinite(loudest_c))
    first, most = (max(each, _FOR_A_PAIR * count**2) for each in (_FIRST_VALUES, _VALUES))
    every = max(-(-len(loud) * count * samples // most), 1)
    chosen_jsc = cells_jsc[:, :, loud[every // 2 :: every]] / np.float32(step)
    if not chosen_jsc.shape[2]:
        return np.eye(count)
    with on_one_thread(), ThreadPoolExecutor(os.cpu_count()) as pool:  # NumPy lets go of Python's lock
        turn_jj, moved_jj = np.eye(count), np.zeros((count, count))
        for few, passes in ((max(chosen_jsc.size // first, 1), _PASSES), (1, _LAST)):
            parts = _cut(chosen_jsc[:, :, ::few])
            for _ in range(passes):
                moved_jj = _MOMENTUM * moved_jj + _newton_step(parts, turn_jj, pool)
                half_jj = np.clip(_PART * moved_jj, -_LARGEST_TURN, _LARGEST_TURN) / 2.0
                turned_jj = np.linalg.solve(np.eye(count) + half_jj, (np.eye(count) - half_jj) @ turn_jj)  # Cayley's
                turn_jj = np.asarray(turned_jj, np.float64)
        before, after = (sum(pool.map(partial(_log_sum, turn_jj=each), parts)) for each in (np.eye(count), turn_jj))
    return turn_jj if after < before else np.eye(count)


def guess_step(cells_jsc: NDArray[np.float32], share: float, bits: float, bounds: tuple[float, float]) -> float:
    """Return the logarithm of 2 of the step at which planes take so many bits, within 1.5 times of the step.

    It is where the cells' ``samples / 2 log2(1 + E / (0.14 step^2))``, E as in `turn_axes`, sum up to the bits.

    Parameters
    ----------
    cells_jsc : ndarray, shape (n_plane, n_sample, n_cell), float32
        As `cut_cells` has them.
    share : float
        Pixels of the map for each that the cells are of.
    bits : float
        Of the map's planes.
    bounds : tuple of float
        Between which it is looked for.
    """
    every = -(-cells_jsc.shape[0] * cells_jsc.shape[2] // _ENERGIES)
    energy_jc = np.square(cells_jsc[:, :, every // 2 :: every], dtype=np.float64).mean(axis=1)
    wanted = bits / (share * every * cells_jsc.shape[1] / 2.0)
    low, high = bounds
    for _ in range(_HALVINGS):
        place = (low + high) / 2.0
        more = np.log2(1.0 + energy_jc / (_COARSE * 4.0**place)).sum() > wanted
        low, high = (place, high) if more else (low, place)
    return high


def _cut(cells_jsc: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Return parts of cells that a processor's cache holds."""
    each = max(_PART_VALUES // (cells_jsc.shape[0] * cells_jsc.shape[1]), 1)
    return [np.ascontiguousarray(cells_jsc[:, :, n : n + each]) for n in range(0, cells_jsc.shape[2], each)]


def _turned(cells_jsc: NDArray[np.float32], turn_jj: NDArray[np.float64]) -> NDArray[np.float32]:
    return (turn_jj.astype(np.float32) @ cells_jsc.reshape(len(turn_jj), -1)).reshape(cells_jsc.shape)


def _sums_of_squares(cells_jsc: NDArray[np.float32]) -> NDArray[np.float32]:
    found_jc = np.square(cells_jsc[:, 0])
    for sample in range(1, cells_jsc.shape[1]):  # faster than sums over an axis that is so short
        found_jc += np.square(cells_jsc[:, sample])
    return found_jc


def _energies(cells_jsc: NDArray[np.float32]) -> NDArray[np.float32]:
    return _sums_of_squares(cells_jsc) / np.float32(cells_jsc.shape[1]) + np.float32(_FLOOR)


def _log_sum(cells_jsc: NDArray[np.float32], turn_jj: NDArray[np.float64]) -> float:
    return float(np.log(_energies(_turned(cells_jsc, turn_jj))).sum(dtype=np.float64))


def _newton_step(
    parts: list[NDArray[np.float32]], turn_jj: NDArray[np.float64], pool: ThreadPoolExecutor
) -> NDArray[np.float64]:
    """Return by how much each pair of planes is to be turned on, antisymmetric; sums have one order."""

    def sums(cells_jsc: NDArray[np.float32]) -> NDArray[np.float64]:
        turned_jsc = _turned(cells_jsc, turn_jj)
        energy_jc = _energies(turned_jsc)
        weight_jc = np.float32(1.0) / energy_jc
        weighted_jsc, count = weight_jc[:, None] * turned_jsc, len(turn_jj)
        slope_jj = weighted_jsc.reshape(count, -1) @ turned_jsc.reshape(count, -1).T
        return np.stack([slope_jj / turned_jsc.shape[1], weight_jc @ energy_jc.T]).astype(np.float64)

    count, cells = len(turn_jj), sum(part.shape[2] for part in parts)
    slope_jj, curved_jj = sum(pool.map(sums, parts), np.zeros((2, count, count))) / cells
    return np.asarray((slope_jj - slope_jj.T) / np.maximum(curved_jj + curved_jj.T - 2.0, _LEAST_CURVATURE))
