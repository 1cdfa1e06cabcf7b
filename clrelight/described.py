"""Records of large arrays as a notebook shows them: what each field is, not all its numbers."""

from __future__ import annotations

import dataclasses
from typing import Any

_MOST_LETTERS = 80


class Described:
    """A dataclass whose `repr` tells arrays by type and shape, bytes by their number, and leaves out what is None.

    A dataclass that inherits it is made with ``repr=False``.
    """

    def __repr__(self) -> str:
        """Return the type and its fields in one line."""
        held = ((each.name, getattr(self, each.name)) for each in dataclasses.fields(self) if each.repr)  # type: ignore[arg-type]
        told = ", ".join(f"{name}={describe(value)}" for name, value in held if value is not None)
        return f"{type(self).__name__}({told})"


def describe(value: Any) -> str:
    """Return a value in few letters: an array as ``float32 (4, 5)``, a payload as ``120 bytes``."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{value.dtype} {tuple(value.shape)}" if tuple(value.shape) else repr(value)
    if isinstance(value, bytes | bytearray | memoryview):
        return f"{len(value)} bytes"
    text = f"{value:.6g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= _MOST_LETTERS else f"{text[: _MOST_LETTERS - 3]}..."
