"""The precision of a fit: which of a device's numbers are float32, and which float64."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clrelight.device import Device
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.fit.registry import FitMethod

MIXED, SINGLE, DOUBLE = "mixed", "single", "double"
PRECISIONS = (MIXED, SINGLE, DOUBLE)
"""``"mixed"``: float32, and float64 for columns whose lambda float32 cannot give. ``"single"``: float32 throughout.
``"double"``: float64 throughout, the coefficients rounded to float32 at the end. The host makes the matrices in float64
for all of them."""


def check_precision(precision: str, device: Device) -> None:
    """Raise InputError for an unknown name, and for ``"double"`` where the device has no float64."""
    if precision not in PRECISIONS:
        raise InputError(f"precision must be one of {', '.join(PRECISIONS)}, got {precision!r}")
    if precision == DOUBLE and not device.info.float64:
        raise InputError(f"precision double needs float64, which {device.info.name} has not; use mixed or single")


def differing_precisions(method: FitMethod, device: Device) -> list[str]:
    """Return the precisions that run different kernels for a method on a device, ``"mixed"`` first."""
    if not device.info.float64:
        return [MIXED]
    return [MIXED, SINGLE, DOUBLE] if method.is_refined else [MIXED, DOUBLE]


def compute_dtype(precision: str) -> np.dtype:
    """Return the type of operators, components and bounds on the device."""
    return np.dtype(np.float64 if precision == DOUBLE else np.float32)
