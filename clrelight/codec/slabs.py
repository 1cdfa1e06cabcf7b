"""Cut long arrays into slabs that fit a device's buffers, and say how many work-items share a group."""

from __future__ import annotations

from collections.abc import Iterator

from clrelight.device import Device

SLAB_BYTES = 1 << 26
"""Most float32 bytes that one launch reads or writes; drivers report limits that cannot be relied on."""


CACHED_BYTES = 1 << 23
"""Of what goes through several launches: about a cache of a processor, and small enough for memory to be used again
(`clrelight.recycling`)."""


def slabs(count: int, item_bytes: int, most_bytes: int = SLAB_BYTES) -> Iterator[slice]:
    """Yield consecutive slices of ``range(count)``, of at most so many bytes but at least one item each."""
    step = max(1, most_bytes // item_bytes)
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))


def group_size(device: Device) -> int:
    """Return the work-items of a group: 1 on a CPU, where each work-item runs long vectors, else 64 (a wave of AMD)."""
    return 1 if device.style == "cpu" else 64


def round_up(count: int, multiple: int) -> int:
    """Return the least multiple that is not below `count`."""
    return -(-count // multiple) * multiple
