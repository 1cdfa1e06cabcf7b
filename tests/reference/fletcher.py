"""Fletcher's checksum of 32 bits by its definition, in whole numbers."""

import numpy as np


def fletcher32(data):
    """Return the two sums of the 16-bit words of some bytes, their first byte the higher, modulo 65535.

    65535 stands for a multiple of it unless every byte is zero.
    """
    words = np.frombuffer(bytes(data) + b"\0" * (len(data) % 2), ">u2").astype(np.int64)
    first = int(words.sum())
    second = sum(int(w) * (len(words) - i) for i, w in enumerate(words))
    low, high = ((x - 1) % 65535 + 1 if first else 0 for x in (first, second))
    return high << 16 | low
