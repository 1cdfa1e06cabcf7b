"""Decode payloads of `klt`, version 2 and 3, by docs/bitstream.md, in Python's integers and float64."""

import struct
from collections import namedtuple
from fractions import Fraction

import numpy as np

from tests.reference.basis import real_harmonics
from tests.reference.entropy import (
    BATCHES,
    RangeDecoder,
    Tables,
    class_of,
    dequantise,
    floor_of,
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
from tests.reference.wavelet_decoder import Learnt, decode_indices

Decoded = namedtuple("Decoded", "mean axes indices coeffs")


def decode_by_shells(decoder, count, channels, components):
    """Decode vectors of which the first comes shell by shell."""
    tables = Tables(lambda i: geometric(min(Fraction(9, 160) * floor_of(i), Fraction(10**6)) if i else Fraction(1, 30)))
    signs = sign_tables()
    vectors = np.zeros((count, channels, components), np.int64)

    def take(activity):
        entries = take_magnitudes(decoder, tables, [class_of(min(int(a), 2**20)) for a in activity.ravel()])
        require(max(entries) <= 2**24, "entry")
        others = [i for i, entry in enumerate(entries) if entry]
        for i, negative in zip(others, take_symbols(decoder, signs, [0] * len(others)), strict=True):
            entries[i] *= -1 if negative else 1
        return np.reshape(entries, activity.shape)

    before = np.zeros((channels, components), np.int64)
    for row in range(count):
        if row == 0:
            known = [64 * 16] * channels
            for first in (s * s for s in range(components) if s * s < components):
                shell = range(first, min(first + 2 * round(first**0.5) + 1, components))
                found = take(np.array([[k] * len(shell) for k in known]))
                vectors[0][:, shell.start : shell.stop] = found
                known = [16 * int(abs(each).sum()) // len(shell) for each in found]
            before = 16 * np.abs(vectors[0])
            continue
        bordered = np.pad(before, ((0, 0), (1, 1)))
        vectors[row] = take((2 * before + bordered[:, :-2] + bordered[:, 2:]) // 4)
        before = (before + 16 * np.abs(vectors[row])) // 2
    return vectors


def decode_vectors(decoder, count, channels, components):
    tables = Tables(lambda i: geometric(min(Fraction(9, 20) * floor_of(i), Fraction(10**6)) if i else Fraction(3, 20)))
    signs = sign_tables()
    before = np.full((channels, components), 4, np.int64)
    vectors = np.zeros((count, channels, components), np.int64)
    for row in range(count):
        bordered = np.pad(before, ((0, 0), (1, 1)))
        activity = 2 * before + bordered[:, :-2] + bordered[:, 2:]
        contexts = [class_of(min(int(a), 2**20)) for a in activity.ravel()]
        entries = take_magnitudes(decoder, tables, contexts)
        require(max(entries) <= 2**24, "entry")
        others = [i for i, entry in enumerate(entries) if entry]
        for i, negative in zip(others, take_symbols(decoder, signs, [0] * len(others)), strict=True):
            entries[i] *= -1 if negative else 1
        vectors[row] = np.reshape(entries, before.shape)
        before = (before + 3 * np.abs(vectors[row])) >> 2
    return vectors


class PlaneTables:
    def __init__(self):
        per_cent = (80, 80, 50, 80, 35, 65)
        self.loud = Tables(lambda context: geometric(mean_of(context % 64, 144, per_cent[context // 64], 2)))
        self.counts = Tables(lambda context: geometric(Fraction(2)))
        self.gaps = Tables(lambda context: geometric(Fraction(2 ** min(context, 30))))
        self.quiet = Tables(lambda context: geometric(Fraction(1, 10)))


class BandOfPlanes:
    """One subband of all planes, as far as it is decoded."""

    def __init__(self, band, bands, shape):
        self.band, self.low = band, band.name == "LL"
        self.relatives = relatives_of(band, bands)
        self.before = np.zeros((band.height, band.width), np.int64)
        self.values = np.zeros((shape[0], band.height, band.width), np.int64)

    def activity(self, sizes, first, plane, coset, y, x):
        band = self.band
        weight = len(self.relatives) + (6 if first else 0)
        hinted = 4 * sum(size_of(r, halved, sizes[plane], y, x) for r, halved in self.relatives)
        if first:
            hinted += 6 * (int(self.before[y, x]) >> 2)
        if weight == 0:
            hinted = 32
        if coset == 0:
            return hinted * 36 // max(weight, 1)
        around = band.neighbours(coset, y, x)
        known = sum(int(band.view(sizes)[(plane, *place)]) for place in around)
        return hinted * 12 // max(weight, 1) + known * (96 // max(len(around), 1))

    def site(self, first, coset):
        return 2 * (0 if self.low else 1 if first == 0 else 2) + (coset > 0)

    def keep(self, sizes, planes, coset, residuals):
        """Note the residuals {(plane, y, x): residual} of a group's coset."""
        found = np.zeros_like(self.values)
        for place, residual in residuals.items():
            found[place] = residual
            self.band.view(sizes)[place] = min(abs(residual), 4095)
            if not self.low:
                self.values[place] = residual
        for plane in planes if self.low else []:
            restore_low(self.band, (coset,), found[plane], self.values[plane])
        require(np.abs(self.values).max(initial=0) <= 2**30, "value")
        for y, x in self.band.samples(coset):
            total = sum(int(self.band.view(sizes)[plane, y, x]) for plane in planes)
            mean = 16 * total // len(planes)
            self.before[y, x] = int(self.before[y, x]) + mean >> 1 if planes[0] else mean


def decode_planes(decoder, shape, levels):
    """Return the indices (plane, row, column)."""
    bands = list_bands(*shape[1:], levels)
    sizes = np.zeros(shape, np.int64)
    coded = [BandOfPlanes(band, bands, shape) for band in bands]
    steps = [(state, cosets) for state in coded for cosets in BATCHES]
    groups = []
    while not groups or groups[-1].stop < shape[0]:
        first = groups[-1].stop if groups else 0
        groups.append(range(first, min(first + 1 + first // 3, shape[0])))
    tables = PlaneTables()
    for stage in range(len(steps) + len(groups) - 1):
        cells = []
        for g, planes in enumerate(groups):
            if 0 <= stage - g < len(steps):
                state, cosets = steps[stage - g]
                for coset in cosets:
                    places = [(plane, y, x) for plane in planes for y, x in state.band.samples(coset)]
                    cells.append((state, planes, coset, places))
        samples = [
            (state.activity(sizes, planes[0], plane, coset, y, x), state.site(planes[0], coset))
            for state, planes, coset, places in cells
            for plane, y, x in places
        ]
        if not samples:
            continue
        residuals = iter(decode_batch(decoder, tables, samples))
        for state, planes, coset, places in cells:
            state.keep(sizes, planes, coset, {place: next(residuals) for place in places})
    indices = np.zeros(shape, np.int64)
    for state in coded:
        state.band.view(indices)[...] = state.values
    return indices


def decode_batch(decoder, tables, samples):
    loud = [i for i, (activity, _) in enumerate(samples) if activity]
    quiet = [i for i, (activity, _) in enumerate(samples) if not activity]
    contexts = [samples[i][1] * 64 + class_of(samples[i][0]) for i in loud]
    values = dict(zip(loud, take_magnitudes(decoder, tables.loud, contexts), strict=True))
    (found,) = take_magnitudes(decoder, tables.counts, [len(quiet).bit_length()])
    require(found <= len(quiet), "count")
    if found:
        gaps = take_magnitudes(decoder, tables.gaps, [(len(quiet) // found).bit_length() - 1] * found)
        rank, places = -1, []
        for gap in gaps:
            rank += gap + 1
            require(rank < len(quiet), "place")
            places.append(quiet[rank])
        for i, less in zip(places, take_magnitudes(decoder, tables.quiet, [0] * found), strict=True):
            values[i] = less + 1
    require(max(values.values(), default=0) <= 2**30, "magnitude")
    for i in [i for i in values if values[i]]:  # the loud ones were put in first
        values[i] *= -1 if decoder.take_bits(1) else 1
    return [values.get(i, 0) for i in range(len(samples))]


def hemisphere_axes(degree, axes):
    """Return forward (component, k) and inverse (k, component) of the metric of the hemisphere."""
    size = (degree + 1) ** 2
    forward, inverse = np.zeros((size, size)), np.zeros((size, size))
    node, weight = np.polynomial.legendre.leggauss(degree + 2)
    z = (node + 1) / 2
    basis = real_harmonics(np.stack([np.sqrt(1 - z * z), 0 * z, z], axis=1), degree)
    basis *= np.sqrt(np.pi * weight / 2)[:, None]
    for m in range(degree + 1):
        l = np.arange(m, degree + 1)
        _, s, v = np.linalg.svd(basis[:, l * (l + 1) + m] * (np.sqrt(2) if m == 0 else 1))
        kept = s > 1e-7
        rows, columns = s[kept, None] * v[: len(s)][kept], v[: len(s)][kept].T / s[kept]
        if axes != "singular":
            of = {"smooth": columns.T @ np.diag((l * (l + 1.0)) ** 2) @ columns}
            of["damped"] = -rows @ np.diag(1 / (1 + l * (l + 1.0))) @ rows.T
            turn = np.linalg.eigh(of[axes])[1]
            rows, columns = turn.T @ rows, columns @ turn
        for j, row in enumerate(rows):
            large = np.abs(row) > 0.7 * np.abs(row).max()
            sign = np.sign(row[np.argmax(large)])
            for order in {m, -m}:
                place = (m + j) * (m + j + 1) + order
                forward[place, l * (l + 1) + order] = sign * row
                inverse[l * (l + 1) + order, place] = sign * columns[:, j]
    there = np.abs(forward).max(axis=1) > 0
    return forward[there], inverse[:, there]


def radiance_of(values, degree):
    """Return coefficients (k, ...) of radiance from those of sRGB code values."""
    node, weight = np.polynomial.legendre.leggauss(degree + 1)
    z = np.repeat((node + 1) / 2, 2 * degree + 1)
    azimuth = np.tile(2 * np.pi * np.arange(2 * degree + 1) / (2 * degree + 1), degree + 1)
    w = np.repeat(weight / 2, 2 * degree + 1) * 2 * np.pi / (2 * degree + 1)
    radius = np.sqrt(1 - z * z)
    y = real_harmonics(np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1), degree)
    shown = np.tensordot(y, values, 1)
    size = np.abs(shown)
    curved = np.sign(shown) * np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    forward, inverse = hemisphere_axes(degree, "singular")
    s = np.linalg.norm(forward, axis=1)
    inverse = inverse[:, s > 1e-3 * s.max()]
    return np.tensordot(inverse @ inverse.T @ (y * w[:, None]).T, curved, 1)


def decode_klt(body, shape):
    """Return the mean, axes and indices as coded, and the coefficients (k, row, column, channel)."""
    k, height, width, channels = shape
    degree = round(k**0.5) - 1
    body = without_minimum_padding(body, shape)
    require(len(body) >= 12 + channels**2, "length")
    version, levels, exponent, step, n, *biases = struct.unpack_from("<BBhfHbb", body)
    require(version in (2, 3) and 1 <= levels <= 5 and abs(exponent) <= 150, "head")
    require(2.0**-22 <= step <= 8 and degree <= 40, "head")
    at = 12 if version == 2 else 13
    transfer = 0 if version == 2 else body[12]
    require(transfer in (0, 1), "transfer")
    rotation = np.frombuffer(body, "i1", channels**2, at).reshape(channels, channels) / 127
    at += channels**2
    require(len(body) >= at + n, "length")
    scales = np.frombuffer(body, "u1", n, at)
    decoder = RangeDecoder(body[at + n :])
    _, inverse = hemisphere_axes(degree, "smooth")
    components = inverse.shape[1]
    require(n <= channels * components, "planes")
    mean = decode_vectors(decoder, 1, channels, components)[0]
    axes = decode_vectors(decoder, n, channels, components)
    indices = np.zeros((n, height, width), np.int64)
    if n and version == 3:
        indices = decode_planes(decoder, indices.shape, levels)
    elif n:
        indices = decode_indices(decoder, Learnt(), indices.shape, levels, pairs=True)
    decoder.finish()
    z = np.broadcast_to(mean[..., None, None] * (step / 16), (channels, components, height, width)).copy()
    for index, axis, scale in zip(indices, axes, scales, strict=True):
        plane = join_plane(dequantise(index, step, biases), levels)
        z += np.multiply.outer(axis * 2.0 ** (-int(scale) / 4), plane)
    unturned = np.tensordot(np.linalg.pinv(rotation), z, 1)
    coeffs = np.ldexp(np.einsum("kj,cjhw->khwc", inverse, unturned), exponent)
    return Decoded(mean, axes, indices, radiance_of(coeffs, degree) if transfer else coeffs)
