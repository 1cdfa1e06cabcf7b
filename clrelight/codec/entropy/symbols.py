"""Integers as symbols of a small alphabet with raw bits below, and the classes that contexts are made of."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

DIRECT = 16
"""Magnitudes below this are symbols of their own; above, four symbols share an octave and raw bits follow."""

ALPHABET = DIRECT + 4 * 27
"""Symbols of magnitudes below 2**31."""

CLASSES = 64
"""Classes of `classify`: two an octave."""

PRIOR_WEIGHT = 1 << 14
"""What a table's counts weigh before anything is learnt, but for the 1 that each symbol has beside its share."""

_LOOKUP = 1 << 14
_SIMPLE = 1 << 20  # denominators of means are no larger
_PLACES = 64  # binary places of the powers that priors are made of


def _octaves(values: NDArray[np.integer]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    mantissa, exponent = np.frexp(values.astype(np.float64))
    return exponent - 1, mantissa


def _compute_symbols(magnitudes: NDArray[np.integer]) -> NDArray[np.int32]:
    octave, mantissa = _octaves(np.maximum(magnitudes, DIRECT))
    coarse = DIRECT + 4 * (octave - 4) + (mantissa * 8).astype(np.int32) - 4
    return np.where(magnitudes < DIRECT, magnitudes, coarse).astype(np.int32)


def _compute_classes(activity: NDArray[np.integer]) -> NDArray[np.int32]:
    octave, mantissa = _octaves(np.maximum(activity, 1))
    return np.where(activity < 2, activity, 2 * octave + (mantissa >= 0.75)).astype(np.int32)


_SYMBOL_OF = _compute_symbols(np.arange(_LOOKUP)).astype(np.uint8)
_CLASS_OF = _compute_classes(np.arange(_LOOKUP)).astype(np.uint8)
RAW_BITS = np.array([0] * DIRECT + [2 + i // 4 for i in range(ALPHABET - DIRECT)], np.int32)
FIRST = np.array([*range(DIRECT), *((4 + i % 4) << (2 + i // 4) for i in range(ALPHABET - DIRECT))], np.int32)


def symbols_of(magnitudes: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the symbols of non-negative integers below 2**31."""
    if magnitudes.size and magnitudes.max() >= _LOOKUP:
        return _compute_symbols(magnitudes)
    return _SYMBOL_OF[magnitudes]


def classify(activity: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the class, two an octave, of non-negative integers below 2**31: 0, 1, 2, 3, 4-5, 6-7, 8-11, ..."""
    if activity.size and activity.max() >= _LOOKUP:
        return _compute_classes(activity)
    return _CLASS_OF[activity]


def class_floor(index: int) -> int:
    """Return the least activity of a class."""
    return index if index < 2 else (2 + index % 2) << (index // 2) >> 1


def class_means(unit: int, percent: int, at_rest: int) -> list[Fraction]:
    """Return the mean magnitude to expect in each class of activity, in which `unit` is a magnitude of 1.

    So many per cent of the activity in the middle of the class, and so many hundredths in class 0. The last two
    classes are never reached.
    """
    middles = [Fraction(class_floor(i) + class_floor(i + 1), 2 * unit) for i in range(1, CLASSES - 2)]
    return [Fraction(at_rest, 100), *(Fraction(percent, 100) * middle for middle in [*middles, *middles[-1:] * 2])]


def zero_order_bits(magnitudes: NDArray[np.integer]) -> float:
    """Return the zero-order entropy of integers, given their magnitudes: symbols, raw bits and signs."""
    values = magnitudes.ravel()
    if values.max(initial=0) < _LOOKUP:
        # Counting values first spares looking up the symbol of each.
        times = np.bincount(values)
        counts = np.bincount(_SYMBOL_OF[: len(times)], weights=times, minlength=ALPHABET)
    else:
        counts = np.bincount(symbols_of(values), minlength=ALPHABET)
    seen = counts[counts > 0]
    entropy = float((seen * (np.log2(magnitudes.size) - np.log2(seen))).sum())
    return entropy + float(counts @ RAW_BITS) + float(counts[1:].sum())


def even_prior(contexts: int, symbols: int) -> NDArray[np.int64]:
    """Return counts (contexts, symbols) that expect all symbols alike."""
    return np.full((contexts, symbols), PRIOR_WEIGHT // symbols + 1, np.int64)


def geometric_prior(means: Iterable[Fraction | float]) -> NDArray:
    """Return (means, ALPHABET) int64 counts that expect geometric magnitudes of these means.

    Whole numbers alone are computed with, so that tables are the same wherever they are made; a float counts as the
    simple fraction next to it.
    """
    return np.array([_geometric_counts(Fraction(mean).limit_denominator(_SIMPLE)) for mean in means], np.int64)


@functools.lru_cache(maxsize=1024)
def _geometric_counts(mean: Fraction) -> tuple[int, ...]:
    # Magnitudes from v on have the probability (mean / (1 + mean))**v, here in units of 2**-64, rounded down.
    power = [(mean.numerator << _PLACES) // (mean.numerator + mean.denominator)]  # to the exponents 1, 2, 4, ...
    while len(power) <= RAW_BITS[-1]:
        power.append(power[-1] * power[-1] >> _PLACES)
    tails = [1 << _PLACES]
    for symbol in range(ALPHABET - 1):
        tails.append(tails[-1] * power[RAW_BITS[symbol]] >> _PLACES)
    return tuple(1 + (PRIOR_WEIGHT * (this - more) >> _PLACES) for this, more in pairwise([*tails, 0]))
