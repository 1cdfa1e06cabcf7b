"""Haar wavelets on a square that stands for the hemisphere or the sphere with equal areas, and their triple products.

A square of ``2^L`` cells a side has ``4^L`` functions. Function 0 is constant; those of level j, 0 <= j < L, stand at
``k = 4^j (1 + t) + 2^j row + column``: t = 0, 1, 2 says how signs change within cell (row, column) of ``2^j`` a side,
between columns, between rows, or both. All are orthonormal; the area is ``2 pi`` for the hemisphere, ``4 pi`` for the
sphere.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.bases.octahedral import hemisphere_to_square
from clrelight.bases.polar import BELOW
from clrelight.errors import InputError

HEMISPHERE = 2.0 * np.pi
MAX_LEVEL = 10

_SIGNS = np.array([[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])
"""Of the three types at a cell's children (0, 0), (0, 1), (1, 0) and (1, 1)."""


def level_of(degree: int) -> int:
    """Return L of a square with ``(degree + 1)^2 = 4^L`` cells; InputError where there is none."""
    level = max(degree, 0).bit_length()
    if degree < 0 or degree + 1 != 1 << level or level > MAX_LEVEL:
        raise InputError(f"basis haar has degrees 0, 1, 3, 7, 15, ... (squares of 1, 2, 4, ... cells), got {degree}")
    return level


def analyse(values_yx: NDArray[np.float64], area: float = HEMISPHERE) -> NDArray[np.float64]:
    """Return coefficients (side^2, ...) of a function by its means over cells (side, side, ...)."""
    means = np.asarray(values_yx, np.float64)
    level = _level_of_side(means.shape)
    found = np.empty((means.shape[0] ** 2, *means.shape[2:]))
    for j in range(level - 1, -1, -1):
        side = 1 << j
        children = _children(means, side)
        details = np.tensordot(_SIGNS, children, axes=(1, 0)) * (np.sqrt(area / 4**j) / 4.0)
        found[4**j : 4 ** (j + 1)] = details.reshape(3 * 4**j, *means.shape[2:])
        means = children.mean(axis=0)
    found[0] = means[0, 0] * np.sqrt(area)
    return found


def synthesise(coeffs_k: NDArray[np.float64], area: float = HEMISPHERE) -> NDArray[np.float64]:
    """Return the function's values at cells (side, side, ...) of its coefficients (side^2, ...)."""
    return list(_levels(np.asarray(coeffs_k, np.float64), area))[-1]


def _levels(coeffs_k: NDArray[np.float64], area: float) -> Iterator[NDArray[np.float64]]:
    """Yield means over the cells of each level, from 1 cell to the last."""
    rest = coeffs_k.shape[1:]
    level = level_of(round(len(coeffs_k) ** 0.5) - 1)
    means = coeffs_k[0].reshape(1, 1, *rest) / np.sqrt(area)
    yield means
    for j in range(level):
        details = _details(coeffs_k, j) / np.sqrt(area / 4**j)
        children = np.tensordot(_SIGNS.T, details, axes=(1, 0)) + means
        side = 1 << j
        fine = children.reshape(2, 2, side, side, *rest).swapaxes(1, 2).swapaxes(0, 1).swapaxes(2, 3)
        means = fine.reshape(2 * side, 2 * side, *rest)
        yield means


def _details(coeffs_k: NDArray[np.float64], j: int) -> NDArray[np.float64]:
    side = 1 << j
    return coeffs_k[4**j : 4 ** (j + 1)].reshape(3, side, side, *coeffs_k.shape[1:])


def _children(values_yx: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Return the four children of each cell, (4, side, side, ...)."""
    return np.stack([values_yx[i::2, k::2] for i in (0, 1) for k in (0, 1)])


def _level_of_side(shape: tuple[int, ...]) -> int:
    if len(shape) < 2 or shape[0] != shape[1]:
        raise ValueError(f"expected values of a square of cells, got shape {shape}")
    return level_of(shape[0] - 1)


def cells_of(square_n2: NDArray[np.float64], side: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the cells that points of the square (n, 2) lie in."""
    at = np.clip(((square_n2 + 1.0) * (0.5 * side)).astype(np.intp), 0, side - 1)
    return at[:, 1], at[:, 0]


def evaluate_haar(directions_i3: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return all functions at unit directions (n, (degree + 1)^2) on the hemisphere's square; 0 below the horizon."""
    level = level_of(degree)
    directions = np.asarray(directions_i3, np.float64)
    if directions.ndim != 2 or directions.shape[1] != 3:
        raise ValueError(f"directions must have shape (n_light, 3), got {directions.shape}")
    square_n2, each = hemisphere_to_square(directions), np.arange(len(directions))
    basis_ik = np.zeros((len(directions), (degree + 1) ** 2))
    basis_ik[:, 0] = 1.0 / np.sqrt(HEMISPHERE)
    for j in range(level):
        row, column = cells_of(square_n2, 1 << j)
        fine_row, fine_column = cells_of(square_n2, 2 << j)
        child = 2 * (fine_row % 2) + fine_column % 2
        for t in range(3):
            k = 4**j * (1 + t) + (row << j) + column
            basis_ik[each, k] = _SIGNS[t, child] / np.sqrt(HEMISPHERE / 4**j)
    basis_ik[directions[:, 2] < BELOW] = 0.0
    return basis_ik


def level_roughness(degree: int) -> NDArray[np.float64]:
    """Return a penalty of each coefficient that grows fourfold from level to level, (n_coeff,)."""
    level = level_of(degree)
    return np.concatenate([[1e-2], *(np.full(3 * 4**j, 4.0 ** (j + 1)) for j in range(level))])


def integrate_triple(
    first_k: NDArray[np.float64],
    second_k: NDArray[np.float64],
    third_k: NDArray[np.float64],
    area: float = HEMISPHERE,
) -> tuple[float, int]:
    """Return ``integral f g h`` of three functions from their coefficients, and how many terms were added up.

    By the Haar tripling-coefficient theorem of Ng, Ramamoorthi and Hanrahan (2004, Triple product wavelet integrals for
    all-frequency relighting, section 4.3): ``C_ijk`` is not 0 only for three constants, for the three types at one cell
    (both ``1 / root`` of the cell's area), and for two equal wavelets with a function that is constant over their cell,
    where it is that constant. Cells of which two functions hold nothing are not looked at, so that the work is that of
    the sparser two.

    Returns
    -------
    float, int
    """
    functions = [np.asarray(each, np.float64) for each in (first_k, second_k, third_k)]
    if len({each.shape for each in functions}) != 1:
        raise ValueError(f"expected coefficients of one square, got shapes {[each.shape for each in functions]}")
    total, terms = float(np.prod([each[0] for each in functions])) / np.sqrt(area), 1
    level = level_of(round(len(functions[0]) ** 0.5) - 1)
    for j, means in zip(range(level), zip(*(_levels(each, area) for each in functions), strict=True), strict=False):
        details = [_details(each, j) for each in functions]
        held = [each.any(axis=0) for each in details]
        active = (held[0] & held[1]) | (held[0] & held[2]) | (held[1] & held[2])
        if not active.any():
            continue
        f, g, h = (each[:, active] for each in details)
        for (a, b), mean in zip(((g, h), (f, h), (f, g)), means, strict=True):
            pairs = a * b
            total += float((mean[active] * pairs).sum())
            terms += int(np.count_nonzero(pairs))
        crosses = [f[i] * g[k] * h[3 - i - k] for i in range(3) for k in range(3) if i != k]
        total += float(np.sum(crosses)) / np.sqrt(area / 4**j)
        terms += int(sum(np.count_nonzero(each) for each in crosses))
    return total, terms


def multiply(
    first_k: NDArray[np.float64], second_k: NDArray[np.float64], area: float = HEMISPHERE
) -> NDArray[np.float64]:
    """Return the coefficients of a product, ``sum_ij C_ijk f_i g_j``, exact: it is constant over cells as well."""
    return analyse(synthesise(first_k, area) * synthesise(second_k, area), area)


def keep_largest(coeffs_k: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return coefficients of which all but the largest are 0: the nearest of all sums of so many functions."""
    kept_k = np.zeros_like(coeffs_k)
    chosen = np.argsort(-np.abs(coeffs_k), kind="stable")[:count]
    kept_k[chosen] = coeffs_k[chosen]
    return kept_k


def terms_for_energy(coeffs_k: NDArray[np.float64], share: float = 0.99) -> int:
    """Return the fewest functions that hold a share of the energy ``sum c^2``; of channels (n, channel) the sum's."""
    energy = np.asarray(coeffs_k, np.float64) ** 2
    energy = energy.sum(axis=1) if energy.ndim == 2 else energy
    held = np.cumsum(np.sort(energy)[::-1])
    return int(np.searchsorted(held, share * held[-1] * (1.0 - 1e-12)) + 1) if held[-1] > 0.0 else 0
