"""Decode codec `vq` in float64, bit by bit, and search by force."""

import struct

import numpy as np


def read_bits(data, at, count):
    return sum((data[(at + i) // 8] >> (at + i) % 8 & 1) << i for i in range(count))


def decode_vq(body, shape):
    k, h, w, c = shape
    bits, block, exponent = struct.unpack_from("<BBh", body)
    dims = k * c if block == 0 else block * block * c
    words = np.frombuffer(body, "<f2", dims << bits, 4).reshape(-1, dims) * 2.0**exponent
    indices = body[4 + (2 * dims << bits) :]
    out = np.empty(shape)
    for i, y, x, j in np.ndindex(shape):
        if block == 0:
            vector, place = y * w + x, i * c + j
        else:
            rows, columns = -(-h // block), -(-w // block)
            vector = (i * rows + y // block) * columns + x // block
            place = ((y % block) * block + x % block) * c + j
        out[i, y, x, j] = words[read_bits(indices, vector * bits, bits), place]
    return out


def squared_distances(vectors_dp, codebook_jd):
    """Return (p, j)."""
    return np.square(vectors_dp.T[:, None].astype(float) - codebook_jd[None].astype(float)).sum(axis=2)
