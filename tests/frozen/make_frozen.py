"""Write the frozen payloads beside this file: ``python tests/frozen/make_frozen.py [codec ...]``.

Run by hand when a codec is new, never by a test and never over a payload that a release has written: the files
prove that what was encoded once still decodes to the same values. A codec whose bytes are made differently now has
another payload, with the version of its body behind its name, such as klt.3; other maps and options follow behind that.
"""

import sys
from pathlib import Path

import numpy as np

from clrelight.codec import codec_class, codec_ids, decode, encode
from clrelight.device import open_device

# Codes that cross bytes; tables and streams; planes that are not empty.
OPTIONS = {
    "uniform": {"bits": 7},
    "jpeg2000": {"rate": 8},
    "klt": {"step": 0.015625},
    "klt.3": {"step": 0.0009765625},
    "klt.3.srgb": {"step": 2.0**-7, "transfer": "srgb"},
    "klt.3.grey": {"step": 2.0**-6},
    "klt.3.fine": {"step": 2.0**-19},
    "klt.4": {"step": 2.0**-10},
    "klt.4.srgb": {"step": 2.0**-5, "transfer": "srgb"},
    "klt.4.grey": {"step": 2.0**-6},
    "klt.4.fine": {"step": 2.0**-19},
    "klt.4.wide": {"step": 2.0**-11},
    "klt.4.shells": {"step": 2.0**-6},
    "klt.4.mean": {"step": 2.0**-5},
    "principal.2": {"codec": "half"},
    "whitened.2": {"codec": "half"},
    "wavelet.6": {"rate": 4.0},
    "wavelet.6.global": {"rate": 6.0, "allocation": "global"},
    "wavelet.6.fine": {"rate": 30.0},
    "wavelet.7": {"rate": 9.0},
}
SHAPES = {
    "klt.3.srgb": (9, 13, 10, 3),
    "klt.3.grey": (49, 9, 12, 1),
    "klt.4.srgb": (9, 13, 10, 3),
    "klt.4.grey": (169, 9, 12, 1),  # a degree at which axes of old bodies hang on the processor
    "klt.4.wide": (4, 70, 33, 1),  # several units of the finest level
    "klt.4.shells": (121, 9, 12, 3),
    "klt.4.mean": (4, 40, 24, 1),  # so many pixels that their mean is worth finer steps
    "principal.2": (169, 5, 6, 1),
    "whitened.2": (169, 5, 6, 1),
    "wavelet.6": (9, 19, 21, 3),
    "wavelet.6.global": (9, 13, 10, 1),
    "wavelet.7": (4, 5, 6, 1),
}
FOLDER = Path(__file__).resolve().parent


def frozen_map(shape=(4, 9, 11, 3)):
    """Return a map of exact binary fractions: waves of integers, one constant plane, one outlier."""
    k, h, w, c = np.indices(shape)
    values = ((h * h + 3 * w * (k + 1) + 5 * c + h * w) % 61 - 30) / 8.0
    values[2] = -0.375
    values[3, 4, 5, -2 % shape[3]] = 200.0
    return values.astype(np.float32)


def smooth_map(shape):
    """Return a map such as pictures have, about between 0 and 1: slopes, an edge, less of higher degrees."""
    k, h, w, c = np.indices(shape)
    values = (3 * h + 2 * w + 4 * c + 24 * (h > w)) * (k % 4 == 0) + (h - w) * (k % 3 == 1) + (h * w % 5) * (k == 2)
    return (values / 128.0 / (1 + np.sqrt(k).astype(int)) ** 2).astype(np.float32)


def main(names):
    """Write NAME.bin (payload) and NAME.npy (its float32 values) for each codec, or codec.version, that has none."""
    device = open_device("cpu")
    for name in names or codec_ids():
        payload = FOLDER / f"{name}.bin"
        if payload.exists():
            print(f"{payload.name} exists and is kept")
            continue
        codec = name.partition(".")[0]
        make_map = smooth_map if name.endswith(".srgb") else frozen_map
        coeffs = make_map(SHAPES.get(name, (4, 9, 11, 3)))
        encoded = encode(coeffs, codec_class(codec).from_config(OPTIONS.get(name, {})), device).to_bytes()
        payload.write_bytes(encoded)
        np.save(FOLDER / f"{name}.npy", decode(encoded, device))
        print(f"{payload.name}: {len(encoded)} bytes")


if __name__ == "__main__":
    main(sys.argv[1:])
