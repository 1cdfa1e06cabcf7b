"""The entropy coder of docs/bitstream.md in Python's integers, symbol by symbol, and the subbands that it runs over."""

from bisect import bisect_right
from fractions import Fraction
from functools import cache

import numpy as np

from tests.reference.payload import require

WORD, ALL = 1 << 32, (1 << 64) - 1
RAW = [0] * 16 + [2 + i // 4 for i in range(108)]
FIRST = [*range(16), *((4 + i % 4) << (2 + i // 4) for i in range(108))]
BATCHES = ((0,), (1,), (2, 3))
STARTS = ((0, 0), (1, 1), (0, 1), (1, 0))


class RangeDecoder:
    def __init__(self, data):
        require(len(data) % 4 == 0, "whole words")
        self.words = [int.from_bytes(data[i : i + 4], "little") for i in range(0, len(data), 4)]
        self.used = 0
        self.lower, self.range = 0, ALL
        self.point = self.next_word() * WORD
        self.point += self.next_word()

    def next_word(self):
        word = self.words[self.used] if self.used < len(self.words) else 0
        self.used += 1
        return word

    def take(self, left):
        scale = self.range >> 24
        place = (self.point - self.lower & ALL) // scale
        require(place < 1 << 24, "place")
        symbol = bisect_right(left, place) - 1
        self.lower = self.lower + scale * left[symbol] & ALL
        self.range = scale * (left[symbol + 1] - left[symbol])
        if self.range < WORD:
            self.lower, self.range = self.lower << 32 & ALL, self.range << 32
            self.point = (self.point << 32 & ALL) | self.next_word()
        return symbol

    def take_bits(self, bits):
        return self.take(EvenBounds(bits))

    def finish(self):
        require(self.used >= len(self.words), "words left")
        require(self.range == ALL or (self.point - self.lower & ALL) < 2**33 - 1, "symbols left")


class RangeEncoder:
    def __init__(self):
        self.lower, self.range, self.words = 0, ALL, []

    def put(self, left, symbol):
        scale = self.range >> 24
        self.lower += scale * left[symbol]
        self.range = scale * (left[symbol + 1] - left[symbol])
        if self.lower > ALL:
            self.lower -= ALL + 1
            self.words = self.carried()
        if self.range < WORD:
            self.words.append(self.lower >> 32)
            self.lower, self.range = self.lower << 32 & ALL, self.range << 32

    def carried(self):
        """Return the words, as one number, and 1."""
        words, i = list(self.words), len(self.words) - 1
        while words[i] == WORD - 1:
            words[i] = 0
            i -= 1
        words[i] += 1
        return words

    def to_bytes(self):
        if self.range == ALL:
            return b""
        point = self.lower + WORD - 1
        words = self.carried() if point > ALL else list(self.words)
        words.append((point & ALL) >> 32)
        if (self.lower + self.range & ALL) >> 32 == words[-1]:
            words.append(0)
        return b"".join(word.to_bytes(4, "little") for word in words)


class EvenBounds:
    """Bounds of integers of some bits, which are too many to be listed."""

    def __init__(self, bits):
        self.bits = bits

    def __len__(self):
        return (1 << self.bits) + 1

    def __getitem__(self, value):
        return value << (24 - self.bits)


def half_even(numerator, denominator):
    quotient, rest = divmod(numerator, denominator)
    return quotient + (2 * rest > denominator or (2 * rest == denominator and quotient % 2))


def bounds(counts):
    free, total = (1 << 24) - len(counts), sum(counts)
    e = 0
    while free << e < total << 52:
        e += 1
    scale = half_even(free << e, total)
    left, before = [], 0
    for s, count in enumerate(counts):
        product = scale * before
        more = max(product.bit_length() - 53, 0)
        left.append((half_even(product, 1 << more) << more >> e) + s)
        before += count
    return [*left, 1 << 24]


@cache
def geometric(mean):
    power = [(mean.numerator << 64) // (mean.numerator + mean.denominator)]
    while len(power) < 29:
        power.append(power[-1] ** 2 >> 64)
    tails = [1 << 64]
    for symbol in range(123):
        tails.append(tails[-1] * power[RAW[symbol]] >> 64)
    tails.append(0)
    return [(2**14 * (tails[s] - tails[s + 1]) >> 64) + 1 for s in range(124)]


def class_of(activity):
    if activity < 2:
        return activity
    return 2 * (activity.bit_length() - 1) + (activity >> activity.bit_length() - 2 & 1)


def floor_of(i):
    return i if i < 2 else (2 + i % 2) << (i // 2) >> 1


def mean_of(i, unit, percent, rest):
    if i == 0:
        return Fraction(rest, 100)
    i = min(i, 61)
    return Fraction(percent, 100) * Fraction(floor_of(i) + floor_of(i + 1), 2 * unit)


class Tables:
    """Counts by context, each made from its prior when it is first used."""

    def __init__(self, prior):
        self.prior, self.counts = prior, {}

    def __getitem__(self, context):
        if context not in self.counts:
            self.counts[context] = list(self.prior(context))
        return self.counts[context]

    def learn(self, context, symbols):
        counts = self[context]
        for symbol in symbols:
            counts[symbol] += 1024
        while sum(counts) > 1 << 23:
            counts[:] = [(count + 1) >> 1 for count in counts]


def sign_tables():
    return Tables(lambda context: [8193, 8193])


def take_symbols(decoder, tables, contexts):
    """Take one symbol in each context, as one batch."""
    symbols = [0] * len(contexts)
    places = {}
    for i, context in enumerate(contexts):
        places.setdefault(context, []).append(i)
    for context in sorted(places):
        left = bounds(tables[context])
        for i in places[context]:
            symbols[i] = decoder.take(left)
        tables.learn(context, [symbols[i] for i in places[context]])
    return symbols


def take_magnitudes(decoder, tables, contexts):
    symbols = take_symbols(decoder, tables, contexts)
    values = [FIRST[s] for s in symbols]
    for width in sorted({RAW[s] for s in symbols} - {0}):
        ours = [i for i, s in enumerate(symbols) if RAW[s] == width]
        for shift in range(0, width, 23):
            for i in ours:
                values[i] += decoder.take_bits(min(23, width - shift)) << shift
    return values


class Band:
    def __init__(self, name, level, top, left, height, width):
        self.name, self.level, self.top, self.left, self.height, self.width = name, level, top, left, height, width

    def view(self, planes):
        return planes[..., self.top : self.top + self.height, self.left : self.left + self.width]

    def samples(self, coset):
        row, column = STARTS[coset]
        return [(y, x) for y in range(row, self.height, 2) for x in range(column, self.width, 2)]

    def neighbours(self, coset, y, x):
        near = [(-1, -1), (-1, 1), (1, -1), (1, 1)] if coset == 1 else [(0, -1), (0, 1), (-1, 0), (1, 0)]
        return [(y + v, x + u) for v, u in near if 0 <= y + v < self.height and 0 <= x + u < self.width]


def list_bands(height, width, levels):
    bands = []
    for level in range(1, levels + 1):
        h, w = -(-height // 2), -(-width // 2)
        bands[:0] = [
            Band("HL", level, 0, w, h, width - w),
            Band("LH", level, h, 0, height - h, w),
            Band("HH", level, h, w, height - h, width - w),
        ]
        height, width = h, w
    return [band for band in [Band("LL", levels, 0, 0, height, width), *bands] if band.height and band.width]


def relatives_of(band, bands):
    """Return (relative, how often its rows and columns are halved)."""
    earlier = {"LL": "", "HL": "", "LH": "HL", "HH": "HL LH"}[band.name].split()
    parents = [(other, 1) for other in bands if (other.name, other.level) == (band.name, band.level + 1)]
    return parents + [(other, 0) for other in bands if other.name in earlier and other.level == band.level]


def size_of(relative, halved, sizes, y, x):
    """Return a relative's size (of one plane) at a sample."""
    y, x = y >> halved, x >> halved
    inside = y < relative.height and x < relative.width
    return int(sizes[relative.top + y, relative.left + x]) if inside else 0


def restore_low(band, cosets, residuals, values):
    """Turn the residuals of a batch of one plane's LL, by (y, x), into values."""
    for coset in cosets:
        for y, x in band.samples(coset):
            if coset == 0:
                before = values[y, x - 2] if x else values[y - 2, x] if y else 0
            else:
                near = band.neighbours(coset, y, x)
                before = sum(int(values[place]) for place in near) // max(len(near), 1)
            values[y, x] = before + residuals[y, x]


def dequantise(index, step, biases):
    size = np.abs(index).astype(np.float64)
    bias = np.where(size == 1, biases[0], biases[1]) / 256.0
    return np.where(index == 0, 0.0, np.sign(index) * (size - bias) * step)


def join_line(line):
    """Undo one level along the first axis."""
    m = len(line)
    if m == 1:
        return line
    half = -(-m // 2)
    s, d = line[:half] / 1.149604398860241, line[half:] / 0.869864451624781
    for factor, odd in (
        (0.443506852043971, False),
        (0.882911075530934, True),
        (-0.052980118572961, False),
        (-1.586134342059924, True),
    ):
        if odd:
            after = [s[n + 1] if n + 1 < len(s) else s[n] for n in range(len(d))]
            d = np.stack([d[n] - factor * (s[n] + after[n]) for n in range(len(d))])
        else:
            beyond = [d[n] if n < len(d) else d[n - 1] for n in range(len(s))]
            s = np.stack([s[n] - factor * (d[max(n - 1, 0)] + beyond[n]) for n in range(len(s))])
    whole = np.empty_like(line)
    whole[0::2], whole[1::2] = s, d
    return whole


def join_plane(plane, levels):
    plane = np.array(plane, np.float64)
    for level in range(levels - 1, -1, -1):
        h, w = -(-plane.shape[0] >> level), -(-plane.shape[1] >> level)
        part = join_line(plane[:h, :w])
        plane[:h, :w] = join_line(part.T.copy()).T
    return plane
