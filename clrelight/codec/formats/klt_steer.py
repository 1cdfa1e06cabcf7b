"""How the streams of a map come to fill a budget while they are coded: the last make up for what all others took.

Nothing hangs on units of the finest level, and what those that are coded took tells what the others will. These are
coded at a multiplier that is as much off as it must be, which decoders never see.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.units import Unit

_LEAST_UNITS = 24
"""Units of the finest level below which none is steered: parts of them are too few to tell."""
_LEFT = (2, 4, 8, 16)
"""Parts of the finest units that are left at the turns in which they are coded."""
_BOUND = 1.6
"""Times by which the multiplier may change: a map is better coded at another step than unevenly."""


def steer(
    encode: Callable[[Sequence[int], float], Sequence[bytes]],
    units: Sequence[Unit],
    sample_t: NDArray[np.int64],
    multiplier: float,
    spare: Callable[[NDArray[np.float64]], float],
) -> list[bytes]:
    """Return all streams of a map, which leave about nothing of a budget where little is amiss.

    Parameters
    ----------
    encode : callable
        Codes some streams, by their numbers, at a multiplier; those that they hang on were coded before.
    units : sequence of Unit
        What streams are of, one each, from coarse to fine.
    sample_t : ndarray, shape (n_stream,), int64
        How many samples each stream holds.
    multiplier : float
        The one at which most are coded.
    spare : callable
        The bytes that streams of some sizes leave of what is to be filled, (n_stream,); below 0 where they pass it.
    """
    finest = np.flatnonzero([unit.level == 1 for unit in units])
    if len(finest) < _LEAST_UNITS:
        return list(encode(range(len(units)), multiplier))
    # A comb of ever finer teeth: each turn is of places all over the image.
    combed = finest[np.argsort([f"{n:032b}"[::-1] for n in range(len(finest))], kind="stable")]
    first, *turns = np.split(combed, [len(finest) - len(finest) // part for part in _LEFT])
    turns = [np.concatenate([np.arange(finest[0]), np.sort(first)]), *(np.sort(turn) for turn in turns)]
    streams, taken_t, usual_t = [b""] * len(units), np.zeros(len(units)), np.full(len(units), np.nan)
    parent_t, now = _parents(units), multiplier
    for turn in turns:
        if turn is not turns[0]:
            likely_t, missing = _foretell(usual_t, finest, parent_t, sample_t), np.isnan(usual_t)
            powers = _powers(likely_t, sample_t)[missing]
            now = _change(multiplier, likely_t[missing], powers, spare(np.where(missing, likely_t, taken_t)))
        for t, stream in zip(turn.tolist(), encode(turn.tolist(), now), strict=True):
            streams[t], taken_t[t] = stream, len(stream)
        usual_t[turn] = taken_t[turn] * (now / multiplier) ** _powers(taken_t, sample_t)[turn]
    return streams


def _parents(units: Sequence[Unit]) -> NDArray[np.int64]:
    """Return the stream of the unit one level coarser that lies at each one's first sample; -1 of the coarsest."""
    at = {(unit.level, unit.row // unit.side, unit.column // unit.side): t for t, unit in enumerate(units)}
    found = []
    for unit in units:
        side = 2 * Unit(unit.level + 1, 0, 0).side
        found.append(at.get((unit.level + 1, unit.row // side, unit.column // side), -1) if unit.level else -1)
    return np.array(found)


def _foretell(
    usual_t: NDArray[np.float64], finest: NDArray[np.int64], parent_t: NDArray[np.int64], sample_t: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return what streams take at the usual multiplier: what is known, of others what those of their parents say."""
    parents, likely_t = parent_t[finest], usual_t.copy()
    share = (usual_t[parents] + 1.0) * sample_t[finest] / np.maximum(sample_t[parents], 1)
    known = ~np.isnan(usual_t[finest])
    likely_t[finest[~known]] = share[~known] * (usual_t[finest[known]].sum() / share[known].sum())
    return likely_t


def _powers(size_t: NDArray[np.float64], sample_t: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return with which power of the multiplier the bytes of streams fall, about: the fewer they are the faster."""
    bits_t = 8.0 * size_t / np.maximum(sample_t, 1)
    return np.clip(0.1 * np.maximum(bits_t, 1e-4) ** -0.55, 0.1, 4.0)


def _change(multiplier: float, size_n: NDArray[np.float64], power_n: NDArray[np.float64], spare: float) -> float:
    """Return the multiplier at which streams that take some bytes at another one take so many more, about."""
    times = np.geomspace(1.0 / _BOUND, _BOUND, 81)
    more = (size_n * times[:, None] ** -power_n).sum(axis=1) - size_n.sum()
    return multiplier * float(np.interp(-spare, -more, times))
