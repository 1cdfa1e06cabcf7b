"""How large an encoding is, as reports tell it."""

from __future__ import annotations

from typing import Any

from clrelight.codec import Encoded


def size_facts(encoded: Encoded) -> dict[str, Any]:
    """Return what a report tells of an encoding's size, and what its codec measured."""
    return {
        "codec": encoded.codec,
        "encoded_bytes": encoded.encoded_bytes,
        "bits_per_coefficient": encoded.bits_per_coefficient,
        **encoded.info,
    }
