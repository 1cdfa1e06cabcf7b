"""Between environment maps and spherical-harmonic coefficients, both ways."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.harmonics.index import coefficient_count, coefficient_index
from clrelight.harmonics.latlong import latitude_weights, project_latlong, synthesize_latlong
from clrelight.lighting import layouts
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light
from clrelight.lighting.projection_device import project_latlong_on_device

METHODS = ("auto", "direct", "separable", "separable-device")
"""``direct``: any layout, O(n_coeff S) on the device; ``separable``: lat-long maps, O(degree S^2) for S × S texels.

The separable transform sums azimuths on the host, or on the device in float32: half the time for few degrees.
"""

_BLOCK = 256
_LOBE_ROWS_PER_DEGREE, _FEWEST_LOBE_ROWS = 4, 64


def project_environment(
    environment: Environment, degree: int, *, method: str = "auto", device: Device | None = None
) -> Light:
    """Return the coefficients ``L_lm = integral L(s) y_lm(s) ds`` of a map (irradiance-environment-maps, eq. 10).

    Parameters
    ----------
    environment : Environment
    degree : int
        Largest degree, 0 to `harmonics.basis.MAX_DEGREE`.
    method : str
        One of `METHODS`; ``"auto"`` takes ``"separable"`` where it can be had.
    device : Device, optional
        Of the direct method and of ``"separable-device"``.

    Raises
    ------
    InputError
        If the degree or the method is not one of these, or a separable one is asked of another layout than lat-long,
        or of one whose up is not our z or -z, or radiance is so large that its sums leave float32.
    """
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    matrix = layouts.parse_axes(environment.axes)[1]
    separable = is_separable(environment)
    if method.startswith("separable") and not separable:
        raise InputError(
            f"the separable transform is for latlong maps whose up is z, got a {environment.layout} map with axes "
            f"{environment.axes}"
        )
    taken = method if method != "auto" else "separable" if separable else "direct"
    with np.errstate(over="ignore", invalid="ignore"):  # refused below
        if taken == "separable":
            coeffs_kc = project_latlong(environment.radiance_hwc, degree, matrix)
        elif taken == "direct":
            coeffs_kc = project_texels(environment, degree, device or open_device())
        else:
            coeffs_kc = project_latlong_on_device(environment.radiance_hwc, degree, device or open_device(), matrix)
    if not np.isfinite(coeffs_kc).all():
        most = environment.radiance_hwc.max()
        raise InputError(f"radiance up to {most:.3g} cannot be summed in float32: scale the map down, to 1e30 at most")
    config = {"layout": environment.layout, "method": taken}
    return Light(coeffs_kc, environment.source, environment.axes, config)


def is_separable(environment: Environment) -> bool:
    """Return whether a map is lat-long with our z or -z as its up: its azimuths are then ours but for a turn."""
    return environment.layout == "latlong" and abs(layouts.parse_axes(environment.axes)[1][2, 2]) == 1.0


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
    """Return the factors of `evaluate_basis` for the kernel, (n_coeff, 2) float32; at l = m that of Q_mm."""
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
    share = float(latitude_weights(height) @ negative_h) / 2.0
    return Lobes(float(radiance_hwc.min()), float(radiance_hwc.max()), share, mean)
