"""The wavelet codec's quantiser steps and noise as they are to be expected, from a sample and a few maps coded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.range_coding import BitCounter
from clrelight.codec.entropy.subbands import Statistics
from clrelight.codec.rate.allocation import ABSENT, AIM, MAP_TOLERANCE, ROUNDING, TransformedMaps, own_codes
from clrelight.codec.rate.noise import second_moments
from clrelight.codec.rate.step_search import COARSEST_CODE, STEPS_PER_OCTAVE, Sample, solve_code, step_of

_MAPS_PER_TRIAL = 16
_SAVING = (0.48, 0.033)
"""How much of a sample's zero-order entropy context modelling saves, and how much less of it a bit per coefficient."""
_SCATTER = 1.6
"""Standard deviation, among maps, of the ratio of coded to guessed bits, where the sample had one bit."""
_DRAWS = 16

Codes = NDArray[np.int64]
Guesses = Mapping[int, Callable[[int], float]]


def expect_codes(
    maps: TransformedMaps, exponents: NDArray[np.integer], asked: int, budget: int, allocation: str
) -> tuple[Codes, NDArray[np.float64]]:
    """Return about the step codes that `spend_alike` (``"map"``) or `spend_by_one_step` (``"global"``) will choose.

    The bits of a step are guessed from the zero-order entropy of a map's sample; one map in sixteen is coded to see how
    far that is off. Beside the codes stands the standard deviation in which the true ones will differ from these.
    """
    spread = np.zeros(len(exponents))
    samples = maps.samples()
    guesses: Guesses = {k: partial(_guess_bits, sample, maps.size // len(exponents)) for k, sample in samples.items()}
    if not guesses:
        return np.full(len(exponents), ABSENT, np.int64), spread
    target = max(budget - (1.0 - AIM) * asked, 0.0)
    if allocation == "map":
        codes = _choose_alike(guesses, exponents, target)
        noise = {k: (step_of(int(codes[k])) * 2.0 ** exponents[k]) ** 2 for k in guesses}
        codes = _choose_alike(guesses, exponents, target / _try_maps(maps, guesses, codes, noise))
        for k, guess in guesses.items():
            code = int(codes[k])
            here = guess(code)
            fall = here - guess(code + STEPS_PER_OCTAVE // 4)
            if 0 < code < COARSEST_CODE and fall > 0:
                # The search lets a map's bits be anything within its tolerance.
                deviation = np.sqrt(MAP_TOLERANCE**2 / 3.0 + _SCATTER**2 / (here * samples[k].share))
                spread[k] = deviation * here * (STEPS_PER_OCTAVE // 4) / fall
        return codes, spread
    codes = _choose_one_step(guesses, exponents, target)
    bits = {k: guess(int(codes[k])) for k, guess in guesses.items() if codes[k] != ABSENT}
    return _choose_one_step(guesses, exponents, target / _try_maps(maps, guesses, codes, bits)), spread


def _guess_bits(sample: Sample, size: int, code: int) -> float:
    bits = sample.bits(code)
    return bits * min(1.0 - _SAVING[0] + _SAVING[1] * bits / size, 0.95)


def _try_maps(maps: TransformedMaps, guesses: Guesses, codes: Codes, weights: Mapping[int, float]) -> float:
    """Return the ratio of coded to guessed bits of a few maps, taken evenly along their weights; 1 where none has bits.

    Another map comes first, for them to learn from.
    """
    along = np.cumsum(list(weights.values()))
    if not len(along) or along[-1] <= 0.0:
        return 1.0
    count = -(-len(weights) // _MAPS_PER_TRIAL)
    places = np.searchsorted(along, along[-1] * (np.arange(count) + 0.5) / count)
    tried = [list(weights)[i] for i in dict.fromkeys(places.tolist())]
    others = [k for k in weights if k not in tried]
    statistics, counter = Statistics(), BitCounter()
    for k in others[len(others) // 2 :][:1]:
        maps.run(BitCounter(), statistics, k, int(codes[k]))
    for k in tried:
        maps.run(counter, statistics, k, int(codes[k]))
    guessed = sum(guesses[k](int(codes[k])) for k in tried)
    return counter.bits / guessed if counter.bits and guessed else 1.0


def _choose_alike(guesses: Guesses, exponents: NDArray[np.integer], target: float) -> Codes:
    codes = np.full(len(exponents), ABSENT, np.int64)
    # The finest step's bits are all that a map can use; what it leaves is shared by the others.
    order = sorted(guesses, key=lambda k: guesses[k](0))
    for done, k in enumerate(order):
        share = target / (len(order) - done)
        codes[k] = solve_code(guesses[k], share, 0, COARSEST_CODE)
        target -= guesses[k](0) if codes[k] == 0 else share
    return codes


def _choose_one_step(guesses: Guesses, exponents: NDArray[np.integer], target: float) -> Codes:
    def bits(code: int) -> float:
        codes = own_codes(code, guesses, exponents)
        return sum(guess(int(codes[k])) for k, guess in guesses.items() if codes[k] != ABSENT)

    return own_codes(solve_code(bits, target, 0, COARSEST_CODE), guesses, exponents)


def expect_moments(
    maps: TransformedMaps, codes: Codes, spread: NDArray[np.float64], exponents: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Return the second moments (n_coeff, n_coeff) of the quantiser's errors at a sample of wavelet coefficients.

    They are those of the coefficients too, the transform being near orthonormal. Moments between maps count as much as
    variances do: what the dead zone swallows is a piece of the same shadow's edge in every map, and maps that are
    multiples of each other have errors that are too, as far as their steps are. So steps are drawn within their spread.
    """
    values_kp = maps.sampled_values().astype(np.float64)
    generator = np.random.default_rng(0)
    moments = np.zeros((len(codes), len(codes)))
    for draw in range(_DRAWS):
        part_kp = values_kp[:, draw::_DRAWS]
        drawn = codes + np.rint(spread * generator.standard_normal(len(codes))).astype(np.int64)
        steps = np.array([step_of(int(code)) for code in np.clip(drawn, 0, COARSEST_CODE)])
        steps[codes == ABSENT] = np.inf
        errors_kp = _quantise(part_kp, steps) - part_kp
        moments += second_moments(errors_kp) * part_kp.shape[1] / values_kp.shape[1]
    scale = np.ldexp(1.0, exponents)
    return moments * np.outer(scale, scale)


def _quantise(values_kp: NDArray[np.float64], step_k: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values as they are decoded, with the biases of these."""
    magnitudes_kp = np.abs(values_kp) / step_k[:, None]
    sizes_kp = np.floor(magnitudes_kp + ROUNDING)
    for chosen in (sizes_kp == 1, sizes_kp > 1):
        if chosen.any():
            sizes_kp[chosen] -= (sizes_kp[chosen] - magnitudes_kp[chosen]).mean()
    return np.sign(values_kp) * sizes_kp * np.where(np.isinf(step_k), 0.0, step_k)[:, None]
