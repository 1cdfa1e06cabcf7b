"""Coefficients of code values, what pictures store, in place of those of linear radiance.

A curve such as sRGB is steep where it is dark: an error of radiance that nobody sees in the light is a large error of
code values in the shade of the same pixel. Errors of the coefficients of code values are errors of code values wherever
they are.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from clrelight import recycling
from clrelight.bases import SH, basis_of
from clrelight.codec.finite import check_sums
from clrelight.codec.slabs import CACHED_BYTES, slabs
from clrelight.codec.transforms.light_metric import light_weights
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.whitening import reshaped
from clrelight.conventions import linear_to_srgb
from clrelight.device import Device
from clrelight.harmonics.index import degree_of
from clrelight.harmonics.quadrature import product_rule
from clrelight.matmul import apply_operator, multiply_columns, pack_operator
from clrelight.opencl.arguments import DeviceArray

_KEPT = 1e-3
"""Combinations of coefficients that an image shows less than this part of the most visible one are left at 0."""
_LOOKED_AT = 1 << 12
"""Pixels that errors are about measured at."""

_STRETCH = 1 << 14
"""Values that a work-item bends."""


def code_values_of(coeffs_khwc: NDArray[np.float32], device: Device, basis: str = SH) -> NDArray[np.float32]:
    """Return the coefficients of sRGB code values of radiance given by its coefficients, (n_coeff, h, w, channel).

    Radiance is evaluated at the nodes of a quadrature over the hemisphere that is exact for products of two functions
    of the degree, encoded, and projected back in the hemisphere's metric. More nodes would project better, but come
    back worse: these few are nearly interpolated. Above 1 the curve goes on, and below 0 it is that of the magnitude,
    so that nothing is clipped and `radiance_of` is near the inverse. (Straight on below 0 it would be steepest there,
    and what a fit makes up between its lights would outweigh what they show.)

    InputError if a sum passes what float32 holds.
    """
    return check_sums(_through(coeffs_khwc, device, basis, decode=False), device)


def radiance_of(values_khwc: NDArray[np.float32], device: Device, basis: str = SH) -> NDArray[np.float32]:
    """Return the coefficients of linear radiance of sRGB code values given by theirs; see `code_values_of`.

    What passes float32 comes out as infinities or NaN.
    """
    return _through(values_khwc, device, basis, decode=True)


def code_value_error(
    found_khwc: NDArray[np.float32],
    coeffs_khwc: NDArray[np.float32],
    device: Device,
    basis: str = SH,
    lights_i3: NDArray[np.float64] | None = None,
    *,
    as_code_values: bool = False,
) -> float:
    """Return the mean squared error over the hemisphere of sRGB code values clipped to [0, 1], by `light_weights`.

    Of coefficients of radiance, or of code values as relighting evaluates them. NaN where something is. Of some of the
    pixels where there are many, and at other directions than the nodes of `code_values_of`, which does best there.
    """
    n_coeff, channel = len(coeffs_khwc), coeffs_khwc.shape[-1]
    degree = degree_of(n_coeff)
    directions_i3, weight_i = product_rule(degree + 1)
    weight_i = light_weights(directions_i3, weight_i, lights_i3)
    synthesis_ik = basis_of(basis).evaluate(directions_i3, degree)
    n_pixel = coeffs_khwc[0, ..., 0].size
    some = slice(0, None, -(-n_pixel // _LOOKED_AT) | 1)  # odd, to leave no column of an image out

    def show(maps_khwc: NDArray[np.float32], encoded: bool) -> NDArray:
        chosen_kp = np.ascontiguousarray(maps_khwc.reshape(n_coeff, -1, channel)[:, some]).reshape(n_coeff, -1)
        shown_ip = multiply_columns(device, synthesis_ik, chosen_kp)
        np.clip(shown_ip, 0.0, 1.0, out=shown_ip)
        return shown_ip if encoded else linear_to_srgb(shown_ip, np.float32)

    error_ip = show(found_khwc, as_code_values) - show(coeffs_khwc, False)
    squared_i = np.einsum("ip,ip->i", error_ip, error_ip, dtype=np.float64) / error_ip.shape[1]
    return float(weight_i @ squared_i / weight_i.sum())


def bend(values: DeviceArray, device: Device, *, decode: bool) -> None:
    """Queue the sRGB curve of values in place, or its inverse; below 0 it is that of their magnitudes.

    What passes float32 comes out as infinities, and NaN stays NaN. Error below 5e-7 of the value, plus 2e-8.
    """
    size = math.prod(values.shape)
    device.launch(
        "codec/bend.cl",
        "bend_values_p",
        (-(-size // _STRETCH),),
        reshaped(values, (size,)),
        size,
        defines={"VECTOR": device.info.lanes, "DECODE": int(decode), "STRETCH": _STRETCH},
    )


def bent(images: NDArray[np.float32], device: Device, *, decode: bool) -> NDArray[np.float32]:
    """Return images behind the curve; see `bend`."""
    held = device.hold(np.array(images, order="C"))
    bend(held, device, decode=decode)
    return device.download(held)


def _through(coeffs_khwc: NDArray[np.float32], device: Device, basis: str, *, decode: bool) -> NDArray[np.float32]:
    synthesis, analysis = (pack_operator(device, matrix) for matrix in node_matrices(len(coeffs_khwc), basis))
    source_kp = coeffs_khwc.reshape(len(coeffs_khwc), -1)
    result_kp = recycling.empty(source_kp.shape, np.float32)
    for columns in slabs(source_kp.shape[1], 4 * synthesis.shape[0], CACHED_BYTES):
        held = device.hold(recycling.copied(source_kp[:, columns]))
        shown = device.empty((synthesis.shape[0], held.shape[1]), np.float32)
        apply_operator(device, synthesis, held, shown)
        bend(shown, device, decode=decode)
        apply_operator(device, analysis, shown, held)
        result_kp[:, columns] = device.download(held)
    return result_kp.reshape(coeffs_khwc.shape)


@functools.lru_cache(maxsize=4)
def node_matrices(n_coeff: int, basis: str = SH) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what evaluates coefficients at the nodes (n_node, n_coeff), and what projects values there back."""
    degree, known = degree_of(n_coeff), basis_of(basis)
    directions_i3, weight_i = known.nodes(degree)
    synthesis_ik = known.evaluate(directions_i3, degree)
    metric = hemisphere_metric(n_coeff, "singular", basis)
    shown_j = np.linalg.norm(metric.forward_jk, axis=1)
    inverse_kj = metric.inverse_kj[:, shown_j > _KEPT * shown_j.max()]
    # The columns of synthesis inverse are orthonormal functions on the hemisphere.
    return synthesis_ik, inverse_kj @ (synthesis_ik @ inverse_kj).T * weight_i
