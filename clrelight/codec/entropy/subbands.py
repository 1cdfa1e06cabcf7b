"""Code the quantiser indices of a wavelet-transformed map: prediction and contexts from what is decoded already.

Subbands go from coarse to fine, the channels of each one after another, and the samples of each in four cosets
(even-even, odd-odd, then even-odd and odd-even rows and columns), so that three quarters of the samples know four
neighbours and there are three vectorised batches. What is coded is the difference of an index from its prediction:

* the index of the previous channel at the same place, times the regression slope seen so far;
* in the LL subband also the mean of the neighbours' differences (in its first coset the sample to the left).

Its magnitude is coded in a context made of the neighbours', parents', sibling subbands' and previous channel's
magnitudes; its sign in a context made of the prediction.
"""

from __future__ import annotations

import functools
from typing import Self

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.cosets import (
    BATCHES,
    COSETS,
    crop,
    differentiate,
    gather,
    integrate,
    neighbour_count,
    relatives_of,
)
from clrelight.codec.entropy.range_coding import Coder, ModelSet, code_integers
from clrelight.codec.entropy.subband_kernel import SubbandDecoder
from clrelight.codec.entropy.symbols import CLASSES, class_means, classify, even_prior, geometric_prior
from clrelight.codec.transforms.lifting import Subband
from clrelight.errors import PayloadError

_PREDICTED = 3  # |prediction| of 0, 1, more
# Sites: LL, details of channel 0, details of other channels; of each the first coset, and the others.
# By site and prediction: the mean size in hundredths of the activity, and where that is 0 in hundredths. Only to start
# from.
_SIZE_TO_EXPECT = (80, 80, 80, 80, 80, 80, 50, 50, 50, 80, 80, 80, 30, 45, 55, 55, 75, 85)
_SIZE_AT_REST = (200, 200, 200, 20, 50, 100, 5, 5, 5, 2, 2, 2, 2, 20, 40, 2, 15, 30)
_UNIT = 16  # activity where all sizes are 1
_NEARBY = 3  # weight of the neighbours, where the hints weigh 1
_MAX_SIZE = 1 << 22
_MAX_PREDICTED = 1 << 29
_MAX_DIFFERENCE = 1 << 30


class Statistics:
    """What coder and decoder have learnt from the maps so far."""

    def __init__(self) -> None:
        self.magnitudes = ModelSet(_magnitude_prior())
        self.signs = ModelSet(even_prior(2 * _PREDICTED - 1, 2))
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
        known = self.products.get((channel, low))
        xy, xx = known or self.products.get((channel, not low), (0, 0))
        return min(max(xy / xx, -4.0), 4.0) if xx else 0.0

    def learn_slope(self, channel: int, low: bool, previous: NDArray[np.integer], this: NDArray[np.integer]) -> None:
        """Add the indices of a subband."""
        # Bounded by shifting, so that integer sums are exact whatever the order of summation.
        largest = max(int(np.abs(previous).max()), int(np.abs(this).max()))
        shift = max(largest.bit_length() - 20, 0)
        x, y = (previous >> shift).ravel().astype(np.int64), (this >> shift).ravel().astype(np.int64)
        self.add_products(channel, low, int(x @ y) << 2 * shift, int(x @ x) << 2 * shift)

    def add_products(self, channel: int, low: bool, product: int, square: int) -> None:
        """Add sums of x y and x x of a subband; what was seen before counts half."""
        xy, xx = self.products.get((channel, low), (0, 0))
        self.products[channel, low] = (xy // 2 + product, xx // 2 + square)


@functools.cache
def _magnitude_prior() -> NDArray[np.int64]:
    sizes = zip(_SIZE_TO_EXPECT, _SIZE_AT_REST, strict=True)
    return geometric_prior(mean for percent, at_rest in sizes for mean in class_means(_UNIT, percent, at_rest))


def code_indices(
    coder: Coder | SubbandDecoder,
    statistics: Statistics,
    bands: list[Subband],
    shape: tuple[int, int, int],
    index_chw: NDArray[np.int32] | None,
    group: int = 1,
) -> NDArray[np.int32]:
    """Code the indices of one map, and learn from them.

    Parameters
    ----------
    coder : Coder or SubbandDecoder
        Where symbols go to or come from; the latter for groups of one channel.
    statistics : Statistics
        Changed.
    bands : list of Subband
        From coarse to fine.
    shape : tuple of int
        (channel, height, width).
    index_chw : ndarray, shape (channel, height, width), int32, or None
        What to code, below 2**29 in magnitude; None when decoding.
    group : int
        Channels that are coded together, in the context of the group before. With 1 each channel is predicted from the
        one before; uncorrelated planes, such as those along principal axes, go faster in groups.

    Returns
    -------
    ndarray, shape (channel, height, width), int32
        The indices.

    Raises
    ------
    PayloadError
        If what is decoded cannot be indices.
    """
    if isinstance(coder, SubbandDecoder):
        return coder.decode_map(statistics, bands, shape)
    decoding = index_chw is None
    indices_chw = np.zeros(shape, np.int32) if index_chw is None else index_chw
    sizes_chw = np.zeros(shape, np.int32)  # of the differences, for contexts
    by_name = {(band.name, band.level): band for band in bands}
    for band in bands:
        low = band.name == "LL"
        relatives = [by_name[key] for key in relatives_of(band) if key in by_name]
        for first in range(0, shape[0], group):
            count = min(group, shape[0] - first)
            place = (slice(first, first + count), band.rows, band.columns)
            before = (slice(first - group, first - group + count), band.rows, band.columns)
            hints = [(sizes_chw[place[0], r.rows, r.columns], r.level > band.level) for r in relatives]
            predicted = np.zeros((count, *band.shape), np.int32)
            if first:
                hints.append((sizes_chw[before], False))
                if group == 1:
                    expected = np.rint(indices_chw[before] * statistics.slope(first, low))
                    predicted = np.clip(expected, -_MAX_PREDICTED, _MAX_PREDICTED).astype(np.int32)
            known = None if decoding else indices_chw[place] - predicted
            site = 0 if low else 1 if first == 0 else 2
            difference, sizes_chw[place] = _code_band(coder, statistics, site, predicted, hints, known)
            if decoding:
                indices_chw[place] = predicted + difference
            if first and group == 1:
                statistics.learn_slope(first, low, indices_chw[before], indices_chw[place])
    return indices_chw


def _code_band(
    coder: Coder,
    statistics: Statistics,
    site: int,
    predicted: NDArray[np.int32],
    hints: list[tuple[NDArray[np.int32], bool]],
    known: NDArray[np.int32] | None,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Code one subband of some channels; return the differences from the prediction, and their sizes for contexts.

    All arrays are (channel, row, column). `hints` are sizes that tell what to expect, and whether they are those of a
    coarser level. Site 0 is LL.
    """
    count, height, width = predicted.shape
    # With a border of zeros, and zero where nothing is decoded yet.
    # Only LL predicts from its neighbours' values, whose sums may pass 31 bits.
    values = np.zeros((count, height + 2, width + 2), np.int64 if site == 0 else np.int32)
    sizes = np.zeros((count, height + 2, width + 2), np.int32)
    inner = (slice(None), slice(1, -1), slice(1, -1))
    for cosets in BATCHES:
        first = cosets == (0,)
        parts = []
        for coset in cosets:
            row, column = COSETS[coset]
            part = (slice(None), slice(row, None, 2), slice(column, None, 2))
            expected = predicted[part]
            if expected.size == 0:
                continue
            hinted = [crop(size if coarser else size[part], expected.shape) for size, coarser in hints]
            nearby: NDArray | None = None
            offset: NDArray = np.zeros((), np.int64)
            if not first:
                neighbours = neighbour_count(coset, height, width)
                nearby = 4 * gather(sizes, coset) // neighbours
                offset = gather(values, coset) // neighbours if site == 0 else offset
            residual = None
            if known is not None and site == 0:
                residual = differentiate(known[part]) if first else known[part] - offset
            elif known is not None:
                residual = known[part]
            parts.append((part, offset, expected, _activity(nearby, hinted, expected.shape), residual))
        if not parts:
            continue
        coded_parts = _code_signed(coder, statistics, 2 * site + (not first), [entry[2:] for entry in parts])
        for (part, offset, *_), residual in zip(parts, coded_parts, strict=True):
            coded = residual
            if site == 0:
                coded = integrate(residual) if first else residual + offset
            if max(-int(coded.min()), int(coded.max())) > _MAX_DIFFERENCE:
                raise PayloadError("the range-coded bytes are damaged: an index is too large")
            values[inner][part] = coded
            sizes[inner][part] = np.minimum(np.abs(residual), _MAX_SIZE)
    return values[inner].astype(np.int32, copy=False), sizes[inner]


def _activity(
    nearby: NDArray[np.int32] | None, hints: list[NDArray[np.int32]], shape: tuple[int, ...]
) -> NDArray[np.int32]:
    """Return the size to expect, times `_UNIT`: the mean of the hints, and of the neighbours with more weight."""
    hinted = sum(hints[1:], start=hints[0]) * (_UNIT // 4) // len(hints) if hints else np.zeros(shape, np.int32)
    if nearby is None:
        return 4 * hinted
    return _NEARBY * (_UNIT // 4) * nearby // 4 + (4 - _NEARBY) * hinted


def _code_signed(
    coder: Coder,
    statistics: Statistics,
    site: int,
    parts: list[tuple[NDArray[np.int32], NDArray[np.integer], NDArray[np.integer] | None]],
) -> list[NDArray[np.integer]]:
    """Code the parts of a batch: magnitudes in the contexts of a site, a prediction and an activity, then signs.

    Each part is (predicted, activity, residual), the residual None where it is decoded; the residuals are returned.
    """
    expected = np.clip(_join([part[0] for part in parts]), -2, 2)
    activity = _join([part[1] for part in parts])
    contexts = (site * _PREDICTED + np.abs(expected)) * CLASSES + classify(activity)
    known = [part[2] for part in parts if part[2] is not None]
    given = _join(known) if known else None
    coded = code_integers(coder, statistics.magnitudes, contexts, None if given is None else np.abs(given))
    nonzero = np.flatnonzero(coded)
    given_signs = None if given is None else (given[nonzero] < 0).astype(np.int32)
    negative = coder.code(statistics.signs, expected[nonzero] + 2, given_signs)
    if known:
        return known
    coded[nonzero[negative == 1]] *= -1
    ends = np.cumsum([part[0].size for part in parts])[:-1]
    return [piece.reshape(part[0].shape) for piece, part in zip(np.split(coded, ends), parts, strict=True)]


def _join(arrays: list[NDArray]) -> NDArray:
    return arrays[0].ravel() if len(arrays) == 1 else np.concatenate([array.ravel() for array in arrays])
