"""The separable transform of lat-long maps on a device: azimuths there in float32, rows on the host in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.harmonics.latlong import fold_of, folded_waves, project_rows

_BLOCK = 256
_LINES = 12
"""Rows times channels of a work-item, as lighting/azimuths.cl has them."""


def project_latlong_on_device(
    radiance_hwc: NDArray[np.floating], degree: int, device: Device, matrix: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Return what `harmonics.latlong.project_latlong` does, with sums over azimuth by lighting/azimuths.cl.

    Parameters
    ----------
    radiance_hwc : ndarray, shape (height, width, channel), float32 or float64
        Taken as float32.
    degree : int
    device : Device
    matrix : ndarray, shape (3, 3), optional
        As of `project_latlong`.

    Returns
    -------
    ndarray, shape ((degree + 1)**2, channel), float64
    """
    height, width, channel = radiance_hwc.shape
    orders = min(degree, width // 2) + 1
    waves_mjx = folded_waves(width, orders, _BLOCK)
    sums_hmcj = device.empty((height, orders, channel, 2), np.float32)
    device.launch(
        "lighting/azimuths.cl",
        "sum_azimuths_hmjc",
        (-(-height * channel // _LINES),),
        sums_hmcj,
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
            "VECTOR": device.info.lanes,
        },
    )
    return project_rows(device.download(sums_hmcj).view(np.complex64)[..., 0], width, degree, matrix)
