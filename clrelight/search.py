"""The search for the place where a quantity that is slow to measure reaches an aim."""

from __future__ import annotations

import math
from collections.abc import Callable

Trials = list[tuple[float, float]]


def search_falling(
    measure: Callable[[float], float],
    start: float,
    bounds: tuple[float, float],
    aim: float,
    *,
    limit: float,
    is_enough: Callable[[float], bool],
    expect: Callable[[float, float], float],
    slopes: tuple[float, float] = (-math.inf, 0.0),
    most: int,
    width: float = 1.0,
    whole: bool = False,
) -> Trials:
    """Measure where a falling quantity is near an aim, in few trials: a secant that is kept in its bracket.

    What is searched for lies between a place whose value is above the limit and one whose is not. The next place is
    where the line through the two trials nearest to the aim meets it. Where that is outside the bracket it is the
    bracket's middle, and an end of the bounds only if the line leads beyond that twice in turn. The line is straight in
    place and value: let both be logarithms where a power is expected.

    SciPy's `brentq` and `toms748` begin with both ends of the bracket, which here cost as much as all other trials,
    know nothing of a typical slope, and end by the place, not by the value.

    Parameters
    ----------
    measure : callable
        The value at a place; falls with the place but for a little noise. It may be infinite.
    start : float
        Where to begin; moved into the bounds.
    bounds : tuple of float
        The least and the greatest place.
    aim : float
        The value to come near to.
    limit : float
        Greater values are on one side of what is searched for, all others on the other.
    is_enough : callable
        Whether a value ends the search.
    expect : callable
        Where the aim is to be expected from one place and its value alone.
    slopes : tuple of float
        The least and the greatest that a line may rise, in places per value.
    most : int
        Trials at the most.
    width : float
        The search ends where the bracket is no wider.
    whole : bool
        Whether places are whole numbers.

    Returns
    -------
    list of tuple of float
        Places and their values, as they were tried; never a place twice.
    """
    low, high = bounds
    beyond: float | None = None
    tried: dict[float, float] = {}
    place = min(max(start, low), high)
    while True:
        value = tried[place] = measure(place)
        if value > limit:
            low = place
        else:
            high = place
        if is_enough(value) or len(tried) == most:
            break
        if high - low <= width:
            left = [end for end in (low, high) if end not in tried]
            if not left:
                break
            place = left[0]
            continue
        guess = _aim_at(aim, list(tried.items()), expect, slopes)
        place = round(guess) if whole and math.isfinite(guess) else guess
        before, beyond = beyond, low if place <= low else high if place >= high else None
        if beyond is not None and beyond == before and beyond not in tried:
            place = beyond
        elif not low < place < high:
            place = (low + high) // 2 if whole else (low + high) / 2.0
    return list(tried.items())


def _aim_at(aim: float, tried: Trials, expect: Callable[[float, float], float], slopes: tuple[float, float]) -> float:
    """Return where the two trials that are nearest to the aim expect it; NaN where none is of use."""
    near = sorted((trial for trial in tried if math.isfinite(trial[1])), key=lambda trial: abs(trial[1] - aim))[:2]
    if not near:
        return math.nan
    (place, value), (other, other_value) = near[0], near[-1]
    if value == other_value:
        return expect(place, value)
    return place + min(max((other - place) / (other_value - value), slopes[0]), slopes[1]) * (aim - value)
