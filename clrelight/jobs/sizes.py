"""How large an encoding is, as reports tell it, and may be."""

from __future__ import annotations

from typing import Any

from clrelight.codec import Encoded, codec_class
from clrelight.codec.workspace import Shape
from clrelight.errors import InputError


def size_facts(encoded: Encoded) -> dict[str, Any]:
    """Return what a report tells of an encoding's size, and what its codec measured."""
    return {
        "codec": encoded.codec,
        "encoded_bytes": encoded.encoded_bytes,
        "bits_per_coefficient": encoded.bits_per_coefficient,
        **encoded.info,
    }


def payload_budget(file_bytes: int, overhead: int, shape: Shape, codec_id: str = "klt") -> int:
    """Return what a file of so many bytes leaves for its payload; InputError where no image takes as little."""
    least = overhead + codec_class(codec_id).least_bytes(shape)
    if file_bytes < least:
        raise InputError(
            f"--bytes: a file of these lights and this size takes at least {least} bytes, got {file_bytes}"
        )
    return file_bytes - overhead
