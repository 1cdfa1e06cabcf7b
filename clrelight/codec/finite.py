"""Whether coefficients are finite, at the speed of reading them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.errors import InputError

_STRETCH = 1 << 15


def check_sums(maps_jhwc: NDArray[np.float32], device: Device) -> NDArray[np.float32]:
    """Return maps that are sums of finite coefficients; InputError if any of them is past what float32 holds."""
    if not all_finite(maps_jhwc, device):
        raise InputError("the coefficients are too large to be summed in float32: scale them, or code them as fitted")
    return maps_jhwc


def check_coefficients(coeffs_khwc: NDArray[np.float32], device: Device, first_row: int = 0) -> None:
    """Raise InputError that names a coefficient which is not finite, of rows from `first_row` on."""
    if all_finite(coeffs_khwc, device):
        return
    k, row, column, channel = (int(i) for i in np.argwhere(~np.isfinite(coeffs_khwc))[0])
    raise InputError(
        f"coefficient (k, row, column, channel) = {(k, first_row + row, column, channel)} is "
        f"{coeffs_khwc[k, row, column, channel]}, expected a finite number"
    )


def all_finite(coeffs_khwc: NDArray[np.float32], device: Device) -> bool:
    """Return whether a float32 array holds neither infinity nor NaN; it is not sent to a device of other memory."""
    if not device.shares_memory or not coeffs_khwc.flags.c_contiguous:
        # Minimum and maximum see every NaN and infinity, and make no array of truths.
        return bool(np.isfinite(coeffs_khwc.min()) and np.isfinite(coeffs_khwc.max()))
    items = -(-coeffs_khwc.size // _STRETCH)
    refused_j = device.empty((items,), np.uint8)
    device.launch(
        "codec/finite.cl",
        "find_infinite_j",
        (items,),
        refused_j,
        device.upload(coeffs_khwc.reshape(-1)),
        coeffs_khwc.size,
        defines={"STRETCH": _STRETCH},
    )
    return not device.download(refused_j).any()
