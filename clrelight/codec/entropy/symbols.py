"""Integers as symbols of a small alphabet with raw bits below, and the classes that contexts are made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DIRECT = 16
"""Magnitudes below this are symbols of their own; above, four symbols share an octave and raw bits follow."""

ALPHABET = DIRECT + 4 * 27
"""Symbols of magnitudes below 2**31."""

CLASSES = 64
"""Classes of `classify`: two an octave."""

_LOOKUP = 1 << 14


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


def geometric_prior(means: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (len(means), ALPHABET) symbol probabilities of geometric magnitudes with these means."""
    ratio = means / (1.0 + means)
    tail = np.empty((len(means), ALPHABET + 1))
    for symbol, first in enumerate(FIRST):
        tail[:, symbol] = _power(ratio, int(first))
    tail[:, ALPHABET] = 0.0
    return tail[:, :-1] - tail[:, 1:]


def _power(base: NDArray[np.float64], exponent: int) -> NDArray[np.float64]:
    # np.power may differ in its last bit between machines; products do not.
    result, square = np.ones_like(base), base.copy()
    while exponent:
        if exponent & 1:
            result = result * square
        square = square * square
        exponent >>= 1
    return result
