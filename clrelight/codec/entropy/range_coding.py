"""Adaptive range coding of integers in contexts, vectorised: count, encode and decode share one interface.

A `ModelSet` holds one frequency table per context. Symbols are coded in batches: all symbols of a batch use the tables
as they were before it, then the tables learn the batch. Encoder and decoder learn alike, so no table is ever sent.
Tables are integers. The bounds of symbols in 2**24 are made of them by one division and one multiplication of doubles,
which IEEE 754 rounds alike everywhere, and go to the range coder as whole numbers. See docs/bitstream.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, Self

import constriction
import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.symbols import DIRECT, FIRST, PRIOR_WEIGHT, RAW_BITS, symbols_of
from clrelight.errors import PayloadError

# One observation adds GAIN to a table's count; a table that weighs more than LIMIT is halved, to follow the data.
GAIN = 1024
LIMIT = GAIN * 8192

Step = tuple[NDArray[np.int32], object]
"""Symbols, and the model of constriction that they are coded with."""

_PRECISION = 24  # bits of the range that symbols share

_MAX_RAW_BITS = 23  # constriction's Uniform takes less than 2**24 values


class ModelSet:
    """Frequency tables, one per context.

    Parameters
    ----------
    prior : ndarray, shape (contexts, symbols), int64 or float64
        Counts to start from; or probabilities, multiples of 2**-14.
    """

    def __init__(self, prior: NDArray[np.int64] | NDArray[np.float64]) -> None:
        whole = prior.dtype == np.int64
        self.counts = prior.copy() if whole else np.floor(prior * PRIOR_WEIGHT).astype(np.int64) + 1

    def copy(self) -> Self:
        """Return tables that learn apart."""
        twin = object.__new__(type(self))
        twin.counts = self.counts.copy()
        return twin

    def learn(self, contexts: NDArray[np.integer], histograms_cs: NDArray[np.integer]) -> None:
        """Add what was seen: one histogram for each context named (each once)."""
        counts = self.counts[contexts] + GAIN * histograms_cs
        weight = counts.sum(axis=1)
        while (heavy := weight > LIMIT).any():
            counts[heavy] = (counts[heavy] + 1) >> 1
            weight[heavy] = counts[heavy].sum(axis=1)
        self.counts[contexts] = counts

    def count_bits(self, contexts: NDArray[np.integer], histograms_cs: NDArray[np.integer]) -> float:
        """Return the ideal code length of what was seen in the contexts named (each once)."""
        counts = self.counts[contexts]
        seen = histograms_cs > 0
        whole = float(histograms_cs.sum(axis=1) @ np.log2(counts.sum(axis=1)))
        return whole - float(histograms_cs[seen] @ np.log2(counts[seen]))


class Coder(Protocol):
    """Where symbols go to or come from. What is given is None where they are decoded; what holds is returned."""

    def code(
        self, models: ModelSet, contexts: NDArray[np.integer], symbols: NDArray[np.integer] | None
    ) -> NDArray[np.integer]:
        """Code one symbol in each context, as one batch."""
        ...

    def code_raw(self, widths: NDArray[np.integer], values: NDArray[np.integer] | None) -> NDArray[np.integer]:
        """Code equally likely integers of ``widths`` bits each."""
        ...


class BitCounter:
    """A coder that only counts, in `bits`; it comes within 0.1% of the bytes that `Encoder` makes."""

    def __init__(self) -> None:
        self.bits = 0.0

    def code(
        self, models: ModelSet, contexts: NDArray[np.integer], symbols: NDArray[np.integer] | None
    ) -> NDArray[np.integer]:
        """See `Coder`."""
        assert symbols is not None
        size = models.counts.shape[1]
        present = np.bincount(contexts) > 0
        used = np.flatnonzero(present)
        rank = np.cumsum(present) - 1
        joint = np.bincount(rank[contexts] * size + symbols, minlength=len(used) * size)
        histograms = joint.reshape(len(used), size)
        self.bits += models.count_bits(used, histograms)
        models.learn(used, histograms)
        return symbols

    def code_raw(self, widths: NDArray[np.integer], values: NDArray[np.integer] | None) -> NDArray[np.integer]:
        """See `Coder`."""
        assert values is not None
        self.bits += float(widths.sum())
        return values


class Encoder:
    """A coder that writes."""

    def __init__(self) -> None:
        self._range = constriction.stream.queue.RangeEncoder()

    def copy(self) -> Self:
        """Return a coder that goes on alone from here."""
        twin = object.__new__(type(self))
        twin._range = self._range.clone()
        return twin

    def code(
        self, models: ModelSet, contexts: NDArray[np.integer], symbols: NDArray[np.integer] | None
    ) -> NDArray[np.integer]:
        """See `Coder`."""
        assert symbols is not None
        order, groups = _group(contexts)
        by_context = symbols[order].astype(np.int32)
        for (_, part), shares in zip(groups, _find_shares(models, groups), strict=True):
            self._range.encode(by_context[part], categorical(shares))
        _learn(models, groups, by_context)
        return symbols

    def code_raw(self, widths: NDArray[np.integer], values: NDArray[np.integer] | None) -> NDArray[np.integer]:
        """See `Coder`."""
        assert values is not None
        order, groups = _group(widths)
        by_width = values[order].astype(np.int64)
        for width, part in groups:
            for shift, digit in digits_of(width):
                digits = (by_width[part] >> shift) & ((1 << digit) - 1)
                self._range.encode(digits.astype(np.int32), constriction.stream.model.Uniform(1 << digit))
        return values

    def put(self, steps: Iterable[Step]) -> None:
        """Code what `clrelight.codec.entropy.known_batches` has made ready."""
        for symbols, model in steps:
            self._range.encode(symbols, model)

    @property
    def byte_count(self) -> int:
        """Length of what `to_bytes` would return now."""
        return 4 * self._range.num_words()

    def to_bytes(self) -> bytes:
        """Return what was coded so far; decoding needs nothing else."""
        return self._range.get_compressed().astype("<u4").tobytes()


class Decoder:
    """A coder that reads what `Encoder` wrote; PayloadError where the bytes cannot be that."""

    def __init__(self, payload: bytes) -> None:
        if len(payload) % 4:
            raise PayloadError(f"the range-coded bytes should be a multiple of 4, they are {len(payload)}")
        words = np.frombuffer(payload, "<u4").astype(np.uint32)
        self._range = constriction.stream.queue.RangeDecoder(words)

    def code(
        self, models: ModelSet, contexts: NDArray[np.integer], symbols: NDArray[np.integer] | None
    ) -> NDArray[np.integer]:
        """See `Coder`."""
        order, groups = _group(contexts)
        by_context = np.empty(len(contexts), np.int32)
        for (_, part), shares in zip(groups, _find_shares(models, groups), strict=True):
            by_context[part] = self._take(categorical(shares), part)
        _learn(models, groups, by_context)
        decoded = np.empty_like(by_context)
        decoded[order] = by_context
        return decoded

    def code_raw(self, widths: NDArray[np.integer], values: NDArray[np.integer] | None) -> NDArray[np.integer]:
        """See `Coder`."""
        order, groups = _group(widths)
        by_width = np.zeros(len(widths), np.int64)
        for width, part in groups:
            for shift, digit in digits_of(width):
                digits = self._take(constriction.stream.model.Uniform(1 << digit), part)
                by_width[part] |= digits.astype(np.int64) << shift
        decoded = np.empty_like(by_width)
        decoded[order] = by_width
        return decoded

    def finish(self) -> None:
        """Raise PayloadError if bytes are left that no symbol needed."""
        if not self._range.maybe_exhausted():
            raise PayloadError("the range-coded bytes hold more than the indices")

    def _take(self, model: object, part: slice) -> NDArray[np.int32]:
        try:
            return self._range.decode(model, part.stop - part.start)
        except (KeyboardInterrupt, SystemExit, MemoryError):
            raise
        except BaseException as error:  # a Rust panic is no Exception
            raise PayloadError(f"the range-coded bytes are damaged: {error}") from None


def code_integers(
    coder: Coder,
    models: ModelSet,
    contexts: NDArray[np.integer],
    values: NDArray[np.integer] | None,
) -> NDArray[np.int32]:
    """Code non-negative integers below 2**31: their symbol in its context, then the raw bits below it."""
    if values is None:
        symbols = coder.code(models, contexts, None)
        coded = FIRST[symbols]
    else:
        symbols = coder.code(models, contexts, symbols_of(values))
        coded = values.astype(np.int32)
    large = np.flatnonzero(symbols >= DIRECT)
    if large.size:
        widths, first = RAW_BITS[symbols[large]], FIRST[symbols[large]]
        coded[large] = first + coder.code_raw(widths, None if values is None else coded[large] - first)
    return coded


def _find_shares(models: ModelSet, groups: list[tuple[int, slice]]) -> NDArray[np.float64]:
    """Return what each symbol of each group's context has of 2**24 beside the 1 that all have: whole numbers.

    Symbol s begins at ``floor(scale (counts before s)) + s``, where ``scale = (2**24 - symbols) / (all counts)``.
    """
    return shares_of(models.counts[[context for context, _ in groups]])


def shares_of(counts_gs: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same of tables, one a row."""
    ends = np.cumsum(counts_gs, axis=1)
    free = (1 << _PRECISION) - ends.shape[1]
    shares = np.floor(ends * (free / ends[:, -1:]))
    shares[:, -1] = free
    shares[:, 1:] -= shares[:, :-1].copy()
    return shares


def categorical(shares: NDArray[np.float64]) -> object:
    """Return the model of a table whose shares are known."""
    # They add up to what constriction has to share out: it rounds nothing, and adds the 1 of each symbol.
    return constriction.stream.model.Categorical(shares, perfect=False)


def _learn(models: ModelSet, groups: list[tuple[int, slice]], by_context: NDArray[np.int32]) -> None:
    """Let the tables learn symbols that stand in the order of their contexts."""
    if not groups:
        return
    size = models.counts.shape[1]
    rows = np.repeat(np.arange(len(groups)) * size, [part.stop - part.start for _, part in groups])
    histograms_cs = np.bincount(rows + by_context, minlength=len(groups) * size).reshape(-1, size)
    models.learn(np.array([context for context, _ in groups]), histograms_cs)


def _group(keys: NDArray[np.integer]) -> tuple[NDArray[np.integer], list[tuple[int, slice]]]:
    """Return the stable order that sorts keys, and each key with its part of that order."""
    order = np.argsort(keys.astype(np.uint16), kind="stable")
    sizes = np.bincount(keys) if len(keys) else np.zeros(0, np.int64)
    present = np.flatnonzero(sizes)
    ends = np.cumsum(sizes[present]).tolist()
    parts = [slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True)] if ends else []
    return order, list(zip(present.tolist(), parts, strict=True))


def digits_of(width: int) -> list[tuple[int, int]]:
    """Return (shift, bits) of the digits of an integer of `width` bits."""
    return [(shift, min(_MAX_RAW_BITS, width - shift)) for shift in range(0, width, _MAX_RAW_BITS)]
