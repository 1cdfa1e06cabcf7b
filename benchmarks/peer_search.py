"""Points of quality and bytes, and the search for those at which a peer is as good as klt."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

TOLERANCE = 0.02
"""Decibel within which two qualities are one."""

_AS_GOOD = 0.1
"""Decibel below the best setting that bytes may buy where none reaches what is asked for."""

CODING, SEEN, HELD_OUT = "coding", "seen", "held out"
"""What a PSNR is of: images from decoded coefficients against those from the fit, at all lights; images against
photographs at the lights that were fitted or stored; and the same at lights that were not."""


@dataclass(frozen=True)
class Point:
    """One setting of a codec on one stack.

    Attributes
    ----------
    byte_count : int
    psnr : mapping of str to float
        Pooled, in decibel, by what it is of.
    encode_seconds, decode_seconds : float
    setting : str
    """

    byte_count: int
    psnr: Mapping[str, float]
    encode_seconds: float
    decode_seconds: float
    setting: str = ""


@dataclass(frozen=True)
class Match:
    """What a peer takes at a quality.

    Attributes
    ----------
    byte_count : float or None
        At the quality asked for: between two settings, the logarithm is linear in decibel. None where no setting
        reaches it.
    nearest : Point
        The setting nearest to it: its seconds are what the peer took. Where none reaches it, the smallest of the best.
    """

    byte_count: float | None
    nearest: Point


def match(
    evaluate: Callable[[float], Point],
    measure: str,
    target: float,
    start: float,
    bounds: tuple[float, float],
    stride: float,
    *,
    whole: bool = False,
    most: int = 7,
) -> Match:
    """Return what a codec takes at a PSNR by moving a parameter with which quality grows.

    Parameters
    ----------
    evaluate : callable
        From the parameter to the point. Points should be kept: few parameters come twice, but several targets do.
    measure : str
        Which PSNR is matched.
    target : float
        In decibel.
    start, bounds, stride : float
        The first parameter, the least and the largest, and how far the next one is.
    whole : bool
        Whether parameters are whole numbers.
    most : int
        Settings to try.
    """
    found: dict[float, Point] = {}
    place = min(max(round(start) if whole else start, bounds[0]), bounds[1])
    while place not in found and len(found) < most:
        found[place] = evaluate(place)
        off = {at: point.psnr[measure] - target for at, point in found.items()}
        if min(abs(value) for value in off.values()) < TOLERANCE:
            break
        below = [at for at, value in off.items() if value < 0.0]
        above = [at for at, value in off.items() if value >= 0.0]
        if below and above:
            low, high = max(below, key=off.__getitem__), min(above, key=off.__getitem__)
            part = min(max(off[low] / (off[low] - off[high]), 0.1), 0.9)
            place = low + (high - low) * part
        else:
            place = max(below) + stride if below else min(above) - stride
            stride *= 2.0
        place = min(max(round(place) if whole else place, bounds[0]), bounds[1])
    return _between(list(found.values()), measure, target)


def _between(points: list[Point], measure: str, target: float) -> Match:
    nearest = min(points, key=lambda point: abs(point.psnr[measure] - target))
    below = [point for point in points if point.psnr[measure] < target]
    above = [point for point in points if point.psnr[measure] >= target]
    if above and below:
        low = max(below, key=lambda point: point.psnr[measure])
        high = min(above, key=lambda point: point.psnr[measure])
        part = (target - low.psnr[measure]) / (high.psnr[measure] - low.psnr[measure])
        logarithm = math.log(low.byte_count) * (1.0 - part) + math.log(high.byte_count) * part
        return Match(math.exp(logarithm), nearest)
    if above or abs(nearest.psnr[measure] - target) < TOLERANCE:
        # The coarsest setting is better than asked for: it is the least that the peer takes.
        return Match(float(nearest.byte_count), nearest)
    best = max(point.psnr[measure] for point in points)
    as_good = [point for point in points if point.psnr[measure] > best - _AS_GOOD]
    return Match(None, min(as_good, key=lambda point: point.byte_count))
