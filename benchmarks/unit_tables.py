"""Count what units of coefficient maps hold, for the tables that all of them start from.

    python -m benchmarks.unit_tables FIT.h5 ... --out clrelight/codec/entropy/units.tables

Every map is coded at four rates; each counts as much as another, however large it is. The tables are a part of the
format: with others, files that were written before cannot be read.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.cli.progress import progress_bar
from clrelight.codec.entropy.unit_streams import FLAGS, ONE, Coded, default_tables
from clrelight.codec.formats.klt_encode import Encoder
from clrelight.codec.streams import ArraySource
from clrelight.codec.transforms.pixels import Pixels
from clrelight.device import open_device
from clrelight.store import open_fit

RATES = (0.02, 0.1, 0.3, 1.0)
TRUST, FLAG_TRUST = 250, 20
"""Symbols and flags that a table counts as."""
_LEAST_FLAG = 24
_SMOOTHED = 4.0
"""Symbols in each context, shared as the tables before have it."""


class Counting(Encoder):
    """An encoder that keeps what it counted last."""

    coded: Coded

    _counts = True

    def _encode(self, *arguments: Any) -> Coded:
        self.coded = super()._encode(*arguments)
        return self.coded


def main() -> None:
    """Count, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fits", nargs="+", metavar="FIT.h5")
    parser.add_argument("--out", required=True, metavar="FILE", help="what to write")
    arguments = parser.parse_args()
    before, device = default_tables(), open_device()
    share_ms = before.count_ms / before.count_ms.sum(axis=1, keepdims=True)
    symbol_ms: NDArray[np.float64] = _SMOOTHED * share_ms + 0.02
    zero_f2 = np.ones((FLAGS, 2))
    with progress_bar("counting") as bar:
        for number, path in enumerate(arguments.fits):
            with open_fit(path) as fitted:
                coeffs_khwc = np.ascontiguousarray(fitted.to_float32().coeffs_khwc)
            encoder = Counting(Pixels(ArraySource(coeffs_khwc, device, fitted.basis)), "linear")
            for rate in RATES:
                encoder.encode_within(int(rate * coeffs_khwc.size / 8))
                coded = encoder.coded
                symbol_ms += coded.symbol_ms * (1e5 / coded.symbol_ms.sum())
                zero_f2 += coded.flag_f2 * (1e4 / coded.flag_f2.sum())
            bar(number + 1, len(arguments.fits))
    share_ms = symbol_ms / symbol_ms.sum(axis=1, keepdims=True)
    counts = np.rint(TRUST * share_ms)
    counts[(counts == 0) & (TRUST * share_ms > 0.2)] = 1
    zeros = np.clip(np.rint(ONE * zero_f2[:, 0] / zero_f2.sum(axis=1)), _LEAST_FLAG, ONE - _LEAST_FLAG)
    flags = np.stack([zeros, np.full(FLAGS, FLAG_TRUST)], axis=1)
    Path(arguments.out).write_bytes(np.minimum(counts, 255).astype(np.uint8).tobytes() + flags.astype("<u2").tobytes())


if __name__ == "__main__":
    main()
