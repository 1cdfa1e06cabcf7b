"""What the stages work on: the rendered ring scene, its fit, and what float64 makes of some of its columns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.harmonics.basis import evaluate_basis
from clrelight.jobs.fit import fit
from datasets_synth.ring import render_ring

_CHECKED_COLUMNS = 4099
"""Columns that are compared with float64: a prime, so that no tile or channel is left out."""


@dataclass(frozen=True)
class Workload:
    """The ring scene on a device.

    Attributes
    ----------
    device : Device
    stack : LightStack
        uint8, linear.
    degree : int
        Of the fits.
    """

    device: Device
    stack: LightStack
    degree: int

    @property
    def columns(self) -> int:
        """Pixels times channels."""
        return int(np.prod(self.stack.image_shape))

    @cached_property
    def images_ip(self) -> NDArray[np.float32]:
        """Radiance in units of the peak, float32."""
        return self.stack.images_ihwc.reshape(self.stack.n_light, -1) / np.float32(self.stack.peak)

    @cached_property
    def fitted(self) -> CoefficientMap:
        """The stack's CLS fit, in host memory."""
        return fit(self.stack, "cls", self.degree, device=self.device)

    @cached_property
    def basis_ik(self) -> NDArray[np.float64]:
        """Basis functions of the fit at the lights."""
        return evaluate_basis(self.stack.directions_i3, self.degree)

    @cached_property
    def checked_s(self) -> NDArray[np.intp]:
        """Indices of the columns that are compared with float64, evenly spread."""
        count = min(_CHECKED_COLUMNS, self.columns)
        return (np.arange(count) * self.columns // count).astype(np.intp)

    @cached_property
    def samples_is(self) -> NDArray[np.float64]:
        """Radiance of the compared columns, in units of the peak, float64."""
        codes_is = self.stack.images_ihwc.reshape(self.stack.n_light, -1)[:, self.checked_s]
        return codes_is.astype(np.float64) / self.stack.peak

    def image_error(self, coeffs_ks: NDArray, exact_ks: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what a difference of coefficients does to the images at all lights, in units of the peak."""
        return np.abs(self.basis_ik @ (coeffs_ks - exact_ks))


def make_workload(device: Device, *, size: int, lights: int, degree: int) -> Workload:
    """Render the ring scene for a device; InputError where the packages for ray tracing are not installed."""
    return Workload(device, render_ring(size=size, lights=lights), degree)
