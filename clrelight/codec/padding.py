"""A least size for bodies, so that a few bytes may not claim gigabytes."""

from __future__ import annotations

from clrelight.errors import PayloadError

FLOOR = 1024
"""Coefficients for which a body has at least one byte."""


def least_bytes(n_value: int) -> int:
    """Return the bytes that a body of `n_value` coefficients has at least."""
    return -(-n_value // FLOOR)


def pad_body(body: bytes, n_value: int) -> bytes:
    """Return the body with zeros up to its least size."""
    return body.ljust(least_bytes(n_value), b"\0")


def check_padding(codec: str, body: bytes, end: int, n_value: int) -> None:
    """Raise PayloadError unless the body ends at `end`, or goes on with the zeros of `pad_body`."""
    if len(body) != max(end, least_bytes(n_value)) or any(body[end:]):
        raise PayloadError(f"codec {codec}: the data should end at byte {end}, the body has {len(body)}")
