"""How large an encoding is, as reports tell it, and may be."""

from __future__ import annotations

import math
from typing import Any

from clrelight.codec import Encoded, codec_class
from clrelight.codec.workspace import Shape
from clrelight.errors import InputError

_USED, _FEW_BYTES = 0.99, 64
"""Part of what was asked for that should be used; bytes that nobody misses."""


def size_facts(encoded: Encoded) -> dict[str, Any]:
    """Return what a report tells of an encoding's size, and what its codec measured."""
    return {
        "codec": encoded.codec,
        "encoded_bytes": encoded.encoded_bytes,
        "bits_per_coefficient": encoded.bits_per_coefficient,
        **encoded.info,
    }


def unused_notes(encoded: Encoded) -> list[str]:
    """Return what to say of a rate or a size that is asked of klt, and of which over a hundredth is left."""
    config = encoded.config
    if encoded.codec != "klt" or config.get("step") is not None:
        return []
    asked = int(config.get("byte_budget") or config["rate"] * math.prod(encoded.shape) / 8.0)
    if encoded.encoded_bytes >= _USED * asked or asked - encoded.encoded_bytes < _FEW_BYTES:
        return []
    why = "the finest step takes no more, or no step comes nearer"
    if not encoded.info.get("planes"):
        why = "it is the map's mean alone, as nothing else is in it, or its units would take more than that"
    return [f"{encoded.encoded_bytes} of the {asked} bytes that were asked for are used: {why}"]


def payload_budget(file_bytes: int, overhead: int, shape: Shape, codec_id: str = "klt") -> int:
    """Return what a file of so many bytes leaves for its payload; InputError where no image takes as little."""
    least = overhead + codec_class(codec_id).least_bytes(shape)
    if file_bytes < least:
        raise InputError(
            f"--bytes: a file of these lights and this size takes at least {least} bytes, got {file_bytes}"
        )
    return file_bytes - overhead
