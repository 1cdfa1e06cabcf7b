"""The codec inside another one: how a body names it, and in which axes of the hemisphere its maps are."""

from __future__ import annotations

from clrelight.codec.bodies import Body, rest_of
from clrelight.codec.registry import Codec, codec_class
from clrelight.codec.transforms.whitening import AXES
from clrelight.errors import InputError, PayloadError

NOT_INSIDE = ("principal", "whitened", "klt")
"""Codecs that change the basis themselves."""
_PORTABLE = 128
"""Added to the length of the name where the axes are those that every processor finds alike."""


def name_inner(codec: str) -> bytes:
    """Return how a body names its inner codec."""
    name = codec.encode("ascii")
    return bytes([_PORTABLE + len(name)]) + name


def open_inner(body: Body, outer: str, axes_before: str) -> tuple[type[Codec], str, Body]:
    """Return the inner codec that a body names, the axes of its maps, and what stands behind the name.

    `axes_before` are those of bodies without the mark. PayloadError if the name is none.
    """
    first = body[:1][0] if len(body) else 0
    end = 1 + (first & (_PORTABLE - 1))
    if len(body) < end:
        raise PayloadError(f"a {outer} body starts with the name of its codec, this one is too short")
    try:
        inner = codec_class(body[1:end].decode("ascii"))
    except (InputError, UnicodeDecodeError):
        raise PayloadError(f"a {outer} body names a codec that is not known") from None
    if inner.id in NOT_INSIDE:
        raise PayloadError(f"a {outer} body cannot hold codec {inner.id}")
    return inner, AXES if first & _PORTABLE else axes_before, rest_of(body, end)
