"""A decoded map as a few planes and one small matrix: relit without ever becoming coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.errors import PayloadError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degree_of
from clrelight.matmul import multiply_columns


@dataclass(frozen=True)
class Factored:
    """Coefficients ``c[k, p, channel] = sum_j operator[k, channel, j] planes[j, p]``.

    Attributes
    ----------
    planes_jp : ndarray, shape (n_plane, height * width), float32
        The last plane is 1 everywhere: it carries the mean.
    operator_kcj : ndarray, shape (n_coeff, channel, n_plane), float64
    height, width : int
    """

    planes_jp: NDArray[np.float32]
    operator_kcj: NDArray[np.float64]
    height: int
    width: int

    def to_coeffs(self, device: Device) -> NDArray[np.float32]:
        """Return the (n_coeff, height, width, channel) float32 coefficients."""
        n_coeff, channel, _ = self.operator_kcj.shape
        rows = multiply_columns(device, self.operator_kcj.reshape(n_coeff * channel, -1), self.planes_jp)
        return np.ascontiguousarray(rows.reshape(n_coeff, channel, self.height, self.width).transpose(0, 2, 3, 1))

    def relight(self, directions_i3: NDArray[np.float64], device: Device) -> NDArray[np.float32]:
        """Return images (n_light, height, width, channel), float32 linear radiance in units of the peak.

        The light vector is transformed once; a pixel then costs one product per plane, however high the degree.
        """
        n_coeff, channel, _ = self.operator_kcj.shape
        basis_ik = evaluate_basis(directions_i3, degree_of(n_coeff))
        operator = np.einsum("ik,kcj->icj", basis_ik, self.operator_kcj).reshape(len(basis_ik) * channel, -1)
        images = finite_images(multiply_columns(device, operator, self.planes_jp))
        images = images.reshape(len(basis_ik), channel, self.height, self.width)
        return np.ascontiguousarray(images.transpose(0, 2, 3, 1))


@dataclass(frozen=True)
class WhitenedMaps:
    """Coefficients ``c = inverse z`` of maps in another basis, the same for all channels.

    Attributes
    ----------
    maps_jhwc : ndarray, shape (n_component, height, width, channel), float32
    inverse_kj : ndarray, shape (n_coeff, n_component), float64
    """

    maps_jhwc: NDArray[np.float32]
    inverse_kj: NDArray[np.float64]

    def to_coeffs(self, device: Device) -> NDArray[np.float32]:
        """Return the (n_coeff, height, width, channel) float32 coefficients."""
        return self._apply(self.inverse_kj, device)

    def relight(self, directions_i3: NDArray[np.float64], device: Device) -> NDArray[np.float32]:
        """Return images (n_light, height, width, channel), float32; the light vector is transformed, not the pixels."""
        basis_ik = evaluate_basis(directions_i3, degree_of(len(self.inverse_kj)))
        return finite_images(self._apply(basis_ik @ self.inverse_kj, device))

    def _apply(self, operator_mj: NDArray[np.float64], device: Device) -> NDArray[np.float32]:
        source_jp = self.maps_jhwc.reshape(len(self.maps_jhwc), -1)
        return multiply_columns(device, operator_mj, source_jp).reshape(len(operator_mj), *self.maps_jhwc.shape[1:])


def finite_images(images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the images as they are; PayloadError where they hold an infinity or a NaN."""
    if not np.isfinite(images.min()) or not np.isfinite(images.max()):
        raise PayloadError("the payload relights to values that are not finite: no encoder wrote it")
    return images
