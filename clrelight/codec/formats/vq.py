"""Codec `vq`: vector quantisation with one codebook (Gersho and Gray 1992)."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.bitpack import pack_codes, packed_size, unpack_codes
from clrelight.codec.formats.vq_search import design_codebook, search_codebook
from clrelight.codec.minimum_size import check_padding, least_bytes, pad_body
from clrelight.codec.registry import Codec, register
from clrelight.codec.transforms import vectors
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

MAX_BITS, MAX_BLOCK = 12, 8

_HEAD = struct.Struct("<BBh")


@register
@dataclass(frozen=True)
class Vq(Codec):
    """Store for each vector the index of the nearest of ``2**bits`` codewords.

    A vector is all that a pixel has (block 0), or the values of `block` x `block` pixels in one coefficient's map. All
    maps share the codebook, whose design and search minimise the squared error over all coefficients.

    Body: bits, block (uint8), exponent e (int16); codewords (codeword, vector) in units of 2**e as binary16; packed
    indices; zeros up to one byte for each 1024 coefficients. Vectors are (coefficient, channel) in raster order of
    pixels, or (row, column, channel) of blocks in the order (coefficient, block row, block column).

    Attributes
    ----------
    bits : int
        Bits of an index, 1 to 12; fewer where there are fewer vectors than codewords.
    block : int
        0 for pixels, else the side of a block, 1 to 8; edges are filled up by replication.
    """

    id: ClassVar[str] = "vq"
    summary: ClassVar[str] = "vector quantisation of pixels or of blocks, one codebook"

    bits: int = 8
    block: int = 0

    def __post_init__(self) -> None:
        for name, least, most in (("bits", 1, MAX_BITS), ("block", 0, MAX_BLOCK)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
                raise InputError(f"codec vq: {name} must be an integer from {least} to {most}, got {value!r}")

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """Return codebook and indices; ``info["table_bytes"]`` is what does not grow with the vectors."""
        exponent = vectors.exponent_of(coeffs_khwc)
        vectors_dp = _as_vectors(vectors.scaled(coeffs_khwc, -exponent), self.block)
        bits = min(self.bits, vectors_dp.shape[1].bit_length() - 1)
        codebook_jd = design_codebook(vectors_dp, bits, device).astype(np.float16)
        # Nearest among the codewords as they are stored.
        codes_p = search_codebook(vectors_dp, codebook_jd.astype(np.float32), device)[0]
        tables = _HEAD.pack(bits, self.block, exponent) + codebook_jd.tobytes()
        return pad_body(tables + pack_codes(codes_p, bits), coeffs_khwc.size), {"table_bytes": float(len(tables))}

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """Return the coefficients; PayloadError where codebook or lengths do not make sense."""
        if len(body) < max(_HEAD.size, least_bytes(math.prod(shape))):
            raise PayloadError(f"codec vq: {len(body)} bytes cannot hold coefficients of shape {shape}")
        bits, block, exponent = _HEAD.unpack_from(body)
        if bits > MAX_BITS or block > MAX_BLOCK or abs(exponent) > 150:
            raise PayloadError(f"codec vq: {bits} bits, blocks of {block}, exponent {exponent} are not possible")
        n_dim, n_vector = _vector_shape(shape, block)
        if 1 << bits > n_vector or (bits == 0 and n_vector > 1):
            raise PayloadError(f"codec vq: {1 << bits} codewords for {n_vector} vectors are not possible")
        indices_at = _HEAD.size + (2 * n_dim << bits)
        end = indices_at + packed_size(n_vector, bits)
        check_padding(cls.id, body, end, math.prod(shape))
        codebook_jd = np.frombuffer(body, np.float16, n_dim << bits, _HEAD.size).reshape(1 << bits, n_dim)
        if not np.isfinite(codebook_jd).all():
            raise PayloadError("codec vq: a codeword is not finite")
        codes_p = unpack_codes(body[indices_at:end], n_vector, bits)
        return _from_codes(codes_p, vectors.scaled(codebook_jd, exponent), shape, block)


def _vector_shape(shape: tuple[int, int, int, int], block: int) -> tuple[int, int]:
    """Return the dimension of a vector, and how many there are."""
    k, h, w, c = shape
    if block == 0:
        return k * c, h * w
    return block * block * c, k * -(-h // block) * -(-w // block)


def _as_vectors(coeffs_khwc: NDArray[np.float32], block: int) -> NDArray[np.float32]:
    """Return the vectors (d, p)."""
    k, h, w, c = coeffs_khwc.shape
    n_dim, n_vector = _vector_shape((k, h, w, c), block)
    if block == 0:
        return np.ascontiguousarray(coeffs_khwc.transpose(0, 3, 1, 2)).reshape(n_dim, n_vector)
    padded = np.pad(coeffs_khwc, ((0, 0), (0, -h % block), (0, -w % block), (0, 0)), mode="edge")
    blocks = padded.reshape(k, -(-h // block), block, -(-w // block), block, c)
    return np.ascontiguousarray(blocks.transpose(2, 4, 5, 0, 1, 3)).reshape(n_dim, n_vector)


def _from_codes(
    codes_p: NDArray[np.uint16], words_jd: NDArray[np.float32], shape: tuple[int, int, int, int], block: int
) -> NDArray[np.float32]:
    """Return the coefficients whose vectors are codewords `words_jd`."""
    k, h, w, c = shape
    if block == 0:
        return vectors.from_pixel_vectors(words_jd[codes_p], shape)
    codes_kyx = codes_p.reshape(k, -(-h // block), -(-w // block))
    coeffs_khwc = np.empty(shape, np.float32)
    # One place of all blocks at a time: what was filled up is never made.
    for row, column in np.ndindex(min(block, h), min(block, w)):
        target = coeffs_khwc[:, row::block, column::block]
        start = (row * block + column) * c
        target[:] = words_jd[:, start : start + c][codes_kyx[:, : target.shape[1], : target.shape[2]]]
    return coeffs_khwc
