"""Between environment maps and spherical-harmonic coefficients, both ways."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from clrelight.basis import MAX_DEGREE, evaluate_basis
from clrelight.conventions import coefficient_count, coefficient_index
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.lighting import layouts
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light

METHODS = ("auto", "direct", "separable")
"""``direct``: any layout, O(n_coeff S) on the device; ``separable``: lat-long maps, O(degree S^2) for S × S texels."""

_BLOCK = 256
_FFT_THREADS = 2
_FEW_ORDERS = 5
"""Orders up to which a product with their waves takes less time than an FFT."""
_LOBE_ROWS_PER_DEGREE, _FEWEST_LOBE_ROWS = 4, 64


def project_environment(
    environment: Environment, degree: int, *, method: str = "auto", device: Device | None = None
) -> Light:
    """Return the coefficients ``L_lm = integral L(s) y_lm(s) ds`` of a map (irradiance-environment-maps, eq. 10).

    Parameters
    ----------
    environment : Environment
    degree : int
        Largest degree, 0 to `basis.MAX_DEGREE`.
    method : str
        One of `METHODS`; ``"auto"`` takes ``"separable"`` where it can be had.
    device : Device, optional
        Of the direct method.

    Raises
    ------
    InputError
        If the degree or the method is not one of these, or ``"separable"`` is asked of another layout than lat-long,
        or of one whose up is not our z or -z.
    """
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    matrix = layouts.parse_axes(environment.axes)[1]
    separable = environment.layout == "latlong" and abs(matrix[2, 2]) == 1.0
    if method == "separable" and not separable:
        raise InputError(
            f"the separable transform is for latlong maps whose up is z, got a {environment.layout} map with axes "
            f"{environment.axes}"
        )
    if separable and method != "direct":
        coeffs_kc = project_latlong(environment.radiance_hwc, degree, matrix)
        taken = "separable"
    else:
        coeffs_kc = project_texels(environment, degree, device or open_device())
        taken = "direct"
    config = {"layout": environment.layout, "method": taken}
    return Light(coeffs_kc, environment.source, environment.axes, config)


def project_latlong(
    radiance_hwc: NDArray[np.floating], degree: int, matrix: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Project a lat-long map with sums over azimuth first, then over rows (frequency-space-environment-maps, 6.1).

    ``L_m(theta) = integral L e^(-i m phi) dphi`` is one FFT per row, or of few orders m one matrix product, in the
    map's precision; ``L_lm`` then sums rows in float64 with Fejer's weights. Radiance band-limited to `degree` comes
    back exactly from 2 degree + 1 rows and columns on.

    Parameters
    ----------
    radiance_hwc : ndarray, shape (height, width, channel), float32 or float64
    degree : int
    matrix : ndarray, shape (3, 3), optional
        Axes of `layouts.parse_axes` with up as z or -z; default: right, forward, up.

    Returns
    -------
    ndarray, shape ((degree + 1)**2, channel), float64
    """
    axes = np.eye(3) if matrix is None else matrix
    height, width, channel = radiance_hwc.shape
    plan = _latlong_plan(height, degree)
    spectrum_hmc = _sum_azimuths(radiance_hwc, min(degree, width // 2) + 1)  # few columns have few orders
    m = np.arange(spectrum_hmc.shape[1])
    # The sum over columns of L e^(i m phi), phi = longitude_azimuths, in the view's axes ...
    first, step = layouts.longitude_azimuths(width)[0], 2.0 * np.pi / width
    turn_m = np.exp(1j * m * first) * step
    # ... and in ours, which may be turned about z by quarters and mirrored: phi' = start + side phi.
    start = math.atan2(axes[1, 0], axes[0, 0])
    side = axes[0, 0] * axes[1, 1] - axes[0, 1] * axes[1, 0]
    coeffs_kc = np.zeros((coefficient_count(degree), channel))
    for order in m:
        sums_hc = spectrum_hmc[:, order].astype(np.complex128) * turn_m[order]
        sums_hc = np.exp(1j * order * start) * (sums_hc if side > 0 else sums_hc.conj())
        if axes[2, 2] < 0:
            sums_hc = sums_hc[::-1]
        sums_lx = plan.legendre_mlh[order] @ np.concatenate([sums_hc.real, sums_hc.imag], axis=1)
        coeffs_kc[plan.index_ml[order][0]] = sums_lx[:, :channel]
        if order:
            coeffs_kc[plan.index_ml[order][1]] = sums_lx[:, channel:]
    return coeffs_kc


def _sum_azimuths(radiance_hwc: NDArray[np.floating], orders: int) -> NDArray[np.complexfloating]:
    """Return ``sum_x L e^(-2 pi i m x / width)`` for m = 0 .. orders - 1, shape (height, orders, channel)."""
    if orders > _FEW_ORDERS:
        return scipy.fft.rfft(radiance_hwc, axis=1, workers=_FFT_THREADS)[:, :orders]
    height, width, channel = radiance_hwc.shape
    waves_xn = _waves(width, orders, channel, radiance_hwc.dtype)
    cosine, sine = np.moveaxis((radiance_hwc.reshape(height, -1) @ waves_xn).reshape(height, 2, orders, channel), 1, 0)
    return cosine - 1j * sine


@functools.lru_cache(maxsize=2)
def _waves(width: int, orders: int, channel: int, dtype: np.dtype) -> NDArray[np.floating]:
    """Return cosines and sines as a matrix that sums every channel of a row of texels by itself, in one product."""
    angle_xm = 2.0 * np.pi / width * np.outer(np.arange(width), np.arange(orders))
    waves_xm = np.concatenate([np.cos(angle_xm), np.sin(angle_xm)], axis=1)
    return np.kron(waves_xm, np.eye(channel)).astype(dtype)


@dataclass(frozen=True)
class _LatlongPlan:
    """For each order m: its polynomials at the rows times the rows' weights, and where k(l, m) and k(l, -m) are."""

    legendre_mlh: tuple[NDArray[np.float64], ...]
    index_ml: tuple[tuple[NDArray[np.intp], NDArray[np.intp]], ...]


@functools.lru_cache(maxsize=2)
def _latlong_plan(height: int, degree: int) -> _LatlongPlan:
    weight_h = layouts.latitude_weights(height)
    tables = legendre_tables(np.pi * (np.arange(height) + 0.5) / height, degree)
    l = np.arange(degree + 1)
    index = tuple((l[m:] * (l[m:] + 1) + m, l[m:] * (l[m:] + 1) - m) for m in l)
    return _LatlongPlan(tuple(table * weight_h for table in tables), index)


def legendre_tables(theta_h: NDArray[np.float64], degree: int) -> list[NDArray[np.float64]]:
    """Return, for m = 0 .. degree, the rows l = m .. degree of ``y_lm(theta, phi = 0)``, each (degree + 1 - m, n)."""
    meridian_h3 = np.stack([np.sin(theta_h), np.zeros_like(theta_h), np.cos(theta_h)], axis=1)
    basis_hk = evaluate_basis(meridian_h3, degree)
    l = np.arange(degree + 1)
    return [np.ascontiguousarray(basis_hk[:, l[m:] * (l[m:] + 1) + m].T) for m in l]


def synthesize_latlong(coeffs_kc: NDArray[np.float64], height: int, width: int) -> NDArray[np.float64]:
    """Return the light as a lat-long map (height, width, channel), float64: the inverse of `project_latlong`.

    The map needs more than twice as many columns as the light has degrees.
    """
    degree = math.isqrt(len(coeffs_kc)) - 1
    if width <= 2 * degree:
        raise InputError(f"degree {degree} needs a map of more than {2 * degree} columns, got {width}")
    tables = legendre_tables(np.pi * (np.arange(height) + 0.5) / height, degree)
    spectrum_hmc = np.zeros((height, width // 2 + 1, coeffs_kc.shape[1]), np.complex128)
    first = layouts.longitude_azimuths(width)[0]
    l = np.arange(degree + 1)
    for m in l:
        k = l[m:] * (l[m:] + 1)
        plus, minus = tables[m].T @ coeffs_kc[k + m], tables[m].T @ coeffs_kc[k - m]
        spectrum_hmc[:, m] = plus * width if m == 0 else 0.5 * width * (plus + 1j * minus) * np.exp(-1j * m * first)
    return scipy.fft.irfft(spectrum_hmc, width, axis=1)


def project_texels(environment: Environment, degree: int, device: Device) -> NDArray[np.float64]:
    """Project a map of any layout on the device: every texel times every basis function; see lighting/project.cl.

    Returns
    -------
    ndarray, shape ((degree + 1)**2, channel), float64
        Float32 in parts of the map, whose sums are added in float64.
    """
    radiance_tc = environment.radiance_hwc.reshape(-1, environment.channels)
    n_texel, n_coeff = len(radiance_tc), coefficient_count(degree)
    vector = device.info.lanes
    parts = min(-(-n_texel // _BLOCK), 8 * device.info.compute_units)
    each = -(-n_texel // parts)
    partial_gkc = device.empty((parts, n_coeff, environment.channels), np.float32)
    device.launch(
        "lighting/project.cl",
        "project_texels_gkc",
        (parts,),
        partial_gkc,
        device.upload(_texel_table(environment.layout, *environment.radiance_hwc.shape[:2], environment.axes)),
        device.upload(radiance_tc),
        device.upload(_recurrence(degree)),
        degree,
        each,
        n_coeff,
        n_texel,
        defines={"VECTOR": vector, "BLOCK": _BLOCK, "CHANNELS": environment.channels},
    )
    sums_kc = device.download(partial_gkc).sum(axis=0, dtype=np.float64)
    scale_k = np.full(n_coeff, math.sqrt(2.0))
    scale_k[[coefficient_index(l, 0) for l in range(degree + 1)]] = 1.0
    return scale_k[:, None] * sums_kc


@functools.lru_cache(maxsize=2)
def _texel_table(layout: str, height: int, width: int, axes: str) -> NDArray[np.float32]:
    """Return x, y, z and the solid angle of every texel, (4, n_texel) float32."""
    view_t3, weights_t = layouts.texel_geometry(layout, height, width)
    return np.concatenate([layouts.parse_axes(axes)[1] @ view_t3.T, weights_t[None]]).astype(np.float32)


def _recurrence(degree: int) -> NDArray[np.float32]:
    """Return the factors of `basis.evaluate_basis` for the kernel, (n_coeff, 2) float32; at l = m that of Q_mm."""
    step_kf = np.zeros((coefficient_count(degree), 2))
    for m in range(degree + 1):
        if m:
            step_kf[coefficient_index(m, m), 0] = math.sqrt((2 * m + 1) / (2 * m))
        for l in range(m + 1, degree + 1):
            step_kf[coefficient_index(l, m)] = (
                math.sqrt((4.0 * l * l - 1.0) / (l * l - m * m)),
                math.sqrt(((l - 1.0) ** 2 - m * m) / (4.0 * (l - 1.0) ** 2 - 1.0)),
            )
    return step_kf.astype(np.float32)


@dataclass(frozen=True)
class Lobes:
    """How far the light, cut off at its degree, swings below zero.

    Attributes
    ----------
    minimum : float
        Least radiance of any channel.
    maximum : float
        Largest radiance of any channel.
    share : float
        Part of the sphere, 0 to 1, where some channel is below 0.
    mean : float
        Mean radiance over the sphere and the channels, to judge the minimum by.
    """

    minimum: float
    maximum: float
    share: float
    mean: float


def measure_lobes(light: Light) -> Lobes:
    """Evaluate the light on a grid four times as fine as its degree, and say where it is negative.

    Extremes and mean are infinite or NaN where the sum of finite coefficients overflows.
    """
    height = max(_FEWEST_LOBE_ROWS, _LOBE_ROWS_PER_DEGREE * (light.degree + 1))
    with np.errstate(over="ignore", invalid="ignore"):
        radiance_hwc = synthesize_latlong(light.coeffs_kc, height, 2 * height)
        mean = float(np.mean(light.coeffs_kc[0])) / math.sqrt(4.0 * math.pi)
    # Rounding of a constant light is no lobe.
    floor = -1e-12 * float(np.max(np.abs(radiance_hwc)))
    negative_h = np.any(radiance_hwc < floor, axis=2).mean(axis=1)
    share = float(layouts.latitude_weights(height) @ negative_h) / 2.0
    return Lobes(float(radiance_hwc.min()), float(radiance_hwc.max()), share, mean)
