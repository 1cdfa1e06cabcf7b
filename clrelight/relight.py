"""Images of a fitted view under any light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.basis import evaluate_basis
from clrelight.conventions import linear_to_srgb
from clrelight.dataset import CoefficientMap, check_directions
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.matmul import multiply_columns


def relight(
    coefficients: CoefficientMap, directions_i3: NDArray[np.float64], *, device: Device | None = None
) -> NDArray[np.float32]:
    """Return the view under distant lights of unit strength, ``image = sum_k c_k y_k(s)`` (paper, eq. 1).

    Parameters
    ----------
    coefficients : CoefficientMap
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors from the surface to the lights. Below the horizon of a hemispherical fit the result means
        nothing; it is returned as it is.
    device : Device, optional

    Returns
    -------
    ndarray, shape (n_light, height, width, channel), float32
        Linear radiance in units of the peak, not clipped.
    """
    device = device or open_device()
    check_directions(directions_i3, None)
    if not len(directions_i3):
        raise InputError("relighting needs at least 1 light, got none")
    coeffs_kp = np.ascontiguousarray(coefficients.coeffs_khwc[:]).reshape(coefficients.n_coeff, -1)
    images_ip = multiply_columns(device, evaluate_basis(directions_i3, coefficients.degree), coeffs_kp)
    return images_ip.reshape(len(directions_i3), *coefficients.image_shape)


def to_display(radiance: NDArray, transfer: str) -> NDArray[np.uint8]:
    """Return 8-bit display values of linear radiance: clipped to [0, 1], encoded by the transfer, rounded."""
    clipped = np.clip(radiance, 0.0, 1.0)
    encoded = linear_to_srgb(clipped) if transfer == "srgb" else clipped
    return np.rint(encoded * 255.0).astype(np.uint8)
