"""Damaged payloads whose checksums fit: what a decoder must refuse, or decode to finite numbers."""

import struct
import zlib

import numpy as np

from clrelight.codec import decode, encode
from clrelight.errors import PayloadError


def seal(payload):
    """Return `payload` with the checksum of its own header and body."""
    at = 6 + payload[5] + 24
    if len(payload) < at + 4:
        return payload
    length = struct.pack("<Q", len(payload) - at - 4)
    head = payload[: at - 8] + length
    return head + struct.pack("<I", zlib.crc32(payload[at + 4 :], zlib.crc32(head))) + payload[at + 4 :]


def check_mutations(device, codec, shape, trials, table_bytes):
    """Mutate bytes, half of the hits in the header and first `table_bytes`; return how many were decoded."""
    rng = np.random.default_rng(trials)
    coeffs = rng.standard_normal(shape).astype(np.float32)
    original = encode(coeffs, codec, device).to_bytes()
    start = len(original) - len(encode(coeffs, codec, device).body)
    decoded = 0
    for trial in range(trials):
        payload = bytearray(original)
        for _ in range(rng.integers(1, 4)):
            # Past the codec's name, so that it is this codec that sees it.
            first, end = (6 + len(codec.id), start + table_bytes) if rng.random() < 0.5 else (start, len(payload))
            payload[rng.integers(first, end)] = rng.integers(0, 256)
        if trial % 10 == 0:
            del payload[rng.integers(start, len(payload)) :]
        elif trial % 10 == 1:
            payload += rng.bytes(rng.integers(1, 9))
        try:
            values = decode(seal(bytes(payload)), device)
        except PayloadError:
            continue
        assert np.isfinite(values).all()
        decoded += 1
    return decoded


def check_large_claims(device, codec_class, bodies):
    """Small bodies that claim gigabytes must be refused before anything is allocated."""
    for shape in [(1, 1 << 16, 1 << 15, 1), (1 << 16, 256, 128, 1), (1, 1, 1, 1 << 20), (64, 1 << 20, 1, 32)]:
        for body in bodies:
            try:
                codec_class.decode_body(body, shape, device)
            except PayloadError:
                continue
            raise AssertionError(f"{len(body)} bytes were taken for shape {shape}")
