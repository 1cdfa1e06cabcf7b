"""Irradiance of matte surfaces: from nine coefficients, and by brute force (irradiance-environment-maps)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device, open_device
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count, coefficient_index, degree_of, degrees_of_coefficients
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light

NINE_DEGREE = 2

WORST_CASE_ERROR = 3.0 / 32.0
"""Largest error of degree 2, as a part of the total light: that of a distant lamp at the horizon of the surface."""

_RUN = 2048
_NORMALS_AT_ONCE = 1024


def cosine_coefficients(degree: int) -> NDArray[np.float64]:
    """Return the factors A_l of the clamped cosine, l = 0 .. degree: ``E_lm = A_l L_lm``.

    By irradiance-environment-maps, eq. 8.
    """
    factors = np.zeros(degree + 1)
    for l in range(degree + 1):
        if l == 1:
            factors[l] = 2.0 * math.pi / 3.0
        elif l % 2 == 0:
            # l! / (2^l (l/2)!^2), in whole numbers until the division
            share = math.comb(l, l // 2) / 2**l
            factors[l] = 2.0 * math.pi * (-1.0) ** (l // 2 - 1) / ((l + 2) * (l - 1)) * share
    return factors


def irradiance_light(light: Light, degree: int = NINE_DEGREE) -> NDArray[np.float64]:
    """Return the coefficients ``E_lm`` of the irradiance up to `degree`, or to the light's own where that is less."""
    degree = min(degree, light.degree)
    factors_k = cosine_coefficients(degree)[degrees_of_coefficients(degree)]
    return factors_k[:, None] * light.coeffs_kc[: coefficient_count(degree)]


def evaluate_irradiance(
    light: Light, normals_n3: NDArray[np.float64], degree: int = NINE_DEGREE
) -> NDArray[np.float64]:
    """Return the irradiance at unit normals, (n, channel) float64: ``sum A_l L_lm y_lm(n)``.

    By irradiance-environment-maps, eq. 7.
    """
    coeffs_kc = irradiance_light(light, degree)
    return evaluate_basis(normals_n3, degree_of(len(coeffs_kc))) @ coeffs_kc


def irradiance_matrix(light: Light) -> NDArray[np.float64]:
    """Return M of each channel, (channel, 4, 4) float64: ``E(n) = (n, 1)^T M (n, 1)``.

    By irradiance-environment-maps, eq. 11 and 12.

    The constants c1 .. c5 are products of A_l and the basis functions' factors: 0.429043, 0.511664, 0.743125,
    0.886227, 0.247708 in the paper.
    """
    c1, c2, c3, c4, c5 = _matrix_constants()
    nine_kc = _nine(light)
    matrix = np.empty((light.channels, 4, 4))
    for c, (l00, l1_1, l10, l11, l2_2, l2_1, l20, l21, l22) in enumerate(nine_kc.T):
        matrix[c] = (
            (c1 * l22, c1 * l2_2, c1 * l21, c2 * l11),
            (c1 * l2_2, -c1 * l22, c1 * l2_1, c2 * l1_1),
            (c1 * l21, c1 * l2_1, c3 * l20, c2 * l10),
            (c2 * l11, c2 * l1_1, c2 * l10, c4 * l00 - c5 * l20),
        )
    return matrix


def irradiance_by_matrix(matrix_c44: NDArray[np.float64], normals_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(n, 1)^T M (n, 1)``, (n, channel) float64 (irradiance-environment-maps, eq. 11)."""
    n_n4 = np.concatenate([normals_n3, np.ones((len(normals_n3), 1))], axis=1)
    return np.einsum("ni,cij,nj->nc", n_n4, matrix_c44, n_n4, optimize=True)


def irradiance_by_polynomial(light: Light, normals_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same written out for each product of x, y, z, (n, channel) float64.

    By irradiance-environment-maps, eq. 13.
    """
    c1, c2, c3, c4, c5 = _matrix_constants()
    l00, l1_1, l10, l11, l2_2, l2_1, l20, l21, l22 = _nine(light)
    x, y, z = normals_n3.T[..., None]
    return (
        c1 * l22 * (x * x - y * y)
        + c3 * l20 * z * z
        + c4 * l00
        - c5 * l20
        + 2.0 * c1 * (l2_2 * x * y + l21 * x * z + l2_1 * y * z)
        + 2.0 * c2 * (l11 * x + l1_1 * y + l10 * z)
    )


def integrate_irradiance(
    environment: Environment,
    normals_n3: NDArray[np.float64],
    *,
    device: Device | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.float32]:
    """Return the irradiance at unit normals by summing every texel of the map on the device, (n, channel) float32.

    This is the reference that nine coefficients replace: O(n S) for S texels (see lighting/irradiance.cl).
    """
    device = device or open_device()
    directions_t3, weights_t = environment.geometry()
    radiance_tc = environment.radiance_hwc.reshape(-1, environment.channels)
    lit_t = (weights_t > 0) & radiance_tc.any(axis=1)
    lit_t[0] |= not lit_t.any()  # a black map: one texel of nothing
    weighted_tc = np.where(weights_t[lit_t, None] > 0, weights_t[lit_t, None] * radiance_tc[lit_t], 0.0)
    texel_tj = device.upload(np.concatenate([directions_t3[lit_t], weighted_tc], axis=1).astype(np.float32))
    vector = device.info.lanes
    irradiance_nc = np.empty((len(normals_n3), environment.channels), np.float32)
    for first in range(0, len(normals_n3), _NORMALS_AT_ONCE):
        part_n3 = normals_n3[first : first + _NORMALS_AT_ONCE]
        padded_dn = np.zeros((3, -(-len(part_n3) // vector) * vector), np.float32)
        padded_dn[:, : len(part_n3)] = part_n3.T
        out_cn = device.empty((environment.channels, padded_dn.shape[1]), np.float32)
        device.launch(
            "lighting/irradiance.cl",
            "integrate_hemisphere_cn",
            (padded_dn.shape[1] // vector,),
            out_cn,
            device.upload(padded_dn),
            texel_tj,
            padded_dn.shape[1],
            texel_tj.shape[0],
            defines={"VECTOR": vector, "CHANNELS": environment.channels, "RUN": _RUN},
        )
        irradiance_nc[first : first + len(part_n3)] = device.download(out_cn)[:, : len(part_n3)].T
        if progress is not None:
            progress(first + len(part_n3), len(normals_n3))
    return irradiance_nc


@dataclass(frozen=True)
class IrradianceError:
    """Error of the nine coefficients, as a part of the total light ``integral L ds``.

    Attributes
    ----------
    mean : float
        Mean over the sphere of normals of the absolute errors of all channels, over the light of all channels.
    maximum : float
        Largest absolute error of a channel, over the light of that channel.
    """

    mean: float
    maximum: float


def compare_irradiance(
    nine_nc: NDArray, exact_nc: NDArray, weights_n: NDArray[np.float64], light: Light
) -> IrradianceError:
    """Return how far two sets of irradiance are apart, at normals with these solid angles, under this light."""
    total_c = light.coeffs_kc[0] * math.sqrt(4.0 * math.pi)
    lit_c = total_c > 0
    if not lit_c.any():
        return IrradianceError(0.0, 0.0)
    error_nc = np.abs(np.asarray(nine_nc, np.float64) - exact_nc)
    mean = float((weights_n @ error_nc).sum() / weights_n.sum() / total_c.sum())
    return IrradianceError(mean, float((error_nc[weights_n > 0][:, lit_c] / total_c[lit_c]).max()))


def _nine(light: Light) -> NDArray[np.float64]:
    """Return L00, L1-1, L10, L11, L2-2, ... L22 of each channel, (9, channel); 0 beyond the light's degree."""
    nine_kc = np.zeros((coefficient_count(NINE_DEGREE), light.channels))
    held = light.coeffs_kc[: len(nine_kc)]
    nine_kc[: len(held)] = held
    return nine_kc


def _matrix_constants() -> tuple[float, float, float, float, float]:
    a0, a1, a2 = cosine_coefficients(NINE_DEGREE)
    # Factors of the basis functions, read off where these are 1 times them.
    at_z, at_x = evaluate_basis(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), NINE_DEGREE)
    y20 = at_z[coefficient_index(2, 0)] / 2.0  # 3 z^2 - 1
    y22 = at_x[coefficient_index(2, 2)]  # x^2 - y^2; xy, yz and xz have twice this
    return (a2 * y22, a1 * at_z[coefficient_index(1, 0)] / 2.0, 3.0 * a2 * y20, a0 * at_z[0], a2 * y20)
