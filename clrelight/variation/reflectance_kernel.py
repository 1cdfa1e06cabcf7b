"""`clrelight.variation.reflectance` for many pixels on a device: constant tables made once, and a run over pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.variation.kernel import LANES as LANES
from clrelight.variation.normals import DARK, LEAST_DETERMINANT, LOST, SHADOW, PixelNormals, order_limits
from clrelight.variation.reflectance import HELD, PULL, ROUGHNESS, STEPS, Law, PixelLaw, Steps, lobe_table

_ROOM = 64
"""Lights are rounded up to so many, so that few programs are built."""


class LawSolver:
    """Lights and a law on a device.

    Parameters
    ----------
    device : Device
    lights_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors; positions where `near`.
    law : Law
    fitted_i : ndarray, shape (n_light,), bool, optional
        False: a light that is left out, and predicted.
    floor : float
    near : bool
    steps : Steps
    held : float
        Residual at which a light that was left out counts as half wrong.
    """

    def __init__(
        self,
        device: Device,
        lights_i3: NDArray[np.float64],
        law: Law,
        *,
        fitted_i: NDArray[np.bool_] | None = None,
        floor: float = 0.0,
        near: bool = False,
        steps: Steps = STEPS,
        held: float = HELD,
    ) -> None:
        used_i = np.ones(len(lights_i3), bool) if fitted_i is None else fitted_i
        self._device, self._floor, self._near, self._law = device, floor, near, law
        self._held, self._rounds, self._n_step = held, steps.rounds, len(steps.scales)
        self._kept = order_limits(int(used_i.sum()))[0]
        self._lights = device.upload(np.ascontiguousarray(lights_i3, np.float32))
        self._tables = (
            device.upload(used_i.astype(np.int32)),
            *(device.upload(np.asarray(values, np.float32)) for values in (lobe_table(), steps.scales)),
        )

    def __call__(
        self,
        samples_ciq: NDArray[np.float32],
        view_3q: NDArray[np.float32],
        most: float,
        place_3q: NDArray[np.float32] | None = None,
    ) -> PixelLaw:
        """Return what is found at Q pixels, a multiple of `LANES`.

        Parameters
        ----------
        samples_ciq : ndarray, shape (channel, n_light, Q), float32
            Linear radiance; of near lights times the squared distance.
        view_3q : ndarray, shape (3, Q), float32
            Unit vectors to the camera.
        most : float
            Samples from here on are at the end of their range.
        place_3q : ndarray, shape (3, Q), float32, optional
            Positions of the pixels, where lights are near.
        """
        device, (channel, n_light, count) = self._device, samples_ciq.shape
        view = device.upload(view_3q)
        shapes = (3, count), (channel, count), (count,), (count,), (count,)
        outputs = [device.empty(shape, np.float32) for shape in shapes]
        device.launch(
            "variation/reflectance.cl",
            "solve_reflectance_dq",
            (count // device.info.lanes,),
            *outputs,
            device.upload(samples_ciq),
            self._lights,
            view,
            view if place_3q is None else device.upload(place_3q),
            *self._tables,
            min(most, 3e38),
            self._floor,
            self._held,
            self._kept,
            self._rounds,
            *(n_light, count, self._n_step),
            defines={
                "VECTOR": device.info.lanes,
                "ROOM": -(-n_light // _ROOM) * _ROOM,
                "CHANNELS": channel,
                "LOBES": len(ROUGHNESS) if self._law.glossy else 0,
                "SECOND": int(self._law.matte[1]),
                "THIRD": int(self._law.matte[2]),
                "PULL": f"{PULL}f",
                "NEAR": int(self._near),
                "DARK": f"{DARK}f",
                "SHADOW": f"{SHADOW}f",
                "LOST": f"{LOST}f",
                "LEAST_DETERMINANT": f"{LEAST_DETERMINANT}f",
            },
        )
        normals_3q, albedo_cq, confidence_q, error_q, count_q = (device.download(each) for each in outputs)
        found = PixelNormals(normals_3q.T, albedo_cq.T, confidence_q)
        return PixelLaw(found, float(error_q.sum(dtype=np.float64)), float(count_q.sum(dtype=np.float64)))
