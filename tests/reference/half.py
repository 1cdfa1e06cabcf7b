"""IEEE 754-2008 binary16 by its definition, in float64."""

import numpy as np


def encode_half(values):
    """Return the 16-bit patterns nearest to `values`, ties to the even one; infinity from 65520 on."""
    x = np.asarray(values, np.float64)
    magnitude = np.abs(x)
    # Spacing of binary16: 2**(e - 10) in [2**e, 2**(e+1)), 2**-24 below 2**-14.
    exponent = np.maximum(np.frexp(magnitude)[1] - 1, -14)
    steps = np.rint(np.ldexp(magnitude, 10 - exponent)).astype(np.int64)
    # Of a normal number, `steps` holds the implicit 1 as 1024, which carries into the exponent field by itself.
    bits = np.where(steps < 1024, steps, (exponent + 14) * 1024 + steps)
    bits = np.where(magnitude >= 65520, 0x7C00, bits)
    return (bits | (np.signbit(x).astype(np.int64) << 15)).astype(np.uint16)


def decode_half(bits):
    """Return the float64 values of finite 16-bit patterns."""
    bits = np.asarray(bits).astype(np.int64)
    sign = np.where(bits >> 15, -1.0, 1.0)
    exponent, fraction = (bits >> 10) & 31, bits & 1023
    return sign * np.where(exponent == 0, np.ldexp(fraction, -24), np.ldexp(1024.0 + fraction, exponent - 25))
