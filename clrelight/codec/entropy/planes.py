"""Code the quantiser indices of wavelet-transformed planes that follow each other from important to unimportant.

Subbands go from coarse to fine, and the samples of each in the batches of `cosets`. Planes go in groups that grow, a
later plane having less to tell to the next. Each (subband, batch) of a group needs what comes before it in the group,
and the same (subband, batch) of the group before. So they are coded in stages, like a wave front: in stage t the
(subband, batch) t of the first group, t - 1 of the second, and so on, all at once (see `batches`).

The activity of a sample is made of the sizes of its neighbours, its parent, its siblings, and of those at its place in
the planes before: a running mean over the groups, in which the last one counts half. Nothing is predicted but the
values of the LL subband, from their neighbours.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.batches import Tables, code_batch
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
from clrelight.codec.entropy.range_coding import Coder
from clrelight.codec.entropy.symbols import class_means, geometric_prior
from clrelight.codec.transforms.lifting import Subband
from clrelight.errors import PayloadError

# Sites: LL, details of the first group, details of others; of each the first coset, and the others.
# Their mean size in hundredths of the activity, and where that is 0 in hundredths. Only to start from.
_SIZE_TO_EXPECT = (80, 80, 50, 80, 35, 65)
_SIZE_AT_REST = 2
_UNIT = 144  # activity where all sizes are 1
_BEFORE = 6  # weight of the planes before, where the parent and each sibling weigh 1
_GROWTH = 3  # a group has one plane for as many planes before it, and one
_AT_FIRST = 4 * 8  # four times the size to expect where nothing is known
_MAX_SIZE = 4095  # larger ones are not told apart: four, and a parent with two siblings, fit 16 bits
_MAX_VALUE = 1 << 30


def code_planes(
    coder: Coder,
    bands: list[Subband],
    shape: tuple[int, int, int],
    index_jhw: NDArray[np.int32] | None,
) -> NDArray[np.int32]:
    """Code the indices of all planes.

    Parameters
    ----------
    coder : Coder
        Where symbols go to or come from.
    bands : list of Subband
        From coarse to fine.
    shape : tuple of int
        (n_plane, height, width).
    index_jhw : ndarray, shape (n_plane, height, width), int32, or None
        What to code, below 2**29 in magnitude; None when decoding.

    Returns
    -------
    ndarray, shape (n_plane, height, width), int32
        The indices.

    Raises
    ------
    PayloadError
        If what is decoded cannot be indices.
    """
    decoding = index_jhw is None
    indices_jhw = np.zeros(shape, np.int32) if index_jhw is None else index_jhw
    tables, steps = Tables(_prior()), []
    by_name: dict[tuple[str, int], _Coded] = {}
    for band in bands:
        relatives = [by_name[key] for key in relatives_of(band) if key in by_name]
        coded = by_name[band.name, band.level] = _Coded(band, relatives, indices_jhw)
        steps += [(coded, cosets) for cosets in BATCHES]
    groups = _grow_groups(shape[0])
    for stage in range(len(steps) + len(groups) - 1):
        first, last = max(stage - len(steps) + 1, 0), min(stage + 1, len(groups))
        cells = [cell for g in range(first, last) for cell in _cells(*steps[stage - g], groups[g])]
        if not cells:
            continue
        given = None if decoding else np.concatenate([cell.residual().ravel() for cell in cells])
        pieces = [(cell.site, cell.activity) for cell in cells]
        residuals = code_batch(coder, tables, pieces, given)
        start = 0
        for cell in cells:
            end = start + cell.activity.size
            cell.keep(residuals[start:end].reshape(cell.activity.shape))
            start = end
    return indices_jhw


@functools.cache
def _prior() -> NDArray[np.int64]:
    return geometric_prior(mean for percent in _SIZE_TO_EXPECT for mean in class_means(_UNIT, percent, _SIZE_AT_REST))


def _grow_groups(n_plane: int) -> list[slice]:
    groups, first = [], 0
    while first < n_plane:
        end = min(first + 1 + first // _GROWTH, n_plane)
        groups.append(slice(first, end))
        first = end
    return groups


class _Coded:
    """One subband of all planes: what is known of it so far."""

    def __init__(self, band: Subband, relatives: list[_Coded], indices_jhw: NDArray[np.int32]) -> None:
        n_plane, (height, width) = len(indices_jhw), band.shape
        self.band, self.relatives, self.low = band, relatives, band.name == "LL"
        self.index = indices_jhw[:, band.rows, band.columns]
        # With a border of zeros. Of the residuals, for contexts.
        self.sizes = np.zeros((n_plane, height + 2, width + 2), np.int16)
        self.inner = self.sizes[:, 1:-1, 1:-1]
        self.before = np.zeros((height, width), np.int32)  # the running mean of sizes, times 16
        # Only LL predicts from its neighbours' values, whose sums may pass 31 bits.
        self.values = np.zeros((n_plane, height + 2, width + 2) if self.low else (0, 2, 2), np.int64)


def _cells(coded: _Coded, cosets: tuple[int, ...], planes: slice) -> list[_Cell]:
    """Return the cells of a batch that have samples."""
    height, width = coded.band.shape
    return [_Cell(coded, coset, planes) for coset in cosets if COSETS[coset][0] < height and COSETS[coset][1] < width]


class _Cell:
    """The samples of one subband, coset, and group of planes.

    Attributes
    ----------
    site : int
        See `_SIZE_TO_EXPECT`.
    activity : ndarray, shape (plane, row, column), int32
        The size to expect, times `_UNIT`.
    """

    def __init__(self, coded: _Coded, coset: int, planes: slice) -> None:
        self._coded, self._coset, self._planes = coded, coset, planes
        row, column = COSETS[coset]
        self._grid = (slice(row, None, 2), slice(column, None, 2))
        self._part = (planes, *self._grid)
        self.site = 2 * (0 if coded.low else 1 if planes.start == 0 else 2) + (coset > 0)
        self.activity = self._find_activity()

    def _find_activity(self) -> NDArray[np.int32]:
        coded = self._coded
        shape = coded.inner[self._part].shape
        hints = [
            crop(relative.inner[self._planes if relative.band.level > coded.band.level else self._part], shape)
            for relative in coded.relatives
        ]
        weight = len(hints) + (_BEFORE if self._planes.start else 0)
        hinted = np.zeros(shape, np.int32) if weight else np.full(shape, _AT_FIRST, np.int32)
        if hints:
            np.multiply(sum(hints[1:], start=hints[0]), 4, out=hinted, dtype=np.int32)
        if self._planes.start:
            hinted += _BEFORE * (coded.before[self._grid] >> 2)
        hinted *= _UNIT // (4 if self._coset == 0 else 12)
        hinted //= max(weight, 1)
        if self._coset == 0:
            return hinted
        share = _UNIT * 2 // 3 // neighbour_count(self._coset, *coded.band.shape)
        nearby = gather(coded.sizes[self._planes], self._coset)
        return np.add(hinted, np.multiply(nearby, share, dtype=np.int32), out=hinted)

    def residual(self) -> NDArray[np.integer]:
        """Return what there is to code."""
        index = self._coded.index[self._part]
        if not self._coded.low:
            return index
        return differentiate(index) if self._coset == 0 else index - self._expect()

    def keep(self, residual: NDArray[np.int32]) -> None:
        """Note what was coded."""
        coded = self._coded
        coded.index[self._part] = residual
        sizes = np.minimum(np.abs(residual), _MAX_SIZE).astype(np.int16)
        coded.inner[self._part] = sizes
        before = coded.before[self._grid]
        mean = 16 * sizes.sum(axis=0, dtype=np.int32) // len(sizes)
        before[...] = (before + mean) >> 1 if self._planes.start else mean
        if coded.low:
            values = integrate(residual) if self._coset == 0 else residual + self._expect()
            if max(-int(values.min()), int(values.max())) > _MAX_VALUE:
                raise PayloadError("the range-coded bytes are damaged: an index is too large")
            coded.values[:, 1:-1, 1:-1][self._part] = values
            coded.index[self._part] = values

    def _expect(self) -> NDArray[np.int64]:
        count = neighbour_count(self._coset, *self._coded.band.shape)
        sums: NDArray[np.int64] = gather(self._coded.values[self._planes], self._coset)
        return sums // count
