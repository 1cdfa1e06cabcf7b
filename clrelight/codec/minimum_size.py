"""Few bytes cannot claim a great map: a decoder would fill memory before it finds out that they are not meant.

Codecs whose bodies grow with the map have a byte for so many coefficients at least (`pad_body`). Those that have no
least size fill up the bodies of great maps that code to next to nothing, such as black ones (`pad_to_minimum`): 2**17
coefficients a byte are a fifteenth of what the smallest useful rate has. Smaller maps are never touched.
"""

from __future__ import annotations

import math
import struct

from clrelight.codec.bodies import Body, front_of
from clrelight.codec.workspace import Shape
from clrelight.errors import InputError, PayloadError

FLOOR = 1024
"""Coefficients for which a padded body has at least one byte."""

_FREE_COEFFICIENTS = 1 << 24
_COEFFICIENTS_PER_BYTE = 1 << 17
_COUNT = struct.Struct("<I")
_ROUNDING = 1.0 + 1e-12
"""Lets a rate that was made of whole bytes be those again."""
_BLACK = 21
"""Bytes of a black view, without those of the rotation of its channels."""


def minimum_overhead(shape: Shape) -> int:
    """Return the bytes that every body of this shape (n_coeff, height, width, channel) has behind what is coded."""
    return _COUNT.size if minimum_bytes(shape) else 0


def pad_to_minimum(body: bytes, shape: Shape, budget: int | None = None) -> bytes:
    """Return the body with zeros as far as it needs them, and their number; InputError if that passes the budget."""
    least = minimum_bytes(shape)
    if not least:
        return body
    if budget is not None and least > budget:
        raise InputError(f"maps of shape {tuple(shape)} take at least {least} bytes, the budget is {budget}")
    zeros = max(0, least - len(body) - _COUNT.size)
    return body + bytes(zeros) + _COUNT.pack(zeros)


def drop_padding(body: Body, shape: Shape) -> Body:
    """Return what was coded; PayloadError if so few bytes cannot be of this shape."""
    least = minimum_bytes(shape)
    if not least:
        return body
    if len(body) < least:
        raise PayloadError(f"{len(body)} bytes cannot be a map of shape {tuple(shape)}")
    counted = len(body) - _COUNT.size
    (zeros,) = _COUNT.unpack(body[counted : len(body)])
    end = counted - zeros
    if end < 0 or any(body[end:counted]) or (zeros and len(body) != least):
        raise PayloadError(f"a body of {len(body)} bytes cannot have {zeros} bytes of padding")
    return front_of(body, end)


def minimum_bytes(shape: Shape) -> int:
    """Return the least bytes that a body of this shape may have; 0 for those that are small."""
    beyond = math.prod(shape) - _FREE_COEFFICIENTS
    return max(_COUNT.size, -(-beyond // _COEFFICIENTS_PER_BYTE)) if beyond > 0 else 0


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


def rated_bytes(rate: float, n_value: int) -> int:
    """Return the bytes that a rate in bits allows `n_value` coefficients; one that was made of bytes allows those."""
    return int(rate * n_value / 8.0 * _ROUNDING)


def least_payload(shape: Shape) -> int:
    """Return the fewest bytes that may be asked for a map of this shape: it may be black."""
    return max(_BLACK + shape[3] ** 2, minimum_bytes(shape))
