"""Fixed-length uniform codes in float64: decoding, and the quantiser from least to greatest value."""

import numpy as np


def decode_uniform(body, shape):
    """Return float64 coefficients (k, h, w, c) of a body: bit count, first levels, steps, codes."""
    bits, n_coeff = body[0], shape[0]
    low, step = np.frombuffer(body, "<f4", 2 * n_coeff, 1).astype(np.float64).reshape(2, n_coeff, 1)
    stream = np.unpackbits(np.frombuffer(body, np.uint8, offset=1 + 8 * n_coeff), bitorder="little")
    codes = stream[: bits * np.prod(shape)].reshape(n_coeff, -1, bits) @ (1 << np.arange(bits))
    return (low + codes * step).reshape(shape)


def minmax_error(coeffs, bits):
    """Return the squared error of each map (k,) with ``2**bits`` levels from its least to its greatest value."""
    x = coeffs.reshape(len(coeffs), -1).astype(np.float64)
    low, high = x.min(axis=1, keepdims=True), x.max(axis=1, keepdims=True)
    step = np.where(high > low, high - low, 1.0) / (2**bits - 1)
    return ((x - low - np.rint((x - low) / step) * step) ** 2).sum(axis=1)
