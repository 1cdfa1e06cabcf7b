"""Decode codec `cpca` in float64, bit by bit."""

import struct

import numpy as np


def read_bits(data, at, count):
    return sum((data[(at + i) // 8] >> (at + i) % 8 & 1) << i for i in range(count))


def decode_cpca(body, shape):
    k, h, w, c = shape
    pixels, dims = h * w, k * c
    clusters, axes, bits, exponent = struct.unpack_from("<HHBh", body)
    at = 7
    means = np.frombuffer(body, "<f2", clusters * dims, at).reshape(clusters, dims).astype(float)
    at += 2 * clusters * dims
    basis = np.frombuffer(body, "<f2", clusters * axes * dims, at).reshape(clusters, axes, dims).astype(float)
    at += 2 * clusters * axes * dims
    low, step = np.frombuffer(body, "<f4", 2 * clusters * axes, at).reshape(2, clusters, axes).astype(float)
    at += 8 * clusters * axes
    index_bits = int(np.ceil(np.log2(clusters)))
    indices, codes = body[at : at + -(-pixels * index_bits // 8)], body[at + -(-pixels * index_bits // 8) :]
    out = np.empty((pixels, dims))
    for p in range(pixels):
        j = read_bits(indices, p * index_bits, index_bits)
        weights = [low[j, r] + step[j, r] * read_bits(codes, (p * axes + r) * bits, bits) for r in range(axes)]
        out[p] = means[j] + weights @ basis[j]
    return out.reshape(h, w, k, c).transpose(2, 0, 1, 3) * 2.0**exponent
