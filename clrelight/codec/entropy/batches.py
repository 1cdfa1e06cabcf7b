"""Code a batch of integers that are mostly zero: those expected to be something in contexts, the others by place.

Each integer comes with an activity, the size to expect of it. Where that is 0 nearly all integers are 0 too; they are
quiet. Of these only the few that are not 0 are coded, by how many there are and by the gaps between them, so that a
million zeros cost no time.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.range_coding import Coder, ModelSet, code_integers
from clrelight.codec.entropy.symbols import CLASSES, DIRECT, classify, geometric_prior
from clrelight.errors import PayloadError

_LENGTHS = 64  # bit lengths of counts and gaps
_SEEN_LIMIT = 1 << 22


class Tables:
    """What coder and decoder have learnt from the batches so far.

    Parameters
    ----------
    prior : ndarray, shape (sites * CLASSES, ALPHABET), int64
        Counts of sizes to start from, by site and class of activity.
    """

    def __init__(self, prior: NDArray[np.int64]) -> None:
        self.sizes = ModelSet(prior)
        quiet_prior, count_prior, gap_prior = _priors()
        self.quiet_sizes, self.quiet_counts = ModelSet(quiet_prior), ModelSet(count_prior)
        self.gaps = ModelSet(gap_prior)
        self._quiet, self._found = 64, 1

    def size_bits(self, contexts: NDArray[np.integer]) -> Callable[[NDArray, NDArray], NDArray]:
        """Return what tells the bits, with their signs, of sizes below `DIRECT` at places in these contexts."""
        counts = self.sizes.counts
        total = np.log2(counts.sum(axis=1))
        return lambda sizes, where: total[contexts[where]] - np.log2(counts[contexts[where], sizes]) + (sizes > 0)

    def quiet_bits(self) -> Callable[[NDArray, NDArray], NDArray]:
        """Return what tells about the same where all is quiet; what is not 0 has its place to pay for."""
        counts = self.quiet_sizes.counts[0]
        place = np.log2(self._quiet / self._found) + 1.0 / np.log(2.0)
        bits = np.append(0.0, place + 1.0 + np.log2(counts.sum()) - np.log2(counts))
        return lambda sizes, _: bits[sizes]

    def learn_quiet(self, quiet: int, found: int) -> None:
        """Add how many were quiet, and of these not 0."""
        self._quiet, self._found = self._quiet + quiet, self._found + found
        if self._quiet > _SEEN_LIMIT:
            self._quiet, self._found = self._quiet >> 1, (self._found + 1) >> 1


@functools.cache
def _priors() -> tuple[NDArray[np.int64], ...]:
    lengths = [1 << min(length, 30) for length in range(_LENGTHS)]
    return geometric_prior([Fraction(1, 10)]), geometric_prior([2] * _LENGTHS), geometric_prior(lengths)


def code_batch(
    coder: Coder,
    tables: Tables,
    pieces: list[tuple[int, NDArray[np.int32]]],
    given: NDArray[np.int32] | None,
    wanted: NDArray[np.float32] | None = None,
    price: float = 0.0,
) -> NDArray[np.int32]:
    """Code integers below 2**30 in magnitude.

    Parameters
    ----------
    coder : Coder
        Where symbols go to or come from.
    tables : Tables
        Changed.
    pieces : list of (site, ndarray of int32)
        Activities, those of each site in one piece or several.
    given : ndarray, shape (n,), int32, or None
        What to code, in the order of the pieces; None when decoding.
    wanted : ndarray, shape (n,), float32, optional
        What the sizes of the integers stand for, in steps, negative where they are to stay: each of the others is
        taken smaller where that saves bits (see `_choose`).
    price : float
        Squared steps of error that a bit must save.

    Returns
    -------
    ndarray, shape (n,), int32

    Raises
    ------
    PayloadError
        If what is decoded cannot be a batch.
    """
    active, contexts, total = _activate(pieces)
    loud = given_found = found = None
    if given is not None:
        loud, rest = given[active], given.copy()
        rest[active] = 0
        found = np.flatnonzero(rest)
        given_found = rest[found]
        if wanted is not None:
            loud = _choose(loud, wanted[active], price, tables.size_bits(contexts))
            given_found = _choose(given_found, wanted[found], price, tables.quiet_bits())
            found, given_found = found[given_found != 0], given_found[given_found != 0]
    sizes = code_integers(coder, tables.sizes, contexts, None if loud is None else np.abs(loud))
    found = _code_places(coder, tables, active, total, found)
    less_one = None if given_found is None else np.abs(given_found) - 1
    found_sizes = code_integers(coder, tables.quiet_sizes, np.zeros(len(found), np.int32), less_one).astype(np.int64)
    result = np.zeros(total, np.int32)
    nonzero = np.flatnonzero(sizes)
    values = np.concatenate([sizes[nonzero], found_sizes + 1])
    if values.size and values.max() > 1 << 30:
        raise PayloadError("the range-coded bytes are damaged: an index is too large")
    signs = None
    if loud is not None and given_found is not None:
        signs = (np.concatenate([loud[nonzero], given_found]) < 0).astype(np.int32)
    negative = coder.code_raw(np.ones(len(values), np.int32), signs)
    result[np.concatenate([active[nonzero], found])] = np.where(negative, -values, values)
    return result


def _activate(pieces: list[tuple[int, NDArray[np.int32]]]) -> tuple[NDArray[np.intp], NDArray[np.int32], int]:
    """Return the places of all pieces together that are not quiet, their contexts, and how many places there are."""
    places, contexts, total = [], [], 0
    for site, activity in pieces:
        flat = activity.ravel()
        loud = np.flatnonzero(flat)
        contexts.append(classify(flat[loud]).astype(np.int32) + site * CLASSES)
        places.append(loud + total)
        total += flat.size
    return np.concatenate(places), np.concatenate(contexts), total


def _code_places(
    coder: Coder, tables: Tables, active: NDArray[np.intp], total: int, found: NDArray[np.intp] | None
) -> NDArray[np.intp]:
    """Code which of the places that are not active hold something: their number, then the gaps between them."""
    quiet = total - len(active)
    length = np.array([quiet.bit_length()])
    count = int(code_integers(coder, tables.quiet_counts, length, None if found is None else np.array([len(found)]))[0])
    if count > quiet:
        raise PayloadError("the range-coded bytes are damaged: more places are found than there are")
    tables.learn_quiet(quiet, count)
    if not count:
        return np.zeros(0, np.intp)
    expected = np.full(count, (quiet // count).bit_length() - 1)
    gaps = None
    if found is not None:
        gaps = np.diff(found - np.searchsorted(active, found), prepend=-1) - 1
    coded = code_integers(coder, tables.gaps, expected, gaps)
    if found is not None:
        return found
    ranks = np.cumsum(coded + np.int64(1)) - 1
    if ranks[-1] >= quiet:
        raise PayloadError("the range-coded bytes are damaged: a place lies outside")
    return ranks + np.searchsorted(active - np.arange(len(active)), ranks, side="right")


def _choose(
    nearest: NDArray[np.int32],
    wanted: NDArray[np.float32],
    price: float,
    bits_of: Callable[[NDArray, NDArray], NDArray],
) -> NDArray[np.int32]:
    """Return each integer, the next smaller one, or 0: whichever error and bits together cost least.

    Only for symbols of their own: where large integers abound, one less saves next to nothing. `bits_of` tells the
    bits of sizes at places.
    """
    where = np.flatnonzero((nearest != 0) & (np.abs(nearest) < DIRECT) & (wanted >= 0.0))
    size, exact = np.abs(nearest[where]), wanted[where].astype(np.float64)
    best, least = size, np.full(len(size), np.inf)
    for candidate in (size, size - 1, np.zeros_like(size)):
        cost = (exact - candidate) ** 2 + price * bits_of(candidate, where)
        best, least = np.where(cost < least, candidate, best), np.minimum(cost, least)
    chosen = nearest.copy()
    chosen[where] = np.sign(nearest[where]) * best
    return chosen
