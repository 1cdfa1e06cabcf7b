"""Choose the quantiser steps of transformed maps and code them, so that all bytes together come to those asked for."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.range_coding import BitCounter, Encoder
from clrelight.codec.entropy.subband_kernel import SubbandEncoder, encoder_for
from clrelight.codec.entropy.subbands import Statistics, code_indices
from clrelight.codec.entropy.symbols import zero_order_bits
from clrelight.codec.rate.step_search import COARSEST_CODE, STEPS_PER_OCTAVE, Sample, find_code, step_of, take_sample
from clrelight.codec.rooms import Planes
from clrelight.codec.streams import Source
from clrelight.codec.transforms.lifting import Subband, quantise_map
from clrelight.opencl.arguments import DeviceArray

AnyEncoder = Encoder | SubbandEncoder

ROUNDING = 0.4  # a dead zone of 1.2 steps: best at 0.1 to 1 bit, and 0.02 dB from the best at 4
ABSENT = 65535  # step code of a map that is zero
AIM, _TOLERANCE = 0.996, 0.003  # of the bytes asked: near the middle of what is allowed, and how near is enough
MAP_TOLERANCE, _MAP_SLACK = 0.015, 12.0  # of one map's share, and bits; the next maps make up for it
BIAS_SCALE = 256.0


class TransformedMaps:
    """Wavelet coefficients of all maps, quantised as asked."""

    def __init__(self, planes: Planes, source: Source, bands: list[Subband]) -> None:
        self._planes, self._shape, self._bands = planes, source.shape, bands
        self._device, self._room = source.device, source.room
        self._held: tuple[int, NDArray[np.float32], DeviceArray] | None = None

    @property
    def size(self) -> int:
        """Coefficients in all."""
        return math.prod(self._shape)

    def samples(self) -> dict[int, Sample]:
        """Return a sample of each map that is not zero."""
        found = {}
        for k in range(self._shape[0]):
            values = self._values(k)
            if values.any():
                found[k] = Sample(values, ROUNDING)
        return found

    def sampled_values(self) -> NDArray[np.float32]:
        """Return every map's values (n_coeff, place) at the same places, some of each subband."""
        return np.stack([take_sample(self._values(k)) for k in range(self._shape[0])])

    def encoder(self) -> AnyEncoder:
        """Return an encoder of these maps."""
        return encoder_for(self._device)

    def run(self, coder: BitCounter | AnyEncoder, statistics: Statistics, k: int, code: int) -> None:
        """Code one map."""
        index = self._quantise(k, step_of(code))
        code_indices(coder, statistics, self._bands, index.shape, index)

    def measure(self, codes: NDArray[np.integer]) -> tuple[tuple[int, int], float]:
        """Return the biases in 1/256 step, and the zero-order entropy of all indices in bits."""
        excess, counts, entropy = np.zeros(2), np.zeros(2), 0.0
        for k in np.flatnonzero(codes != ABSENT).tolist():
            step = step_of(int(codes[k]))
            for index_hw, values_hw in zip(self._quantise(k, step), self._values(k), strict=True):
                magnitudes = np.abs(index_hw)
                entropy += sum(zero_order_bits(magnitudes[band.rows, band.columns]) for band in self._bands)
                exact = np.abs(values_hw) * np.float32(1.0 / step)
                for i, chosen in enumerate((magnitudes == 1, magnitudes > 1)):
                    meant = exact[chosen]
                    excess[i] += float(magnitudes[chosen].sum(dtype=np.int64) - meant.sum(dtype=np.float64))
                    counts[i] += meant.size
        biases = np.clip(np.rint(BIAS_SCALE * excess / np.maximum(counts, 1.0)), -128, 127).astype(int)
        return (int(biases[0]), int(biases[1])), entropy

    def tell(self, done: int, total: int) -> None:
        """Hear how many maps are coded."""
        self._room.tell(done, total)

    def _values(self, k: int) -> NDArray[np.float32]:
        return self._hold(k)[0][:, :, : self._shape[2]]

    def _quantise(self, k: int, step: float) -> NDArray[np.int32]:
        return quantise_map(self._hold(k)[1], 0, (1, *self._shape[1:]), step, ROUNDING, self._device)

    def _hold(self, k: int) -> tuple[NDArray[np.float32], DeviceArray]:
        """Return a map (channel, height, padded width) on the host and on the device; the last one is kept."""
        if self._held is None or self._held[0] != k:
            self._held = None  # its memory goes before more is taken
            (values_chw,) = self._planes.maps(k, k + 1)
            self._held = k, values_chw, self._device.upload(values_chw)
        return self._held[1:]


def coding_order(codes: NDArray[np.integer]) -> list[int]:
    """Return the maps as they follow each other: those of the finest step, then the others."""
    return np.argsort(codes != 0, kind="stable").tolist()


def statistics_for(code: int, shared: Statistics) -> Statistics:
    """Return what a map learns into: at the finest step it is unlike the others, and learns alone."""
    return Statistics() if code == 0 else shared


class _Trials:
    """One map coded at several steps after what is coded already; the first guess is mostly the one that stays."""

    def __init__(self, maps: TransformedMaps, encoder: AnyEncoder, statistics: Statistics, k: int) -> None:
        self._maps, self._encoder, self._statistics, self._k = maps, encoder, statistics, k
        self.outcomes: dict[int, tuple[AnyEncoder, Statistics]] = {}

    def count_bits(self, code: int) -> float:
        """Code the map at a step, and return by how many bits the payload grows."""
        encoder, statistics = self._encoder.copy(), self._statistics.copy()
        self._maps.run(encoder, statistics, self._k, code)
        self.outcomes[code] = encoder, statistics
        return 8.0 * (encoder.byte_count - self._encoder.byte_count)


def spend_alike(
    maps: TransformedMaps, exponents: NDArray[np.integer], asked: int, budget: int
) -> tuple[NDArray[np.int64], bytes]:
    """Spend alike on every map: each aims at an equal share of what is left.

    Parameters
    ----------
    maps : TransformedMaps
        What to code.
    exponents : ndarray, shape (n_coeff,), integer
        Powers of two that the maps were divided by.
    asked, budget : int
        Bits asked for in all, and what side tables leave of them.

    Returns
    -------
    codes : ndarray, shape (n_coeff,), int64
        Step codes; `ABSENT` for a map that is zero.
    payload : bytes
        The range-coded indices, in `coding_order`; at most `budget` bits.
    """
    codes = np.full(len(exponents), ABSENT, np.int64)
    samples = maps.samples()
    limited = _find_limited(maps, samples, budget)
    codes[limited] = 0
    encoder, statistics, ratio = maps.encoder(), Statistics(), 0.8
    for k in limited:
        maps.run(encoder, Statistics(), k, 0)
    others = [k for k in samples if k not in limited]
    for done, k in enumerate(others):
        spent = 8 * encoder.byte_count
        target = (budget - (1.0 - AIM) * asked - spent) / (len(others) - done)
        tolerance = min(MAP_TOLERANCE * asked / len(others) + _MAP_SLACK, _TOLERANCE * asked)
        trials = _Trials(maps, encoder, statistics, k)
        code, ratio = find_code(trials.count_bits, samples[k].bits, target, budget - spent, tolerance, ratio, 1)
        if code is not None:
            codes[k] = code
            encoder, statistics = trials.outcomes[code]
        maps.tell(done + 1, len(others))
    return codes, encoder.to_bytes()


def _find_limited(maps: TransformedMaps, samples: dict[int, Sample], budget: int) -> list[int]:
    """Return the maps that cannot use an equal share, what they leave being shared by the others."""
    full = {k: sample.bits(0) for k, sample in samples.items()}
    limited: list[int] = []
    left = 0.999 * budget - 64.0  # one after another they take other bytes than alone
    for k in sorted(full, key=lambda k: (full[k], k)):
        share = left / (len(full) - len(limited))
        if full[k] > 3.0 * share:
            break
        bits = _Trials(maps, maps.encoder(), Statistics(), k).count_bits(0)
        if bits <= share:
            limited.append(k)
            left -= bits
    return sorted(limited)


def own_codes(code: int, present: Collection[int], exponents: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the codes of the maps' own scales for the code of the largest map; `ABSENT` where it is too coarse."""
    largest = max((int(exponents[k]) for k in present), default=0)
    own = code + STEPS_PER_OCTAVE * (largest - exponents.astype(np.int64))
    own = np.where(own > COARSEST_CODE, ABSENT, own)
    absent = np.setdiff1d(np.arange(len(own)), list(present))
    own[absent] = ABSENT
    return own


def spend_by_one_step(
    maps: TransformedMaps, exponents: NDArray[np.integer], asked: int, budget: int
) -> tuple[NDArray[np.int64], bytes]:
    """Spend by one step, in the coefficients' own unit, for all maps; see `spend_alike`."""
    samples = maps.samples()

    def run(coder: BitCounter | AnyEncoder, code: int) -> None:
        codes, shared = own_codes(code, samples, exponents), Statistics()
        for k in coding_order(codes):
            if codes[k] != ABSENT:
                maps.run(coder, statistics_for(int(codes[k]), shared), k, int(codes[k]))

    def count(code: int) -> float:
        counter = BitCounter()
        run(counter, code)
        return counter.bits

    def guess(code: int) -> float:
        codes = own_codes(code, samples, exponents)
        return sum(sample.bits(int(codes[k])) for k, sample in samples.items() if codes[k] != ABSENT)

    # The range coder needs some more than the bits counted, mostly where contexts are many and symbols few.
    margin = 0
    while margin < budget:
        target = budget - (1.0 - AIM) * asked - margin
        code, _ = find_code(count, guess, target, budget - margin, _TOLERANCE * asked, 0.8, 0)
        if code is None:
            break
        encoder = maps.encoder()
        run(encoder, code)
        excess = 8 * encoder.byte_count - budget
        if excess <= 0:
            return own_codes(code, samples, exponents), encoder.to_bytes()
        margin = max(2 * margin, excess + 32)
    return np.full(len(exponents), ABSENT, np.int64), b""
