"""Code a batch of integers that are mostly zero: those expected to be something in contexts, the others by place.

Each integer comes with an activity, the size to expect of it. Where that is 0 nearly all integers are 0 too; they are
quiet. Of these only the few that are not 0 are coded, by how many there are and by the gaps between them, so that a
million zeros cost no time.
"""

from __future__ import annotations

import functools
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.range_coding import Coder, ModelSet, code_integers
from clrelight.codec.entropy.symbols import CLASSES, classify, geometric_prior
from clrelight.errors import PayloadError

_LENGTHS = 64  # bit lengths of counts and gaps


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


@functools.cache
def _priors() -> tuple[NDArray[np.int64], ...]:
    lengths = [1 << min(length, 30) for length in range(_LENGTHS)]
    return geometric_prior([Fraction(1, 10)]), geometric_prior([2] * _LENGTHS), geometric_prior(lengths)


def code_batch(
    coder: Coder,
    tables: Tables,
    pieces: list[tuple[int, NDArray[np.int32]]],
    given: NDArray[np.int32] | None,
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
