"""The separable transform of lat-long maps on a device: azimuths there, in float32, then rows on the host in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.harmonics.latlong import fold_of, folded_waves, project_rows

_BLOCK = 256
_ROWS = {1: 8, 3: 2}
"""Rows of a work-item, for one channel and for three."""


def project_latlong_on_device(
    radiance_hwc: NDArray[np.floating], degree: int, matrix: NDArray[np.float64] | None, device: Device
) -> NDArray[np.float64]:
    """Return what `harmonics.latlong.project_latlong` does, with sums over azimuth by lighting/azimuths.cl.

    Parameters
    ----------
    radiance_hwc : ndarray, shape (height, width, channel), float32 or float64
        Taken as float32.
    degree, matrix
        As of `project_latlong`.
    device : Device

    Returns
    -------
    ndarray, shape ((degree + 1)**2, channel), float64
    """
    height, width, channel = radiance_hwc.shape
    orders = min(degree, width // 2) + 1
    waves_mjx = folded_waves(width, orders, _BLOCK)
    sums_hmjc = device.empty((height, orders, 2, channel), np.float32)
    device.launch(
        "lighting/azimuths.cl",
        "sum_azimuths_hmjc",
        (-(-height // _ROWS[channel]),),
        sums_hmjc,
        device.upload(np.ascontiguousarray(radiance_hwc, np.float32)),
        device.upload(waves_mjx),
        height,
        orders,
        width,
        waves_mjx.shape[2],
        defines={
            "BLOCK": _BLOCK,
            "CHANNELS": channel,
            "FOLD": fold_of(width),
            "ROWS": _ROWS[channel],
            "VECTOR": device.info.lanes,
        },
    )
    parts_hmjc = device.download(sums_hmjc).astype(np.float64)
    return project_rows(parts_hmjc[:, :, 0] - 1j * parts_hmjc[:, :, 1], width, degree, matrix)
