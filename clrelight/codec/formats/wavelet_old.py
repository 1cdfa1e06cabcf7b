"""Bodies that the codec `wavelet` wrote before, which begin with their number of levels, and how they are decoded."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.subband_kernel import decoder_for
from clrelight.codec.entropy.subbands import Statistics, code_indices
from clrelight.codec.streams import Target
from clrelight.codec.transforms.lifting import dequantise_map, empty_planes, inverse_transform, list_subbands
from clrelight.device import Device
from clrelight.errors import PayloadError

MAX_LEVELS = 5
_ABSENT = 65535
"""Step code of a map that is zero."""
BIAS_SCALE = 256.0


def decode_maps(body: bytes, target: Target, device: Device) -> None:
    """Put the maps of a body without its padding, map by map; PayloadError if it does not make sense."""
    tables, payload = _Tables.from_bytes(body, target.shape[0])
    n_coeff, height, width, channels = target.shape
    bands = list_subbands(height, width, tables.levels)
    biases = (tables.biases[0] / BIAS_SCALE, tables.biases[1] / BIAS_SCALE)
    decoder, shared = decoder_for(payload, device), Statistics()
    one = (1, height, width, channels)
    for done, k in enumerate(np.argsort(tables.codes != 0, kind="stable").tolist()):
        code = int(tables.codes[k])
        if code == _ABSENT:
            target.put_maps(k, np.zeros(one, np.float32))
            continue
        index = code_indices(decoder, Statistics() if code == 0 else shared, bands, (channels, height, width), None)
        planes = empty_planes(one, device)
        dequantise_map(planes, 0, index, float(np.float32(2.0 ** (code / 2048 - 22))), biases, device)
        scale_k = np.ldexp(np.float32(1.0), tables.exponents[k : k + 1])
        target.put_maps(k, inverse_transform(planes, one, scale_k, tables.levels, device))
        target.workspace.tell(done + 1, n_coeff)
    decoder.finish()
    target.finish()


@dataclass(frozen=True)
class _Tables:
    """What stands in front of the range-coded bytes."""

    levels: int
    biases: tuple[int, int]
    exponents: NDArray[np.integer]
    codes: NDArray[np.integer]

    @staticmethod
    def size(n_coeff: int) -> int:
        return 3 + 3 * n_coeff

    @classmethod
    def from_bytes(cls, body: bytes, n_coeff: int) -> tuple[_Tables, bytes]:
        if len(body) < cls.size(n_coeff):
            raise PayloadError(f"the wavelet side tables need {cls.size(n_coeff)} bytes, the body has {len(body)}")
        levels, *biases = struct.unpack_from("<Bbb", body)
        if not 1 <= levels <= MAX_LEVELS:
            raise PayloadError(f"wavelet levels must be 1 to {MAX_LEVELS}, the body says {levels}")
        exponents = np.frombuffer(body, "<i1", n_coeff, 3).astype(np.int32)
        codes = np.frombuffer(body, "<u2", n_coeff, 3 + n_coeff).astype(np.int64)
        if exponents.min() < -126:
            raise PayloadError(f"wavelet exponents must be -126 to 127, the body has {exponents.min()}")
        return cls(levels, (biases[0], biases[1]), exponents, codes), body[cls.size(n_coeff) :]
