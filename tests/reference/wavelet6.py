"""Decode payloads of `wavelet`, bodies 6 and 7, by docs/bitstream.md, in Python's integers and float64."""

import itertools
import struct

import numpy as np

from tests.reference.entropy import join_plane, list_bands
from tests.reference.klt4 import SIDES, Stream, UnitTables, decode_details, decode_low, list_units, read_streams
from tests.reference.payload import require, without_minimum_padding

FLOAT32_MAX = float(np.finfo(np.float32).max)


def decode_wavelet6(body, shape):
    """Return the indices (plane, row, column) as coded, and the coefficients (k, row, column, channel)."""
    n, height, width, channels = shape
    body = without_minimum_padding(body, shape)
    require(len(body) >= 5 + 2 * n, "tables")
    version, levels, flags, group = struct.unpack_from("<BBBH", body)
    together, coarse, rotated, each, fine = (flags >> bit & 1 for bit in range(5))
    require((version, levels) == (6, 5) and flags < 32 and group > 0, "head")
    require(not together or height * width <= 1 << 18, "together")
    require(channels <= 8 if rotated else not (each or fine), "rotation")
    codes = np.frombuffer(body, "<u2", n, 5).astype(int)
    present = np.flatnonzero(codes != 65535)
    at, n_angle = 5 + 2 * n, channels * (channels - 1) // 2
    n_rotation = (len(present) if each else min(len(present), 1)) if rotated else 0
    n_coarse = 5 * channels * len(present) if coarse else 0
    require(len(body) >= at + n_rotation * n_angle * (1 + fine) + n_coarse, "tables")
    angles = np.frombuffer(body, f"<u{1 + fine}", n_rotation * n_angle, at).reshape(n_rotation, n_angle)
    at += n_rotation * n_angle * (1 + fine)
    bits = np.zeros((len(present), channels, 6), int)
    if coarse:
        bits[:, :, 1:] = np.frombuffer(body, "u1", n_coarse, at).reshape(len(present), channels, 5)
    require(bits.max(initial=0) <= 12, "bits")
    at += n_coarse
    # Planes: group by group, in each the first components of its maps, then the second ones.
    order = [
        [(m, d) for d in range(channels) for m in range(first, min(first + group, len(present)))]
        for first in range(0, len(present), group)
    ]
    units = list_units(height, width)
    streams = read_streams(body, at, len(order) * (1 if together else len(units)))
    indices = decode_groups(streams, order, units, together, bits, (height, width))
    coeffs, planes = np.zeros(shape), dict(zip(itertools.chain(*order), indices, strict=True))
    for m, k in enumerate(present):
        components = np.array([join_plane(planes[m, d], 5) for d in range(channels)])
        if rotated:
            turn = rotation_of(angles[m if each else 0] * (2 * np.pi / 256 ** (1 + fine)), channels)
            components = np.tensordot(turn, components, (0, 0))
        scaled = components * 2.0 ** ((codes[k] - 36000) / 200)
        coeffs[k] = np.clip(scaled, -FLOAT32_MAX, FLOAT32_MAX).transpose(1, 2, 0)
    return indices, coeffs


def decode_wavelet7(body, shape):
    """Return the numbers as they are written, and the coefficients (k, row, column, channel)."""
    n, bits = shape[0], body[1]
    exponents, each = [e - 256 if e > 127 else e for e in body[2 : 2 + n]], int(np.prod(shape[1:]))
    require(body[0] == 7 and 2 <= bits <= 25 and -127 not in exponents and each <= 4096, "head")
    kept = [k for k in range(n) if exponents[k] != -128]
    content, count = body[2 + n :], len(kept) * each
    require(len(content) == (count * bits + 7) // 8, "length")
    spare = 8 * len(content) - count * bits
    large = int.from_bytes(content, "big")
    require(large & ((1 << spare) - 1) == 0, "bits behind the last number")
    numbers = [large >> spare + (count - 1 - i) * bits & ((1 << bits) - 1) for i in range(count)]
    require(all(number <= (1 << bits) - 2 for number in numbers), "number")
    coeffs = np.zeros((n, each))
    for m, k in enumerate(kept):
        for p in range(each):
            coeffs[k, p] = (numbers[m * each + p] - (1 << bits - 1) + 1) * 2.0 ** (exponents[k] + 2 - bits)
    return numbers, coeffs.reshape(shape)


def rotation_of(angles, channels):
    """Return the rotation (component, channel) of angles."""
    rotation = np.eye(channels)
    pairs = list(itertools.combinations(range(channels), 2))
    for (i, j), angle in reversed(list(zip(pairs, angles, strict=True))):
        turn = np.eye(channels)
        turn[[i, j], [i, j]], turn[j, i], turn[i, j] = np.cos(angle), -np.sin(angle), np.sin(angle)
        rotation = rotation @ turn
    return rotation


def decode_groups(streams, order, units, together, bits, shape):
    """Return the indices of all planes, in the order of the groups."""
    bands = {(band.name, band.level): band for band in list_bands(*shape, 5)}
    indices = [np.zeros((len(group), *shape), int) for group in order]
    ranks = [units] if together else [list(u) for _, u in itertools.groupby(units, key=lambda unit: unit[0])]
    streams = iter(streams)
    for rank in ranks:
        for group, index in zip(order, indices, strict=True):
            coarse = np.array([bits[m, d] for m, d in group])
            for held in [rank] if together else [[unit] for unit in rank]:
                stream, tables = Stream(next(streams)), UnitTables()
                for level, row, column in held:
                    if level == 0:
                        side = SIDES[0]
                        low = np.stack(
                            [bands["LL", 5].view(plane)[row : row + side, column : column + side] for plane in index]
                        )
                        decode_low(stream, tables, low)
                        for plane, values in zip(index, low, strict=True):
                            bands["LL", 5].view(plane)[row : row + side, column : column + side] = values
                    else:
                        decode_details(stream, tables, index, bands, (level, row, column), coarse[:, level])
                stream.finish()
    return np.concatenate(indices) if indices else np.zeros((0, *shape), int)
