"""Code the quantiser indices of a wavelet-transformed map: prediction and contexts from what is decoded already.

Subbands go from coarse to fine, the channels of each one after another, and the samples of each in four phases
(even-even, odd-odd, even-odd, odd-even rows and columns), so that three quarters of the samples know four neighbours
and every phase is one vectorised batch. What is coded is the difference of an index from its prediction:

* the index of the previous channel at the same place, times the regression slope seen so far;
* in the LL subband also the mean of the neighbours' differences (in its first phase the sample to the left).

Its magnitude is coded in a context made of the neighbours', parents', sibling subbands' and previous channel's
magnitudes; its sign in a context made of the prediction.
"""

from __future__ import annotations

import functools
from typing import Self

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy import CLASSES, Coder, ModelSet, class_floor, code_integers, geometric_prior
from clrelight.codec.lifting import Subband

_PHASES = ((0, 0), (1, 1), (0, 1), (1, 0))
_PREDICTED = 3  # |prediction| of 0, 1, more
_SITES = 4  # LL, detail in the first phase, other phases; of channel 0 or not
_UNIT = 16  # activity of a neighbourhood whose magnitudes are all 1
_MAX_MAGNITUDE = 1 << 22  # for contexts only


class Statistics:
    """What coder and decoder have learnt from the maps so far."""

    def __init__(self) -> None:
        middle = np.array([class_floor(i) + class_floor(i + 1) for i in range(CLASSES - 2)]) / 2.0
        means = np.concatenate([middle, middle[-1:], middle[-1:]]) / _UNIT
        means[0] = 0.02
        self.magnitudes = ModelSet(np.tile(geometric_prior(means), (_SITES * _PREDICTED, 1)))
        self.signs = ModelSet(np.full((9, 2), 0.5))
        # (channel, LL or detail) -> sums of x y and x x of indices x of the previous channel and y of this
        self.products: dict[tuple[int, bool], tuple[int, int]] = {}

    def copy(self) -> Self:
        """Return statistics that learn apart."""
        twin = object.__new__(type(self))
        twin.magnitudes, twin.signs = self.magnitudes.copy(), self.signs.copy()
        twin.products = dict(self.products)
        return twin

    def slope(self, channel: int, low: bool) -> float:
        """Return the regression slope of a channel's indices on the previous one's, within [-4, 4]."""
        xy, xx = self.products.get((channel, low), (0, 0))
        return min(max(xy / xx, -4.0), 4.0) if xx else 0.0

    def learn_slope(self, channel: int, low: bool, previous: NDArray[np.integer], this: NDArray[np.integer]) -> None:
        """Add the indices of a subband; what was seen before counts half."""
        # Bounded by shifting, so that integer sums are exact whatever the order of summation.
        largest = max(int(np.abs(previous).max()), int(np.abs(this).max()))
        shift = max(largest.bit_length() - 20, 0)
        x, y = (previous >> shift).ravel().astype(np.int64), (this >> shift).ravel().astype(np.int64)
        xy, xx = self.products.get((channel, low), (0, 0))
        self.products[channel, low] = (
            xy // 2 + (int(x @ y) << 2 * shift),
            xx // 2 + (int(x @ x) << 2 * shift),
        )


def code_indices(
    coder: Coder,
    statistics: Statistics,
    bands: list[Subband],
    shape: tuple[int, int, int],
    index_chw: NDArray[np.int32] | None,
) -> NDArray[np.int32]:
    """Code the indices of one map, and learn from them.

    Parameters
    ----------
    coder : Coder
    statistics : Statistics
        Changed.
    bands : list of Subband
        From coarse to fine.
    shape : tuple of int
        (channel, height, width).
    index_chw : ndarray, shape (channel, height, width), int32, or None
        What to code; None when decoding.

    Returns
    -------
    ndarray, shape (channel, height, width), int32
        The indices.
    """
    decoding = index_chw is None
    indices = np.zeros(shape, np.int32) if index_chw is None else index_chw
    differences = np.zeros(shape, np.int32)
    by_name = {(band.name, band.level): band for band in bands}
    for band in bands:
        low = band.name == "LL"
        relatives = [
            by_name[key] for key in [(band.name, band.level + 1), *_siblings(band)] if not low and key in by_name
        ]
        place = (band.rows, band.columns)
        for channel in range(shape[0]):
            predicted = np.zeros(band.shape, np.int32)
            if channel:
                slope = statistics.slope(channel, low)
                predicted = np.rint(indices[channel - 1][place] * slope).astype(np.int32)
            known = None if decoding else indices[channel][place] - predicted
            hints = [(differences[channel][other.rows, other.columns], other.level > band.level) for other in relatives]
            previous = differences[channel - 1][place] if channel else None
            found = _code_band(coder, statistics, low, predicted, previous, hints, known)
            differences[channel][place] = found
            if decoding:
                indices[channel][place] = predicted + found
            if channel:
                statistics.learn_slope(channel, low, indices[channel - 1][place], indices[channel][place])
    return indices


def _siblings(band: Subband) -> list[tuple[str, int]]:
    return [(name, band.level) for name in {"LH": ["HL"], "HH": ["HL", "LH"]}.get(band.name, [])]


def _code_band(
    coder: Coder,
    statistics: Statistics,
    low: bool,
    predicted: NDArray[np.int32],
    previous: NDArray[np.int32] | None,
    hints: list[tuple[NDArray[np.int32], bool]],
    known: NDArray[np.int32] | None,
) -> NDArray[np.int32]:
    height, width = predicted.shape
    # With a border of zeros, and zero where nothing is decoded yet.
    values = np.zeros((height + 2, width + 2), np.int32)
    sizes = np.zeros((height + 2, width + 2), np.int32)
    inner = values[1:-1, 1:-1]
    for phase, (row, column) in enumerate(_PHASES):
        part = (slice(row, None, 2), slice(column, None, 2))
        shape = predicted[part].shape
        if 0 in shape:
            continue
        offset = np.zeros(shape, np.int32)
        if phase:
            count = _neighbour_count(phase, height, width)
            activity = 3 * _gather(sizes, phase) * (4 * _UNIT // 16) // count
            if low:
                offset = _gather(values, phase) // count
        else:
            activity = np.zeros(shape, np.int32)
        context_values = []
        if previous is not None:
            context_values.append(np.abs(previous[part]))
        for hint, coarser in hints:
            context_values.append(np.abs(_fit(hint if coarser else hint[part], shape)))
        if context_values:
            total = np.minimum(context_values[0], _MAX_MAGNITUDE)
            for value in context_values[1:]:
                total = total + np.minimum(value, _MAX_MAGNITUDE)
            share = (1 if phase else 4) * 4
            activity = activity + share * total // len(context_values)
        site = 0 if low else (1 if phase == 0 else 2 + (previous is not None))
        expected = predicted[part]
        if known is None:
            coded = _code_signed(coder, statistics, site, activity, expected, None)
            coded = _integrate(coded) if low and phase == 0 else coded + offset
        else:
            coded = known[part]
            residual = _differentiate(coded) if low and phase == 0 else coded - offset
            _code_signed(coder, statistics, site, activity, expected, residual)
        inner[part] = coded
        sizes[1:-1, 1:-1][part] = np.minimum(np.abs(coded), _MAX_MAGNITUDE)
    return inner


def _neighbours_of(phase: int) -> list[tuple[int, int]]:
    """Return the (row, column) offsets of the four nearest samples that are known in a phase."""
    return [(-1, -1), (-1, 1), (1, -1), (1, 1)] if phase == 1 else [(0, -1), (0, 1), (-1, 0), (1, 0)]


@functools.lru_cache(maxsize=256)
def _neighbour_count(phase: int, height: int, width: int) -> NDArray[np.int32]:
    """Return how many of the neighbours lie inside the subband, at least 1."""
    inside = np.pad(np.ones((height, width), np.int32), 1)
    return np.maximum(_gather(inside, phase), 1)


def _gather(bordered: NDArray[np.integer], phase: int) -> NDArray[np.integer]:
    """Return the sum of the four neighbours at each sample of a phase; the array has a border of one."""
    height, width = bordered.shape
    row, column = _PHASES[phase]
    parts = [
        bordered[1 + row + y : height - 1 + y : 2, 1 + column + x : width - 1 + x : 2] for y, x in _neighbours_of(phase)
    ]
    return parts[0] + parts[1] + parts[2] + parts[3]


def _fit(values, shape):
    values = values[: shape[0], : shape[1]]
    if values.shape == shape:
        return values
    return np.pad(values, [(0, shape[0] - values.shape[0]), (0, shape[1] - values.shape[1])])


def _differentiate(values):
    result = values.copy()
    result[:, 1:] -= values[:, :-1]
    result[1:, 0] -= values[:-1, 0]
    return result


def _integrate(values):
    result = values.copy()
    result[:, 0] = np.cumsum(values[:, 0])
    return np.cumsum(result, axis=1).astype(np.int32)


def _code_signed(coder, statistics, site, activity, expected, residual):
    from clrelight.codec.entropy import classify

    shape = activity.shape
    expected = np.clip(expected.ravel(), -2, 2)
    contexts = (site * _PREDICTED + np.abs(expected)) * CLASSES + classify(activity.ravel())
    given = None if residual is None else residual.ravel()
    sizes = code_integers(coder, statistics.magnitudes, contexts, None if given is None else np.abs(given))
    nonzero = np.flatnonzero(sizes)
    sign_contexts = expected[nonzero] + 2
    negative = coder.code(
        statistics.signs, sign_contexts, None if given is None else (given[nonzero] < 0).astype(np.int32)
    )
    if given is not None:
        return residual
    out = sizes.astype(np.int32)
    out[nonzero[negative.astype(bool)]] *= -1
    return out.reshape(shape)
