"""Batches of integers of which all are known before the first is coded: their tables are made at once.

What comes out is what `range_coding.code_integers` and the coding of signs make of one batch after another.
"""

from __future__ import annotations

import constriction
import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.range_coding import GAIN, LIMIT, Step, categorical, digits_of, shares_of
from clrelight.codec.entropy.symbols import DIRECT, FIRST, RAW_BITS, even_prior, symbols_of


def plan_signed(
    prior_cs: NDArray[np.int64], contexts: NDArray[np.integer], values: NDArray[np.int64], lengths: list[int]
) -> list[Step]:
    """Return what `Encoder.put` takes of batches: the symbols of magnitudes in contexts, raw bits, then signs.

    Parameters
    ----------
    prior_cs : ndarray, shape (contexts, symbols), int64
        Counts that the tables of magnitudes start from; that of signs expects both alike.
    contexts, values : ndarray, shape (n,), integer
        One batch after another; magnitudes below 2**31.
    lengths : list of int
        Of the batches.

    Returns
    -------
    list of Step
    """
    sizes, batch = np.abs(values), np.repeat(np.arange(len(lengths)), lengths)
    symbols, nonzero = symbols_of(sizes).astype(np.int64), np.flatnonzero(sizes)
    magnitudes = _plan(prior_cs, contexts.astype(np.int64), symbols, batch, len(lengths))
    signs = (values[nonzero] < 0).astype(np.int64)
    negative = _plan(even_prior(1, 2), np.zeros_like(signs), signs, batch[nonzero], len(lengths))
    raw = _plan_raw(sizes, symbols, batch, len(lengths))
    return [step for each in zip(magnitudes, raw, negative, strict=True) for steps in each for step in steps]


def _plan(
    prior_cs: NDArray[np.int64],
    contexts: NDArray[np.int64],
    symbols: NDArray[np.int64],
    batch: NDArray[np.int64],
    count: int,
) -> list[list[Step]]:
    """Return the steps of each batch: the symbols of one context after those of another."""
    n_context, n_symbol = prior_cs.shape
    order, key_g, ends = _groups(batch * n_context + contexts)
    batch_g, context_g = np.divmod(key_g, n_context)
    rows = np.repeat(np.arange(len(key_g)) * n_symbol, np.diff(ends, prepend=0))
    seen_gs = np.bincount(rows + symbols[order], minlength=len(key_g) * n_symbol).reshape(-1, n_symbol)
    # What a group's table has learnt: all groups of its context before it.
    by_context = np.argsort(context_g, kind="stable")
    sorted_gs, firsts = seen_gs[by_context], np.searchsorted(context_g[by_context], context_g)
    before_gs = np.empty_like(seen_gs)
    before_gs[by_context] = np.cumsum(sorted_gs, axis=0) - sorted_gs
    before_gs -= before_gs[by_context[firsts]]
    counts_gs = prior_cs[context_g] + GAIN * before_gs
    for context in np.unique(context_g[(counts_gs + GAIN * seen_gs).sum(axis=1) > LIMIT]).tolist():
        counts = prior_cs[context]
        for g in np.flatnonzero(context_g == context).tolist():
            counts_gs[g] = counts
            counts = counts + GAIN * seen_gs[g]
            while counts.sum() > LIMIT:
                counts = (counts + 1) >> 1
    found: list[list[Step]] = [[] for _ in range(count)]
    ordered, begin = symbols[order].astype(np.int32), 0
    for b, end, shares in zip(batch_g.tolist(), ends.tolist(), shares_of(counts_gs), strict=True):
        found[b].append((ordered[begin:end], categorical(shares)))
        begin = end
    return found


def _plan_raw(
    sizes: NDArray[np.int64], symbols: NDArray[np.int64], batch: NDArray[np.int64], count: int
) -> list[list[Step]]:
    """Return the steps of each batch's bits below its symbols."""
    large = np.flatnonzero(symbols >= DIRECT)
    order, key_g, ends = _groups(batch[large] * 32 + RAW_BITS[symbols[large]])
    below = (sizes[large] - FIRST[symbols[large]])[order]
    found: list[list[Step]] = [[] for _ in range(count)]
    for key, begin, end in zip(key_g.tolist(), [0, *ends.tolist()], ends.tolist(), strict=False):
        part = below[begin:end]
        for shift, digit in digits_of(key % 32):
            model = constriction.stream.model.Uniform(1 << digit)
            found[key // 32].append(((part >> shift & (1 << digit) - 1).astype(np.int32), model))
    return found


def _groups(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the stable order that sorts keys, each key once, and where in that order its last is passed."""
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    last = np.flatnonzero(np.diff(ordered, append=-1))
    return order, ordered[last], last + 1
