"""Quick normals of many pixels on a device: what ``variation/normals.cl`` needs, made once for all blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.variation.normals import (
    DARK,
    LEAST_DETERMINANT,
    LOST,
    SCALES,
    SHADOW,
    PixelNormals,
    order_limits,
)

LANES = 16
"""Pixels come in multiples of it, which is the most that a work-item takes."""
_ROOM = 64
"""Lights are rounded up to so many, so that few programs are built."""


class NormalSolver:
    """The constant arrays of some lights on a device, and a run over pixels.

    Parameters
    ----------
    device : Device
    directions_i3 : ndarray, shape (n_light, 3), float64
        As of `clrelight.variation.normals.find_normals`, whose quick method this is.
    floor : float
    """

    def __init__(self, device: Device, directions_i3: NDArray[np.float64], floor: float) -> None:
        self._device, self._floor, self._n_light = device, floor, len(directions_i3)
        self._tables = tuple(
            device.upload(np.ascontiguousarray(values, np.float32))
            for values in (directions_i3, np.linalg.pinv(directions_i3), SCALES)
        )

    def __call__(self, samples_ciq: NDArray[np.float32], most: float) -> PixelNormals:
        """Return what is found at Q pixels, a multiple of `LANES`.

        Parameters
        ----------
        samples_ciq : ndarray, shape (channel, n_light, Q), float32
            Linear radiance.
        most : float
            Samples from here on are at the end of their range.
        """
        device, (channel, n_light, count) = self._device, samples_ciq.shape
        shapes = (3, count), (channel, count), (count,)
        scaled_dq, albedo_cq, confidence_q = (device.empty(shape, np.float32) for shape in shapes)
        device.launch(
            "variation/normals.cl",
            "solve_normals_dq",
            (count // device.info.lanes,),
            scaled_dq,
            albedo_cq,
            confidence_q,
            device.upload(samples_ciq),
            *self._tables,
            min(most, 3e38),
            self._floor,
            *order_limits(n_light),
            *(n_light, count, len(SCALES)),
            defines={
                "VECTOR": device.info.lanes,
                "ROOM": -(-n_light // _ROOM) * _ROOM,
                "CHANNELS": channel,
                "DARK": f"{DARK}f",
                "SHADOW": f"{SHADOW}f",
                "LOST": f"{LOST}f",
                "LEAST_DETERMINANT": f"{LEAST_DETERMINANT}f",
            },
        )
        scaled_3q = device.download(scaled_dq)
        length_q = np.sqrt(np.einsum("aq,aq->q", scaled_3q, scaled_3q))
        unit_q = np.where(length_q > 1e-12, 1.0 / np.maximum(length_q, np.float32(1e-12)), 0.0).astype(np.float32)
        return PixelNormals((scaled_3q * unit_q).T, device.download(albedo_cq).T, device.download(confidence_q))
