"""The quantiser steps of the codec `wavelet`: every map the same rate, or all the same step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.formats.wavelet_units import STEPS_PER_OCTAVE, code_of

_FINEST, _COARSEST = -21.0, 12.0
"""Logarithms of steps, in units of a map's power of two: no index of the finest passes what units hold."""
_ENOUGH = 2000.0
"""Bits of a map from which on two trials tell how they hang on the step."""
_NARROW = 0.02
"""Octaves below which a bracket says nothing."""
_BISECTIONS, _SAMPLES = 24, 1024
_PROXY = 36.0
"""A magnitude of a steps is taken to cost about ``log2(1 + _PROXY a^2) / 2`` bits where sets of them are compared."""


class Steps:
    """Logarithms of steps to base 2, and how bits hang on them.

    Parameters
    ----------
    exponent_m : ndarray, shape (n_map,), int64
        Powers of two of the maps' largest magnitudes.
    channel : int
    alike : bool
        Whether every map gets the same rate.
    """

    def __init__(self, exponent_m: NDArray[np.int64], channel: int, alike: bool) -> None:
        self._alike = alike
        # Rotated channels are larger by a root of their number; codes are whole numbers.
        self._finest_m = exponent_m + _FINEST + 0.5 * np.log2(channel) + 1.0 / STEPS_PER_OCTAVE
        self._coarsest_m = exponent_m + _COARSEST
        self._log_m: NDArray[np.float64] = self._coarsest_m.astype(np.float64)
        self._before: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._fine_m, self._coarse_m = self._no_bracket()

    def _no_bracket(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return np.full(len(self._log_m), -np.inf), np.full(len(self._log_m), np.inf)

    def forget_bracket(self) -> None:
        """Forget between which steps maps took more bits than they should, and fewer: other parts are measured now."""
        self._fine_m, self._coarse_m = self._no_bracket()

    def codes(self, shift: float = 0.0) -> NDArray[np.int64]:
        """Return the steps' codes, all coarser by some octaves, as far as they go."""
        return code_of(np.clip(self._log_m + shift, self._finest_m, self._coarsest_m))

    def bounds(self) -> tuple[float, float]:
        """Return the shifts beyond which no step changes any more."""
        return float((self._finest_m - self._log_m).min()), float((self._coarsest_m - self._log_m).max())

    def guess(self, size_mp: NDArray[np.float32], exponent_m: NDArray[np.int64], rate: float) -> None:
        """Set steps at which magnitudes of a sample, in units of their maps' powers of two, take about a rate."""
        stride = max(size_mp.shape[1] // _SAMPLES, 1) | 1
        squares_mp = _PROXY * np.square(size_mp[:, ::stride].astype(np.float64))
        unit_m = np.zeros(len(size_mp)) if self._alike else (exponent_m - exponent_m.max()).astype(np.float64)
        squares_mp *= np.exp2(2.0 * unit_m)[:, None]
        shape = (len(size_mp), 1) if self._alike else (1, 1)
        fine, coarse = np.full(shape, _FINEST), np.full(shape, _COARSEST)
        for _ in range(_BISECTIONS):
            middle = (fine + coarse) / 2.0
            bits = 0.5 * np.log2(1.0 + squares_mp * np.exp2(-2.0 * middle)).mean(
                axis=1 if self._alike else None, keepdims=True
            )
            fine, coarse = np.where(bits > rate, middle, fine), np.where(bits > rate, coarse, middle)
        largest_m = exponent_m if self._alike else np.full(len(exponent_m), exponent_m.max())
        self._set(np.broadcast_to(coarse[:, 0], (len(size_mp),)) + largest_m)
        self._before = None

    def proxies(self, size_mp: NDArray[np.float32], exponent_m: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return about the mean bits of magnitudes at these steps, (n_map,)."""
        scale_m = np.exp2(2.0 * (exponent_m - self._log_m)) * _PROXY
        return 0.5 * np.log2(1.0 + np.square(size_mp) * scale_m[:, None].astype(np.float32)).mean(
            axis=1, dtype=np.float64
        )

    def correct(self, bits_m: NDArray[np.float64], target: float, n_value: int) -> float:
        """Set steps at which maps should take a number of bits together; return by how many octaves one was off.

        Parameters
        ----------
        bits_m : ndarray, shape (n_map,), float64
            What each map took.
        target : float
            Bits of all maps.
        n_value : int
            Values of a map.
        """
        log_m: NDArray[np.float64] = self._log_m.copy()
        found_m = np.maximum(bits_m, 1.0).astype(np.float64)
        at_end_m = log_m <= self._finest_m + 1e-9
        if not self._alike:
            found_m = np.full(len(bits_m), float(found_m.sum()), np.float64)
            at_end_m = np.zeros(len(bits_m), np.bool_)
            wanted_m = np.full(len(bits_m), max(target, 1.0))
            rate_m = found_m / (n_value * len(bits_m))
        else:
            wanted_m = _share(found_m, at_end_m, target)
            rate_m = found_m / n_value
        slope_m = -1.0 / (rate_m + 0.7)
        if self._before is not None:
            moved_m, grown_m = log_m - self._before[0], np.log2(found_m / self._before[1])
            known_m = (np.abs(moved_m) > 0.02) & (found_m > _ENOUGH)
            secant_m = np.divide(grown_m, moved_m, out=slope_m.copy(), where=known_m)
            slope_m = np.clip(secant_m, 2.5 * slope_m, 0.4 * slope_m)
        off_m = np.log2(wanted_m / found_m)
        self._before = log_m, found_m
        moves_m: NDArray[np.float64] = np.clip(off_m / slope_m, -6.0, 6.0)
        self._set(self._kept_between(log_m, log_m + moves_m, found_m > wanted_m))
        off_m[at_end_m & (off_m > 0)] = 0.0
        return float(np.abs(off_m).max())

    def _kept_between(
        self, log_m: NDArray[np.float64], next_m: NDArray[np.float64], too_many_m: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Return the next steps, in the middle of their bracket where they leave it: bits fall off a cliff to zeros."""
        fine_m, coarse_m = self._fine_m, self._coarse_m
        fine_m[too_many_m] = log_m[too_many_m]
        coarse_m[~too_many_m] = log_m[~too_many_m]
        stale_m = coarse_m - fine_m < _NARROW
        fine_m[stale_m], coarse_m[stale_m] = -np.inf, np.inf
        outside_m = ((next_m <= fine_m) | (next_m >= coarse_m)) & np.isfinite(fine_m) & np.isfinite(coarse_m)
        middle_m = np.add(fine_m, coarse_m, out=next_m.copy(), where=outside_m)
        return np.where(outside_m, middle_m / 2.0, next_m)

    def _set(self, log_m: NDArray[np.float64]) -> None:
        self._log_m = np.clip(log_m, self._finest_m, self._coarsest_m)


def _share(bits_m: NDArray[np.float64], at_end_m: NDArray[np.bool_], target: float) -> NDArray[np.float64]:
    """Return equal shares of bits, but for maps at their finest step that cannot use theirs: others get the rest."""
    wanted_m, left, others = np.zeros(len(bits_m)), target, len(bits_m)
    for m in np.argsort(np.where(at_end_m, bits_m, np.inf), kind="stable"):
        share = max(left / others, 1.0)
        wanted_m[m] = min(bits_m[m], share) if at_end_m[m] else share
        left, others = left - wanted_m[m], others - 1
    return wanted_m
