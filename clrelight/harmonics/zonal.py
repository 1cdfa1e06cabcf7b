"""Zonal functions, which depend on the angle from an axis only: lobes in any direction, convolution.

A zonal function about z is given by its coefficients of the functions y_l0, one per degree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degree_of, degrees_of_coefficients
from clrelight.harmonics.windows import window_factors


def axis_factors(degree: int) -> NDArray[np.float64]:
    """Return ``sqrt(4 pi / (2 l + 1))`` of l = 0 .. degree, by which a zonal coefficient becomes a factor of y_lm."""
    return np.sqrt(4.0 * np.pi / (2.0 * np.arange(degree + 1) + 1.0))


def turn_lobe(zonal_l: NDArray[np.float64], direction_3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of a zonal function turned from z to a direction, ((degree + 1)**2,) float64.

    By the addition theorem ``f_lm = sqrt(4 pi / (2 l + 1)) z_l y_lm(d)``: no rotation matrix is needed.

    Parameters
    ----------
    zonal_l : ndarray, shape (degree + 1,), float64
    direction_3 : ndarray, shape (3,), float64
        Unit vector.
    """
    degree = len(zonal_l) - 1
    factors_k = (axis_factors(degree) * zonal_l)[degrees_of_coefficients(degree)]
    return factors_k * evaluate_basis(np.asarray(direction_3, dtype=np.float64)[None], degree)[0]


def convolve_zonal(coeffs_kc: NDArray[np.float64], kernel_l: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``integral f(t) h(s . t) dt``: each degree of f times ``sqrt(4 pi / (2 l + 1)) h_l`` (Funk and Hecke).

    Parameters
    ----------
    coeffs_kc : ndarray, shape (n_coeff, channel), float64
    kernel_l : ndarray, shape (degree + 1,), float64
        Zonal coefficients of h; degrees that it lacks become 0.
    """
    degree = degree_of(len(coeffs_kc))
    factors_l = np.zeros(degree + 1)
    shared = min(len(kernel_l), degree + 1)
    factors_l[:shared] = axis_factors(shared - 1) * kernel_l[:shared]
    return factors_l[degrees_of_coefficients(degree), None] * coeffs_kc


def window_kernel(window: str, degree: int, width: float | None = None) -> NDArray[np.float64]:
    """Return the zonal function that blurs as a window of `light.window_factors` does; its integral is 1."""
    return window_factors(window, degree, width) / axis_factors(degree)


def cap_kernel(angle: float, degree: int) -> NDArray[np.float64]:
    """Return the zonal coefficients of the cap about z that is 1 within `angle` of it, 0 elsewhere.

    ``z_l = sqrt(pi / (2 l + 1)) (P_(l-1)(cos a) - P_(l+1)(cos a))`` with ``P_-1 = 1``: the integral of P_l, with the
    Legendre polynomials by their recurrence ``l P_l = (2 l - 1) x P_(l-1) - (l - 1) P_(l-2)``.

    Parameters
    ----------
    angle : float
        Radians from the centre to the edge, above 0 and at most pi.
    degree : int

    Raises
    ------
    InputError
        If the angle is out of its range.
    """
    if not 0.0 < angle <= np.pi:
        raise InputError(f"the angle of a cap must be above 0 and at most 180 degrees, got {np.degrees(angle):g}")
    return cap_kernels(np.array([angle]), degree)[0]


def cap_kernels(angle_n: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return what `cap_kernel` does of many angles, 0 to pi, (n, degree + 1) float64."""
    edge_n = np.cos(angle_n)
    legendre = [np.ones_like(edge_n), np.ones_like(edge_n), edge_n]  # of degrees -1, 0, 1
    for l in range(2, degree + 2):
        legendre.append(((2 * l - 1) * edge_n * legendre[l] - (l - 1) * legendre[l - 1]) / l)
    values = np.stack(legendre[: degree + 3], axis=1)
    zonal_nl = np.sqrt(np.pi / (2.0 * np.arange(degree + 1) + 1.0)) * (values[:, :-2] - values[:, 2:])
    # 1 - cos a, without cancellation for a small cap
    zonal_nl[:, 0] = np.sqrt(np.pi) * 2.0 * np.sin(0.5 * angle_n) ** 2
    return zonal_nl
