"""Files on other machines, of which ranges of bytes are fetched as they are needed."""

from __future__ import annotations

SCHEMES = ("http://", "https://")


def is_remote(path: str) -> bool:
    """Return whether a path names a file on another machine."""
    return path[:8].lower().startswith(SCHEMES)
