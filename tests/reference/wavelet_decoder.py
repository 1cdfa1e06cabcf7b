"""Decode payloads of `wavelet` by docs/bitstream.md, in Python's integers and float64."""

import numpy as np

from tests.reference.entropy import (
    BATCHES,
    RangeDecoder,
    Tables,
    class_of,
    dequantise,
    geometric,
    join_plane,
    list_bands,
    mean_of,
    relatives_of,
    restore_low,
    sign_tables,
    size_of,
    take_magnitudes,
    take_symbols,
)
from tests.reference.payload import require, without_minimum_padding

PER_CENT = ((80, 80, 80), (80, 80, 80), (50, 50, 50), (80, 80, 80), (30, 45, 55), (55, 75, 85))
AT_REST = ((200, 200, 200), (20, 50, 100), (5, 5, 5), (2, 2, 2), (2, 20, 40), (2, 15, 30))
FLOAT32_MAX = float(np.finfo(np.float32).max)


def prior_of(context):
    site, predicted, number = context // 192, context // 64 % 3, context % 64
    return geometric(mean_of(number, 16, PER_CENT[site][predicted], AT_REST[site][predicted]))


class Learnt:
    """What goes on from map to map."""

    def __init__(self):
        self.magnitudes, self.signs, self.sums = Tables(prior_of), sign_tables(), {}

    def slope(self, channel, low):
        xy, xx = self.sums.get((channel, low)) or self.sums.get((channel, not low)) or (0, 0)
        return min(max(xy / xx, -4.0), 4.0) if xx else 0.0

    def learn(self, channel, low, before, here):
        x, y = [[int(v) for v in values.ravel()] for values in (before, here)]
        shift = max(0, max(abs(v) for v in x + y).bit_length() - 20)
        x, y = [v >> shift for v in x], [v >> shift for v in y]
        xy, xx = self.sums.get((channel, low), (0, 0))
        product = sum(a * b for a, b in zip(x, y, strict=True)) << 2 * shift
        self.sums[channel, low] = xy // 2 + product, xx // 2 + (sum(a * a for a in x) << 2 * shift)


def decode_indices(decoder, learnt, shape, levels, pairs=False):
    """Return the indices (channel, height, width) of one map; `pairs` is how version 2 of `klt` codes planes."""
    indices, sizes = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    bands = list_bands(*shape[1:], levels)
    together = 2 if pairs else 1
    for band in bands:
        for first in range(0, shape[0], together):
            channels = range(first, min(first + together, shape[0]))
            decode_band(decoder, learnt, bands, band, channels, indices, sizes, pairs)
    return indices


def decode_band(decoder, learnt, bands, band, channels, indices, sizes, pairs):
    low, first, step = band.name == "LL", channels[0], 2 if pairs else 1
    relatives = relatives_of(band, bands)
    predicted = np.zeros((len(channels), band.height, band.width), np.int64)
    if first and not pairs:
        slope = learnt.slope(first, low)
        for place in np.ndindex(band.height, band.width):
            expected = round(int(band.view(indices)[(first - 1, *place)]) * slope)
            predicted[(0, *place)] = min(max(expected, -(2**29)), 2**29)
    values = np.zeros(predicted.shape, np.int64)
    for cosets in BATCHES:
        places, contexts, near = [], [], []
        for coset in cosets:
            for i, channel in enumerate(channels):
                for y, x in band.samples(coset):
                    hints = [size_of(r, halved, sizes[channel], y, x) for r, halved in relatives]
                    if channel >= step:
                        hints.append(int(band.view(sizes)[channel - step, y, x]))
                    hinted = 4 * sum(hints) // len(hints) if hints else 0
                    activity = 4 * hinted
                    if coset:
                        around = band.neighbours(coset, y, x)
                        known = sum(int(band.view(sizes)[(channel, *place)]) for place in around)
                        activity = 3 * (4 * known // max(len(around), 1)) + hinted
                    expected = int(predicted[i, y, x])
                    site = 2 * (0 if low else 1 if first == 0 else 2) + (coset > 0)
                    contexts.append((site * 3 + min(abs(expected), 2)) * 64 + class_of(activity))
                    near.append(min(max(expected, -2), 2) + 2)
                    places.append((i, y, x))
        residuals = take_magnitudes(decoder, learnt.magnitudes, contexts)
        others = [n for n, residual in enumerate(residuals) if residual]
        signs = take_symbols(decoder, learnt.signs, [near[n] for n in others])
        for n, negative in zip(others, signs, strict=True):
            residuals[n] *= -1 if negative else 1
        found = np.zeros(predicted.shape, np.int64)
        for (i, y, x), residual in zip(places, residuals, strict=True):
            found[i, y, x] = residual
            band.view(sizes)[channels[i], y, x] = min(abs(residual), 2**22)
            values[i, y, x] = residual
        for i in range(len(channels) if low else 0):
            restore_low(band, cosets, found[i], values[i])
        require(np.abs(values).max() <= 2**30, "difference")
    for i, channel in enumerate(channels):
        band.view(indices)[channel] = predicted[i] + values[i]
        if channel and not pairs:
            learnt.learn(channel, low, band.view(indices)[channel - 1], band.view(indices)[channel])


def decode_wavelet(body, shape):
    """Return the indices (k, channel, row, column) and the coefficients (k, row, column, channel)."""
    n, height, width, channels = shape
    body = without_minimum_padding(body, shape)
    require(len(body) >= 3 + 3 * n and 1 <= body[0] <= 5, "tables")
    levels, biases = body[0], np.frombuffer(body, "i1", 2, 1)
    exponents, codes = np.frombuffer(body, "i1", n, 3), np.frombuffer(body, "<u2", n, 3 + n)
    require(exponents.min() >= -126, "exponents")
    decoder, shared = RangeDecoder(body[3 + 3 * n :]), Learnt()
    indices, coeffs = np.zeros((n, channels, height, width), np.int64), np.zeros(shape)
    order = [k for k in range(n) if codes[k] == 0] + [k for k in range(n) if 0 < codes[k] < 65535]
    for k in order:
        learnt = Learnt() if codes[k] == 0 else shared
        indices[k] = decode_indices(decoder, learnt, (channels, height, width), levels)
        step = np.float32(2.0 ** (codes[k] / 2048 - 22))
        for c in range(channels):
            plane = join_plane(dequantise(indices[k, c], float(step), biases), levels)
            coeffs[k, :, :, c] = np.clip(np.ldexp(plane, int(exponents[k])), -FLOAT32_MAX, FLOAT32_MAX)
    decoder.finish()
    return indices, coeffs
