"""Decode payloads of `klt`, version 4, by docs/bitstream.md, in Python's integers and float64."""

import binascii
import struct
from pathlib import Path

import numpy as np

from tests.reference.bases import FUNCTIONS, cell_centres, gram, hemisphere_quadrature
from tests.reference.entropy import RangeDecoder, class_of, join_plane, list_bands
from tests.reference.klt import Decoded, decode_by_shells, decode_vectors, hemisphere_axes, radiance_of
from tests.reference.payload import require, without_minimum_padding

BASES = ("sh", "hsh", "gram-schmidt", "zernike", "makhotkin", "haar")
START = Path(__file__).resolve().parents[2] / "clrelight" / "codec" / "entropy" / "units.tables"
CONTEXTS, SYMBOLS, FLAGS, ONE = 592, 16, 144, 1 << 14
NAMES = ("HL", "LH", "HH")
BATCH_OF = ((0, 2), (2, 1))
"""The batch of a sample, by its row and column modulo 2."""
NEIGHBOURS = {1: ((-1, -1), (-1, 1), (1, -1), (1, 1)), 2: ((-1, 0), (1, 0), (0, -1), (0, 1))}
SIDES = {0: 16, 5: 16, 4: 32, 3: 64, 2: 64, 1: 64}


class Stream:
    """Words from the front by four states, raw bits from the back."""

    def __init__(self, data):
        require(len(data) >= 16, "states")
        self.data, self.at, self.end = data, 16, len(data)
        self.states = [int.from_bytes(data[i : i + 4], "little") for i in range(0, 16, 4)]
        self.bits = self.held = 0

    def slot(self, lane):
        return self.states[lane] % ONE

    def take(self, lane, begin, size):
        """Take what was found in the slot of a state."""
        state = size * (self.states[lane] // ONE) + self.slot(lane) - begin
        if state < 1 << 16:
            require(self.at + 2 <= self.end, "words")
            state = state << 16 | int.from_bytes(self.data[self.at : self.at + 2], "little")
            self.at += 2
        self.states[lane] = state

    def take_bits(self, count):
        while self.held < count:
            require(self.end > self.at, "bits")
            self.end -= 1
            self.bits |= self.data[self.end] << self.held
            self.held += 8
        value = self.bits % (1 << count)
        self.bits, self.held = self.bits >> count, self.held - count
        return value

    def take_large(self, order):
        octave = order
        while not self.take_bits(1):
            octave += 1
            require(octave < 28, "octave")
        return (1 << octave | self.take_bits(octave)) - (1 << order)

    def take_magnitude(self, symbol, shift, order):
        """Return a magnitude of which the symbol was read."""
        if symbol == SYMBOLS - 1:
            symbol += self.take_large(order)
        require(symbol << shift <= 1 << 28, "magnitude")
        return symbol << shift | self.take_bits(shift)

    def finish(self):
        require(self.at == self.end and self.bits == 0, "bytes left")
        require(self.states == [1 << 16] * 4, "states left")


class UnitTables:
    """What a stream learns."""

    def __init__(self):
        content = START.read_bytes()
        self.counts = [list(content[i : i + SYMBOLS]) for i in range(0, CONTEXTS * SYMBOLS, SYMBOLS)]
        self.zero, self.seen = np.frombuffer(content, "<u2", 2 * FLAGS, CONTEXTS * SYMBOLS).reshape(FLAGS, 2).T.tolist()
        self.left, self.patience = {}, {}  # of contexts that came

    def share(self, context):
        counts = self.counts[context]
        if sum(counts) > 6144:
            counts[:] = [(count + 1) // 2 for count in counts]
        total, before = sum(counts), 0
        self.left[context] = []
        for s, count in enumerate(counts):
            self.left[context].append((before * (((ONE - SYMBOLS) << 16) // total) >> 16) + s)
            before += count
        self.left[context].append(ONE)
        self.patience[context] = max(12, total // 4)

    def take_symbols(self, stream, contexts, lanes):
        """Take a batch of symbols, and learn from them."""
        symbols = []
        for context, lane in zip(contexts, lanes, strict=True):
            symbols.append(self.take_symbol(stream, context, lane))
        self.learn(contexts)
        return symbols

    def take_symbol(self, stream, context, lane):
        if context not in self.left:
            self.share(context)
        left, slot = self.left[context], stream.slot(lane)
        symbol = max(s for s in range(SYMBOLS) if left[s] <= slot)
        stream.take(lane, left[symbol], left[symbol + 1] - left[symbol])
        self.counts[context][symbol] += 1
        self.patience[context] -= 1
        return symbol

    def learn(self, contexts):
        for context in set(contexts):
            if self.patience[context] <= 0:
                self.share(context)

    def take_flag(self, stream, flag):
        zero = self.zero[flag]
        value = stream.slot(0) >= zero
        stream.take(0, *((zero, ONE - zero) if value else (0, zero)))
        moved = -(zero // (self.seen[flag] + 2)) if value else (ONE - zero) // (self.seen[flag] + 2)
        self.zero[flag] = min(max(zero + moved, 24), ONE - 24)
        self.seen[flag] = min(self.seen[flag] + 1, 62)
        return int(value)


def decode_low(stream, tables, values):
    """Decode LL of a unit: values (plane, row, column)."""
    _, height, width = values.shape
    before = np.zeros((height, width), int)
    for plane, value in enumerate(values):
        size = np.zeros((height + 1, width + 2), int)
        for y in range(height):
            contexts = []
            for x in range(width):
                known = 2 * int(size[y + 1, x] + size[y, x + 1]) + int(size[y, x] + size[y, x + 2])
                known += 2 * int(before[y, x]) if plane else 0
                if plane == x == y == 0:
                    known = 64
                k = min((known + 1).bit_length() - 1, 24)
                contexts.append(576 + min(k, 15))
                residual = stream.take_magnitude(tables.take_symbol(stream, contexts[-1], 0), max(k - 4, 0), 0)
                size[y + 1, x + 1] = residual
                if residual and stream.take_bits(1):
                    residual = -residual
                value[y, x] = expected_low(value, y, x) + residual
                require(abs(value[y, x]) <= 1 << 28, "value")
            tables.learn(contexts)
        before = (before + size[1:, 1:-1]) // 2


def expected_low(value, y, x):
    if x == 0 or y == 0:
        return int(value[y, x - 1] if x else value[y - 1, x] if y else 0)
    left, up, corner = int(value[y, x - 1]), int(value[y - 1, x]), int(value[y - 1, x - 1])
    return sorted([left, up, left + up - corner])[1]


def decode_details(stream, tables, indices, bands, unit, coarse=None):
    """Decode HL, LH and HH of a unit into the indices (plane, row, column), where coarser units stand already.

    Of each plane, `coarse` bits are not looked at by contexts.
    """
    level, row, column = unit
    side = SIDES[level]
    before = np.zeros((3, side, side), int)
    for plane, index in enumerate(indices):
        low = 0 if coarse is None else int(coarse[plane])
        sizes = np.zeros((3, side + 2, side + 2), int)  # with a border
        for b, name in enumerate(NAMES):
            band = bands.get((name, level))
            if band is None or band.height <= row or band.width <= column:
                continue
            part = band.view(index)[row : row + side, column : column + side]
            rows, columns = part.shape
            siblings = sizes[:b, 1 : rows + 1, 1 : columns + 1].sum(axis=0)
            parent = parent_sizes(index, bands.get((name, level + 1)), row // 2, column // 2, part.shape, low)
            known = 16 * (siblings + (0 if parent is None else parent))
            weight = b + (parent is not None)
            if plane:
                known, weight = known + 6 * before[b, :rows, :columns], weight + 6
            hint = np.full(part.shape, 16)
            if weight:
                hint = known if weight == 1 else known * (65536 // weight + 1) >> 16
            decode_band(stream, tables, plane, hint, part, sizes[b], low)
            scaled = 16 * sizes[b, 1 : rows + 1, 1 : columns + 1]
            old = before[b, :rows, :columns] if plane else 0
            before[b, :rows, :columns] = old + ((scaled - old) >> (plane > 0) + (plane > 2) + (plane > 10))


def parent_sizes(index, band, row, column, shape, coarse):
    """Return the sizes of the parent's samples, or None where it has none at the first sample's place."""
    if band is None or band.height <= row or band.width <= column:
        return None
    sizes = np.minimum(np.abs(band.view(index)[row : row + 32, column : column + 32]) >> coarse, 255)
    sizes = sizes.repeat(2, axis=0).repeat(2, axis=1)
    sizes = sizes[: shape[0], : shape[1]]
    return np.pad(sizes, [(0, shape[0] - sizes.shape[0]), (0, shape[1] - sizes.shape[1])])


def decode_band(stream, tables, plane, hint, part, size, coarse):
    """Decode one subband of one plane; `size` gets the sizes, and around them their mirror images."""
    rows, columns = hint.shape
    if not tables.take_flag(stream, 112 + (16 if plane else 0) + min(class_of(int(hint.sum()) >> 4), 15)):
        return
    flags, cells = np.zeros((10, 10), int), []
    for i, top in enumerate(range(0, rows, 8)):
        for j, left in enumerate(range(0, columns, 8)):
            around = 2 * (flags[i + 1, j] + flags[i, j + 1]) + flags[i, j] + flags[i, j + 2]
            hinted = min(int(hint[top : top + 8, left : left + 8].sum()), 65535)
            flags[i + 1, j + 1] = tables.take_flag(stream, int(16 * around + min(class_of(hinted >> 2), 15)))
            if flags[i + 1, j + 1]:
                cells.append((range(top, min(top + 8, rows)), range(left, min(left + 8, columns))))
    for batch in range(3):
        if batch:
            mirror(size, rows, columns)
        places = [(y, x) for ys, xs in cells for y in ys for x in xs if BATCH_OF[y % 2][x % 2] == batch]
        contexts, shifts = [], []
        for y, x in places:
            near, expected = 11, int(hint[y, x]) >> 4
            if batch:
                around = sum(int(size[y + 1 + v, x + 1 + u]) for v, u in NEIGHBOURS[batch])
                near, expected = min(class_of(around), 10), max(expected, around >> 2)
            group = 0 if plane == 0 else 1 if plane < 8 else 2
            contexts.append(192 * group + 16 * near + min(class_of(int(hint[y, x])), 15))
            shifts.append(max(expected.bit_length() - 4, 0))
        whole = len(places) // 4 * 4
        lanes = [i % 4 if i < whole else 0 for i in range(len(places))]
        for (y, x), shift, symbol in zip(places, shifts, tables.take_symbols(stream, contexts, lanes), strict=True):
            magnitude = stream.take_magnitude(symbol, shift + coarse, 4 if shift == 4 else 0)
            if magnitude:
                part[y, x] = -magnitude if stream.take_bits(1) else magnitude
                size[y + 1, x + 1] = min(magnitude >> coarse, 255)


def mirror(size, rows, columns):
    if columns > 1:
        size[:, 0], size[:, columns + 1] = size[:, 2], size[:, columns - 1]
    if rows > 1:
        size[0], size[rows + 1] = size[2], size[rows - 1]


def list_units(height, width):
    """Return (level, row, column) of all units; level 0 is LL."""
    return [
        (level, row, column)
        for level in (0, 5, 4, 3, 2, 1)
        for row in range(0, -(-height >> (level or 5)), SIDES[level])
        for column in range(0, -(-width >> (level or 5)), SIDES[level])
    ]


def decode_units(streams, shape):
    """Return the indices (plane, row, column) of the streams of all units, or of the one of them all."""
    indices = np.zeros(shape, int)
    bands = {(band.name, band.level): band for band in list_bands(*shape[1:], 5)}
    units = list_units(*shape[1:])
    groups = [units] if len(streams) == 1 else [[unit] for unit in units]
    for data, group in zip(streams, groups, strict=True):
        stream, tables = Stream(data), UnitTables()
        for level, row, column in group:
            if level == 0:
                decode_low(stream, tables, bands["LL", 5].view(indices)[:, row : row + 16, column : column + 16])
            else:
                decode_details(stream, tables, indices, bands, (level, row, column))
        stream.finish()
    return indices


def read_streams(body, at, count):
    """Return the streams that the index at a place says."""
    sizes, sums = [], []
    for _ in range(count):
        size = shift = 0
        while True:
            require(at + 3 <= len(body) and shift <= 28, "index")
            size |= body[at] % 128 << shift
            at, shift = at + 1, shift + 7
            if body[at - 1] < 128:
                break
        sizes.append(size)
        sums.append(int.from_bytes(body[at : at + 2], "little"))
        at += 2
    require(len(body) >= at + 2 and body[at : at + 2] == crc(body[:at]), "front")
    at += 2
    require(len(body) == at + sum(sizes), "length")
    streams = []
    for size, expected in zip(sizes, sums, strict=True):
        streams.append(body[at : at + size])
        require(crc(streams[-1]) == expected.to_bytes(2, "little"), "stream")
        at += size
    return streams


def crc(data):
    return binascii.crc_hqx(data, 0).to_bytes(2, "little")


def decode_klt4(body, shape):
    """Return the mean, axes and indices as coded, and the coefficients (k, row, column, channel)."""
    k, height, width, channels = shape
    degree = round(k**0.5) - 1
    body = without_minimum_padding(body, shape)
    require(len(body) >= 15 and degree <= 40, "head")
    version, levels, exponent, step, n, transfer, size = struct.unpack_from("<BBhfHBI", body)
    basis, transfer = BASES[transfer >> 4] if transfer >> 4 < len(BASES) else "", transfer & 15
    decode, transfer = (decode_by_shells if transfer & 8 else decode_vectors), transfer & 7
    fineness, transfer = transfer >> 1, transfer & 1
    require((version, levels) == (4, 5) and abs(exponent) <= 150 and basis, "head")
    require(2.0**-22 <= step <= 8 and size >= channels**2 + n and len(body) >= 15 + size, "head")
    rotation = np.frombuffer(body, "i1", channels**2, 15).reshape(channels, channels) / 127
    scales = np.frombuffer(body, "u1", n, 15 + channels**2).astype(int)
    inverse = hemisphere_axes(degree, "damped")[1] if basis == "sh" else inverse_metric(basis, degree)
    components = inverse.shape[1]
    require(n <= channels * components, "planes")
    decoder = RangeDecoder(body[15 + channels**2 + n : 15 + size])
    mean = decode(decoder, 1, channels, components)[0]
    axes = decode(decoder, n, channels, components)
    decoder.finish()
    together = height * width <= 1 << 18
    count = 0 if n == 0 else 1 if together else len(list_units(height, width))
    streams = read_streams(body, 15 + size, count)
    indices = np.zeros((n, height, width), int)
    if n:
        indices = decode_units(streams, indices.shape)
    vectors = np.concatenate([axes / 2.0 ** (scales / 4)[:, None, None], mean[None] / (16 * 4**fineness)])
    unturned = np.einsum("cd,idj->icj", np.linalg.pinv(rotation), vectors)
    operator = np.einsum("kj,icj->kci", np.ldexp(inverse, exponent) * step, unturned)
    require(np.abs(operator).max() <= np.finfo(np.float32).max, "range")
    planes = np.array([*(join_plane(index, 5) for index in indices), np.ones((height, width))])
    coeffs = np.einsum("kci,ihw->khwc", operator, planes)
    if transfer:
        coeffs = radiance_of(coeffs, degree) if basis == "sh" else bent_back(coeffs, basis, degree)
    return Decoded(mean, axes, indices, coeffs)


def inverse_metric(basis, degree):
    """Return what makes coefficients of coordinates: the inverse of L', G = L L' the Gram matrix."""
    return np.linalg.inv(np.linalg.cholesky(gram(basis, degree)).T)


def bent_back(values, basis, degree):
    """Return coefficients of radiance from those of sRGB code values, by the basis' own nodes."""
    if basis == "haar":
        nodes, weights = cell_centres(degree + 1)
    else:
        nodes, weights = hemisphere_quadrature(degree)
    y = FUNCTIONS[basis](nodes, degree)
    shown = np.tensordot(y, values, 1)
    size = np.abs(shown)
    curved = np.sign(shown) * np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    inverse = inverse_metric(basis, degree)
    seen = np.linalg.norm(np.linalg.inv(inverse), axis=1)
    inverse = inverse[:, seen > 1e-3 * seen.max()]
    return np.tensordot(inverse @ inverse.T @ (y * weights[:, None]).T, curved, 1)
