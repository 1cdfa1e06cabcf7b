"""Find the quantiser step that spends a given number of bits, in few trials."""

from __future__ import annotations

import functools
import math
from bisect import bisect_left
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.symbols import zero_order_bits
from clrelight.search import search_falling

STEPS_PER_OCTAVE = 2048
FINEST = 22  # the finest step is 2**-22 of a map whose largest magnitude is in [1, 2): float32's own precision
COARSEST_CODE = 65534

_MAX_TRIALS = 16
_SAMPLES = 20_000


def step_of(code: int) -> float:
    """Return the float32 step of a code in 0 .. 65534: ``2**(code/2048 - 22)``."""
    return float(np.float32(2.0 ** (code / STEPS_PER_OCTAVE - FINEST)))


def take_sample(planes_chw: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return some of a map's values, at the same places of every map of its shape."""
    # One stride for the flattened map, odd so that it meets all columns: every subband gets its share.
    return planes_chw.reshape(-1)[:: max(planes_chw.size // _SAMPLES, 1) | 1]


class Sample:
    """Some of a map's wavelet coefficients, to guess from."""

    def __init__(self, planes_chw: NDArray[np.float32], rounding: float) -> None:
        self._magnitudes = np.abs(take_sample(planes_chw))
        self.share = self._magnitudes.size / planes_chw.size
        self._rounding = rounding
        self.bits = functools.lru_cache(maxsize=64)(self._bits)

    def _bits(self, code: int) -> float:
        """Return about the zero-order entropy of the map's indices at a step."""
        indices = (self._magnitudes * np.float32(1.0 / step_of(code)) + np.float32(self._rounding)).astype(np.int32)
        return zero_order_bits(indices) / self.share


def find_code(
    count_bits: Callable[[int], float],
    guess_bits: Callable[[int], float],
    target: float,
    ceiling: float,
    tolerance: float,
    ratio: float,
    finest: int,
) -> tuple[int | None, float]:
    """Return the step code whose bits come nearest to a target, and the ratio of counted to guessed bits there.

    Parameters
    ----------
    count_bits : callable
        Bits that a code really takes (slow); falls with the code but for a little noise.
    guess_bits : callable
        About proportional to it (fast).
    target, ceiling : float
        Bits asked for, and never to be passed.
    tolerance : float
        Bits from the target that are near enough.
    ratio : float
        Of counted to guessed bits, to start from.
    finest : int
        Least code allowed.

    Returns
    -------
    code : int or None
        None if no step stays below the ceiling.
    ratio : float
        To start the next search from.
    """
    target = min(target, max(ceiling - tolerance, ceiling / 2.0))
    tried: dict[int, float] = {}

    def measure(code: float) -> float:
        nonlocal ratio
        bits = tried[int(code)] = count_bits(int(code))
        if bits > 0.0 and guess_bits(int(code)) > 0.0:
            ratio = bits / guess_bits(int(code))
        return _log(bits)

    def is_enough(_: float) -> bool:
        bits = list(tried.values())[-1]
        # Where bits jump from step to step, a longer search finds little better.
        return bits <= ceiling and abs(bits - target) <= tolerance * min(1.0 + (len(tried) - 1) / 4.0, 1.8)

    def expect(*_: float) -> int:
        return solve_code(guess_bits, target / ratio, finest, COARSEST_CODE)

    search_falling(
        measure,
        expect(),
        (finest, COARSEST_CODE),
        _log(target),
        limit=_log(target),
        is_enough=is_enough,
        expect=expect,
        most=_MAX_TRIALS,
        whole=True,
    )
    allowed = [(abs(bits - target), code) for code, bits in tried.items() if bits <= ceiling]
    return (min(allowed)[1] if allowed else None), ratio


def _log(bits: float) -> float:
    return math.log(bits) if bits > 0.0 else -math.inf


def solve_code(bits: Callable[[int], float], target: float, fine: int, coarse: int) -> int:
    """Return the finest code of at most `target` bits, by bisection."""
    return bisect_left(range(coarse), True, fine, key=lambda code: bits(code) <= target)
