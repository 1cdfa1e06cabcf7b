"""Reflection maps as coefficient maps: what the registry's codecs make of them, and their principal axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import codec_class, decode
from clrelight.codec.registry import encode
from clrelight.device import Device
from clrelight.shrm.record import Shrm

CODECS = ("half", "uniform", "wavelet", "klt", "cpca")


def code_maps(shrm: Shrm, device: Device, codecs: Sequence[str] = CODECS) -> list[dict[str, Any]]:
    """Return size and error of a reflection map by each codec with its default settings.

    Views are orthonormal functions, so the error of coefficients is that of radiance, averaged over all views:
    ``error`` is its norm over that of the radiance. ``bits`` are those of a coefficient, side tables and all.
    """
    maps_khwc = np.ascontiguousarray(shrm.maps_khwc, np.float32)
    rows = []
    for name in codecs:
        encoded = encode(maps_khwc, codec_class(name)(), device)
        back_khwc = decode(encoded, device)
        error = float(np.linalg.norm(back_khwc - maps_khwc) / np.linalg.norm(maps_khwc))
        rows.append({"codec": name, "bytes": encoded.encoded_bytes, "bits": encoded.bits_per_coefficient})
        rows[-1]["error"] = error
    return rows


def principal_shares(shrm: Shrm) -> NDArray[np.float64]:
    """Return the part of a reflection map's energy that its first 1, 2, ... principal axes of views hold.

    ``(n_coeff,)``; the best that sums of so many products of a map and a function of the view can do
    (frequency-space-environment-maps, eq. 4).
    """
    flat_kx = shrm.maps_khwc.reshape(len(shrm.maps_khwc), -1).astype(np.float64)
    values = np.maximum(np.linalg.eigvalsh(flat_kx @ flat_kx.T)[::-1], 0.0)
    return np.cumsum(values) / values.sum()
