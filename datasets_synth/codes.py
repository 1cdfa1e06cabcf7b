"""The types that scenes are written in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clrelight.dataset import LightStack
from clrelight.errors import InputError

DTYPES = ("uint8", "float16", "float32")
"""Sample types of scenes."""


def check_dtype(dtype: str) -> None:
    """Raise InputError unless scenes are written in this type."""
    if dtype not in DTYPES:
        raise InputError(f"dtype must be one of {', '.join(DTYPES)}, got {dtype!r}")


def to_codes(stack: LightStack, dtype: str) -> LightStack:
    """Return a stack of float32 with peak 1 in another type; uint8 is clipped and rounded, with peak 255."""
    check_dtype(dtype)
    if dtype != "uint8":
        return replace(stack, images_ihwc=stack.images_ihwc.astype(dtype, copy=False))
    codes = np.rint(np.clip(stack.images_ihwc, 0.0, 1.0) * np.float32(255.0)).astype(np.uint8)
    return replace(stack, images_ihwc=codes, peak=255.0)
