"""Time several ways of doing the same work in turns, so that a busy machine slows all of them alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Quartiles = tuple[float, float, float]
"""Lower quartile, median, upper quartile."""

LEAST_SECONDS = 0.01
"""A sample repeats short work until it takes about this long."""
MOST_REPEATS = 1000
FEWEST_ROUNDS = 3
SETTLE_SECONDS = 0.15
"""Pause before a sample: OpenBLAS's threads spin for some 100 ms after their work, which costs who comes next 40%."""


@dataclass(frozen=True)
class Timings:
    """Seconds of each contender in each round.

    Attributes
    ----------
    first : mapping of str to float
        Seconds of the very first run, which compiles kernels and touches memory for the first time.
    seconds : mapping of str to ndarray, shape (round,), float64
        Seconds of one run, a mean over a sample's repeats.
    """

    first: Mapping[str, float]
    seconds: Mapping[str, NDArray[np.float64]]

    def time(self, name: str) -> Quartiles:
        """Return the quartiles of a contender's seconds."""
        return quartiles(self.seconds[name])

    def speed(self, name: str, peer: str) -> Quartiles:
        """Return the quartiles of the rounds' own ratios ``peer time / time``: 2 is twice as fast as the peer."""
        return quartiles(self.seconds[peer] / self.seconds[name])


def quartiles(values: NDArray[np.float64]) -> Quartiles:
    """Return lower quartile, median and upper quartile."""
    low, middle, high = np.percentile(values, (25, 50, 75))
    return float(low), float(middle), float(high)


def interleave(
    runs: Mapping[str, Callable[[], object]],
    *,
    finish: Callable[[], None],
    rounds: int,
    least_seconds: float = LEAST_SECONDS,
    most_seconds: float = float("inf"),
    settle_seconds: float = SETTLE_SECONDS,
    first: Mapping[str, float] | None = None,
    fewest_rounds: int = FEWEST_ROUNDS,
) -> Timings:
    """Run all contenders once apart, once to warm up, then `rounds` times in turns.

    Parameters
    ----------
    runs : mapping of str to callable
        The contenders. Every other round takes them in reverse, so that none always finds the caches of the same one.
    finish : callable
        Waits for the device; called inside the timed part after every run, also of those that use no device.
    rounds : int
        Samples of each contender, at least 1.
    least_seconds : float
        Repeat short work within a sample until it takes about this long.
    most_seconds : float
        Where all rounds would take longer than this, there are fewer, but not below `fewest_rounds`.
    settle_seconds : float
        Pause before each sample.
    first : mapping of str to float, optional
        Seconds of first runs that were made before: none is run apart or to warm up then.
    fewest_rounds : int
        How far `most_seconds` may cut the rounds.
    """
    if rounds < 1:
        raise ValueError(f"rounds must be at least 1, got {rounds}")
    warm = first
    if first is None or warm is None:
        first = {name: _seconds(run, finish, 1) for name, run in runs.items()}
        warm = {name: max(_seconds(run, finish, 1), 1e-9) for name, run in runs.items()}
    repeats = {name: min(max(1, round(least_seconds / seconds)), MOST_REPEATS) for name, seconds in warm.items()}
    round_seconds = sum(seconds * repeats[name] for name, seconds in warm.items())
    rounds = min(rounds, max(fewest_rounds, int(min(most_seconds / round_seconds, rounds))))
    samples: dict[str, list[float]] = {name: [] for name in runs}
    for index in range(rounds):
        for name in list(runs) if index % 2 == 0 else list(runs)[::-1]:
            time.sleep(settle_seconds)
            samples[name].append(_seconds(runs[name], finish, repeats[name]))
    return Timings(first, {name: np.array(values) for name, values in samples.items()})


def _seconds(run: Callable[[], object], finish: Callable[[], None], repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        run()
        finish()
    return (time.perf_counter() - start) / repeats
