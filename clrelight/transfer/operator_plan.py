"""The tables that glossy operators are made of: one for each direction of light in the frame of a vertex."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.hemisphere import hemisphere_autocorrelation
from clrelight.harmonics.index import coefficient_index, degrees_of_coefficients
from clrelight.sampling import make_pattern
from clrelight.transfer.brdfs import Brdf
from clrelight.transfer.lobes import lobe_rule, matte_rule

EXTENSIONS = ("smooth", "least-squares", "mirror", "zero")
"""How views, which are known above the horizon, become functions on the sphere: see `extension_matrix`."""

LIGHT_FRAMES = ("global", "local")
"""Axes of the light that operators take: the positions', or each vertex's, to which it is then turned when used."""

SMOOTHING = 1e-5
"""Weight of the squared Laplacian of ``"smooth"``."""

_HEIGHTS = 64
_LEAST_SAMPLES = 16
_EXACT_DEGREE = 12


@dataclass(frozen=True)
class OperatorPlan:
    """What all vertices share.

    Attributes
    ----------
    lights_s3 : ndarray, shape (sample, 3), float64
        Directions in a vertex's frame.
    matte_sd, gloss_sd : ndarray, shape (sample, view coefficient * light coefficient * channel), float32, optional
        What each direction adds to the operator of a vertex that sees it; None where there is none.
    light_degree, view_degree : int
    channels : tuple of int
        Of the matte and of the glossy part, 1 or 3.
    config : dict
        How it was made, JSON values only.
    """

    lights_s3: NDArray[np.float64]
    matte_sd: NDArray[np.float32] | None
    gloss_sd: NDArray[np.float32] | None
    light_degree: int
    view_degree: int
    channels: tuple[int, int]
    config: dict[str, Any]


def plan_operators(
    brdf: Brdf,
    degree: int = 4,
    *,
    view_degree: int | None = None,
    samples: int = 1024,
    extension: str = "smooth",
    light_frame: str = "global",
) -> OperatorPlan:
    """Return the tables that operators of a BRDF are made of.

    Parameters
    ----------
    brdf : Brdf
    degree : int
        Of the light.
    view_degree : int, optional
        Of what is reflected; default: the light's.
    samples : int
        Directions of light over the hemisphere, of equal solid angle but for a correction that makes the
        integrals of basis functions of low degree exact.
    extension : str
        One of `EXTENSIONS`.
    light_frame : str
        One of `LIGHT_FRAMES`.
    """
    views = degree if view_degree is None else view_degree
    for each in (degree, views):
        if not 0 <= each <= MAX_DEGREE // 4:
            raise InputError(f"the degree of an operator must be from 0 to {MAX_DEGREE // 4}, got {each}")
    if light_frame not in LIGHT_FRAMES:
        raise InputError(f"light is in the {' or '.join(LIGHT_FRAMES)} frame, got {light_frame!r}")
    if samples < _LEAST_SAMPLES:
        raise InputError(f"an operator needs at least {_LEAST_SAMPLES} samples, got {samples}")
    lights_s3 = make_pattern("uniform", samples)
    weights_s = _exact_weights(lights_s3)
    extend_oo = extension_matrix(views, extension)
    basis_si = evaluate_basis(lights_s3, degree) * (weights_s * lights_s3[:, 2])[:, None]
    tables: list[NDArray[np.float32] | None] = []
    for colour_c, function, width in (
        (brdf.diffuse_c, brdf.matte, None),
        (brdf.specular_c, brdf.gloss, brdf.lobe_width),
    ):
        if not np.any(colour_c):
            tables.append(None)
            continue
        seen_soc = np.einsum("op,spc->soc", extend_oo, _view_moments(function, width, lights_s3, views))
        tables.append(np.einsum("soc,si->soic", seen_soc, basis_si).reshape(samples, -1).astype(np.float32))
    config = {"light_degree": degree, "view_degree": views, "light_frame": light_frame}
    config |= {"samples": samples, "extension": extension}
    sizes = len(brdf.matte(lights_s3[:1], lights_s3[:1])[0]), len(brdf.gloss(lights_s3[:1], lights_s3[:1])[0])
    return OperatorPlan(lights_s3, tables[0], tables[1], degree, views, sizes, {**config, **brdf.to_config()})


def extension_matrix(degree: int, extension: str) -> NDArray[np.float64]:
    """Return the matrix from ``integral_(z > 0) f y dv`` to coefficients, (n_coeff, n_coeff) float64.

    ``"zero"``: as if f were 0 below the horizon. ``"mirror"``: as above it. ``"least-squares"``: nearest to f above the
    horizon, whatever that makes of what lies below. ``"smooth"``: the same with `SMOOTHING` times the energy of the
    Laplacian added, which keeps coefficients small (compare `clrelight.fit.spline`). All but ``"zero"`` leave
    constants as they are.
    """
    l = degrees_of_coefficients(degree)
    if extension == "zero":
        return np.eye(len(l))
    if extension == "mirror":
        m = np.concatenate([np.arange(-d, d + 1) for d in range(degree + 1)])
        return np.diag(1.0 + (-1.0) ** (l + m))
    if extension not in EXTENSIONS:
        raise InputError(f"views are extended by {', '.join(EXTENSIONS)}, got {extension!r}")
    weight = SMOOTHING if extension == "smooth" else 0.0
    laplacian_k = (l * (l + 1.0)) ** 2
    return np.asarray(np.linalg.inv(hemisphere_autocorrelation(degree) + weight * np.diag(laplacian_k)))


def _view_moments(
    function: Callable[..., NDArray[np.float64]],
    width: float | None,
    lights_s3: NDArray[np.float64],
    degree: int,
) -> NDArray[np.float64]:
    """Return ``integral_(z > 0) f(s, v) y(v) dv`` for each light s, (sample, coefficient, channel).

    f is isotropic: integrals are made for lights of azimuth 0, at `_HEIGHTS` angles from the normal, interpolated
    between those and turned about the normal.
    """
    from scipy.interpolate import CubicSpline

    theta_t = np.linspace(0.0, 0.5 * np.pi, _HEIGHTS)
    meridian_t3 = np.stack([np.sin(theta_t), np.zeros_like(theta_t), np.cos(theta_t)], axis=1)
    rule = matte_rule() if width is None else lobe_rule(meridian_t3, width)
    views_tq3, weights_tq = (np.broadcast_to(part, (_HEIGHTS, *part.shape[-2 + d :])) for d, part in enumerate(rule))
    values_tqc = function(meridian_t3[:, None], views_tq3) * weights_tq[..., None]
    basis_tqk = evaluate_basis(views_tq3.reshape(-1, 3), degree).reshape(*views_tq3.shape[:2], -1)
    level_tkc = np.matmul(basis_tqk.transpose(0, 2, 1), values_tqc)
    level_skc = CubicSpline(theta_t, level_tkc)(np.arccos(np.clip(lights_s3[:, 2], 0.0, 1.0)))
    azimuth_s = np.arctan2(lights_s3[:, 1], lights_s3[:, 0])
    moments_skc = np.empty_like(level_skc)
    for l in range(degree + 1):
        for m in range(l + 1):  # of order -m nothing is there at azimuth 0: f is the same on both sides
            plus_sc = level_skc[:, coefficient_index(l, m)]
            moments_skc[:, coefficient_index(l, -m)] = np.sin(m * azimuth_s)[:, None] * plus_sc
            moments_skc[:, coefficient_index(l, m)] = np.cos(m * azimuth_s)[:, None] * plus_sc
    return moments_skc


def _exact_weights(lights_s3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return solid angles near 2 pi / n that integrate functions of low degree over the hemisphere exactly."""
    count = len(lights_s3)
    degree = min(_EXACT_DEGREE, int(np.sqrt(count / 4.0)) - 1)
    equal_s = np.full(count, 2.0 * np.pi / count)
    basis_sk = evaluate_basis(lights_s3, degree)
    wanted_k = hemisphere_autocorrelation(degree, 0)[:, 0] * np.sqrt(4.0 * np.pi)
    return equal_s + np.linalg.lstsq(basis_sk.T, wanted_k - basis_sk.T @ equal_s, rcond=1e-6)[0]
