"""Values as people write them: bytes with a unit, stops of exposure."""

from __future__ import annotations

import math
import re

from clrelight.errors import InputError

MAX_STOPS = 64.0
AUTO = "auto"
_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 1 << 10, "mi": 1 << 20, "gi": 1 << 30}


def count_bytes(value: int | str) -> int:
    """Return a number of bytes; InputError if it is none such as 1GiB, 512M or 2000000."""
    match = re.fullmatch(r"\s*([0-9.]+(?:e[0-9]+)?)\s*(k|m|g|ki|mi|gi|)b?\s*", str(value).lower())
    try:
        count = int(float(match[1]) * _UNITS[match[2]]) if match else 0
    except (ValueError, OverflowError):
        count = 0
    if not 1 <= count < 1 << 63:
        raise InputError(f"{value!r} is not a number of bytes such as 1GiB, 512M or 2000000")
    return count


def count_stops(value: float | str) -> float | None:
    """Return a number of stops, None for auto; InputError if it is neither."""
    if isinstance(value, str) and value == AUTO:
        return None
    try:
        stops = float(value)
    except (TypeError, ValueError):
        stops = math.nan
    if not abs(stops) <= MAX_STOPS:
        raise InputError(
            f"exposure must be a number of stops from -{MAX_STOPS:g} to {MAX_STOPS:g}, got {value}; light files "
            "also take auto"
        )
    return stops
