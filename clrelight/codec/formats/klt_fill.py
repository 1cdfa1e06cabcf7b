"""How streams fill a budget: those of some places of the two finest levels are coded again, which no others hang on.

Where much is missing, or too much, all are. The multiplier by which a bit must save error is what decoders never see.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.units import Unit
from clrelight.search import search_falling

MULTIPLIERS = (0.03, 0.6)
"""The range of multipliers by which the tiles of a large map meet a budget."""
MULTIPLIER_POWER = 0.45
"""Bytes fall about with this power of the multiplier."""
_GIVES = 0.1
"""Part of their bytes that streams are to give or take: at multipliers much apart bytes would be spent unevenly."""
_MORE = 1.25
"""Times by which bytes of several places are to change more than they must: these are taken until they fit."""
_COMBINED, _TAKEN = 10, 3
"""Places of which each set is looked at, and sets that are."""
_LEAST_PLACES, _MAX_TRIALS = 4, 7


def fill(
    encode: Callable[[Sequence[int], float], Sequence[bytes]],
    units: Sequence[Unit],
    first: Sequence[bytes],
    multiplier: float,
    spare: Callable[[Sequence[bytes]], int],
    slack: float,
) -> list[bytes]:
    """Return streams that leave as few bytes of a budget as can be, and pass it only if all do.

    Parameters
    ----------
    encode : callable
        Codes some streams, by their numbers, at a multiplier; indices of others stay where they are.
    units : sequence of Unit
        What streams are of, one each.
    first : sequence of bytes
        The streams, which were coded last, at `multiplier`.
    multiplier : float
    spare : callable
        How many bytes of the budget some streams leave, below 0 where they pass it.
    slack : float
        Bytes that may be left.
    """
    left = spare(first)
    best = left, list(first)
    if 0 <= left <= slack:
        return best[1]
    places = _choose(units, np.array([len(stream) for stream in first]), left - slack / 2.0)
    chosen = sorted(t for place in places for t in place)
    held = sum(len(first[t]) for t in chosen)
    more = _MORE if len(places) > 1 else 1.0
    limit, aim = (math.log(max(held + each, 1.0)) for each in (left, more * (left - slack / 2.0)))

    def measure(place: float) -> float:
        nonlocal best
        made = dict(zip(chosen, encode(chosen, math.exp(place)), strict=True))
        change_p = np.array([sum(len(made[t]) - len(first[t]) for t in streams) for streams in places])
        most = left
        for _ in range(_TAKEN):
            taken = list(first)
            for p in _take(change_p, most):
                for t in places[p]:
                    taken[t] = made[t]
            now = spare(taken)
            best = min(best, (now, taken), key=lambda each: (each[0] < 0, abs(each[0])))
            if now >= 0:
                break
            most += now  # the index grew
        return math.log(max(held + int(change_p.sum()), 1.0))

    search_falling(
        measure,
        math.log(multiplier) - (aim - math.log(max(held, 1))) / MULTIPLIER_POWER,
        (math.log(MULTIPLIERS[0]), math.log(2 * MULTIPLIERS[1])),
        aim,
        limit=limit,
        is_enough=lambda _: 0 <= best[0] <= slack,
        expect=lambda place, size: place - (aim - size) / MULTIPLIER_POWER,
        slopes=(-10.0, -0.5),
        most=_MAX_TRIALS,
        width=1e-4,
    )
    return best[1]


def _take(change_p: NDArray[np.int64], most: int) -> list[int]:
    """Return the places whose changes of bytes sum up to the greatest number that is not above one, or all places."""
    few = min(len(change_p), _COMBINED)
    head_n = np.concatenate([[0], np.cumsum(change_p[: len(change_p) - few])])
    masks_mp = np.arange(1 << few)[:, None] >> np.arange(few) & 1
    sums_nm = head_n[:, None] + masks_mp @ change_p[len(change_p) - few :]
    if sums_nm.min() > most:
        return list(range(len(change_p)))
    n, m = divmod(int(np.where(sums_nm > most, np.iinfo(np.int64).min, sums_nm).argmax()), 1 << few)
    return [*range(n), *(len(change_p) - few + np.flatnonzero(masks_mp[m])).tolist()]


def change_multiplier(multiplier: float, ratio: float) -> float:
    """Return the multiplier at which bytes are so many times what they are at one, about; at most twice or half it."""
    least, most = max(multiplier / 2.0, MULTIPLIERS[0]), min(multiplier * 2.0, MULTIPLIERS[1])
    return min(max(multiplier * ratio ** (-1.0 / MULTIPLIER_POWER), least), most)


def _choose(units: Sequence[Unit], size_t: NDArray[np.int64], change: float) -> list[list[int]]:
    """Return the streams to code again, that bytes change by so many, place by place.

    Places of level 2 all over the image, with what lies below each on level 1; or all streams there are.
    """
    below: dict[tuple[int, int], list[int]] = {}
    for t, unit in enumerate(units):
        if unit.level in (1, 2):
            scale = 3 - unit.level
            place = unit.row // scale // unit.side, unit.column // scale // unit.side
            below.setdefault(place, []).append(t)
    places = list(below.values())
    share = abs(change) / max(_GIVES * sum(size_t[each].sum() for each in places), 1.0)
    if share > 1.0:
        return [list(range(len(size_t)))]
    count = min(max(math.ceil(share * len(places)), _LEAST_PLACES), len(places))
    return [places[(2 * n + 1) * len(places) // (2 * count)] for n in range(count)]
