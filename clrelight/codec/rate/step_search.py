"""Find the quantiser step that spends a given number of bits, in few trials."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.symbols import zero_order_bits

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
    tried: list[tuple[float, int, float]] = []  # (distance from the target, code, bits)
    allowed: list[tuple[float, int]] = []
    fine, coarse = finest - 1, COARSEST_CODE + 1  # known to take more, and not more, than the target
    code = solve_code(guess_bits, target / ratio, finest, COARSEST_CODE)
    for trial in range(_MAX_TRIALS):
        bits = count_bits(code)
        tried = sorted([*tried, (abs(bits - target), code, bits)])
        if bits > 0.0 and guess_bits(code) > 0.0:
            ratio = bits / guess_bits(code)
        if bits <= ceiling:
            allowed.append((abs(bits - target), code))
            # Where bits jump from step to step, a longer search finds little better.
            if abs(bits - target) <= tolerance * min(1.0 + trial / 4.0, 1.8):
                break
        if bits > target:
            fine = max(fine, code)
        else:
            coarse = min(coarse, code)
        if coarse - fine <= 1:
            break
        code = _next_code(tried, target, guess_bits, ratio, finest)
        if not fine < code < coarse:
            code = (fine + coarse) // 2
    return (min(allowed)[1] if allowed else None), ratio


def _next_code(
    tried: list[tuple[float, int, float]],
    target: float,
    guess_bits: Callable[[int], float],
    ratio: float,
    finest: int,
) -> int:
    """Return the code where the two best trials, or else the guess, expect the target."""
    if len(tried) >= 2:
        (_, code_a, bits_a), (_, code_b, bits_b) = tried[:2]
        if min(bits_a, bits_b, target) > 0.0 and bits_a != bits_b:
            slope = (code_b - code_a) / (np.log(bits_b) - np.log(bits_a))
            return round(code_a + slope * (np.log(target) - np.log(bits_a)))
    return solve_code(guess_bits, target / ratio, finest, COARSEST_CODE)


def solve_code(bits: Callable[[int], float], target: float, fine: int, coarse: int) -> int:
    """Return the finest code of at most `target` bits, by bisection."""
    while fine < coarse:
        middle = (fine + coarse) // 2
        if bits(middle) > target:
            fine = middle + 1
        else:
            coarse = middle
    return fine
