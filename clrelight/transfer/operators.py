"""Glossy transfer: matrices from the coefficients of light to those of what each vertex reflects, over views.

``L_out(v) = integral f(s, v) max(0, n.s) V(s) L(s) ds`` (noise-resistant-fitting, eq. 2), projected on the light's
directions and on the views' (its footnote 2; Sloan, Kautz and Snyder 2002). No band limit lies between: each light
direction s of a fixed pattern in the vertex's frame has one table, the coefficients over views of f(s, .) times the
basis functions at s, so that a vertex is the sum of the tables of the directions that it sees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.hemisphere import hemisphere_autocorrelation
from clrelight.harmonics.index import coefficient_count, coefficient_index, degrees_of_coefficients
from clrelight.memory import DEFAULT_MEMORY
from clrelight.sampling import make_pattern
from clrelight.surface import Surface
from clrelight.transfer.brdfs import Brdf, frames_of, lobe_rule, matte_rule
from clrelight.transfer.rays import RayScene
from clrelight.transfer.turns import frame_rotations

EXTENSIONS = ("smooth", "least-squares", "mirror", "zero")
"""How views, which are known above the horizon, become functions on the sphere: see `extension_matrix`."""

SMOOTHING = 1e-5
"""Weight of the squared Laplacian of ``"smooth"``."""

_HEIGHTS = 64
_LEAST_SAMPLES = 16
_VERTICES_AT_ONCE = 4096
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
    brdf: Brdf, degree: int = 4, *, view_degree: int | None = None, samples: int = 1024, extension: str = "smooth"
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
    """
    views = degree if view_degree is None else view_degree
    for each in (degree, views):
        if not 0 <= each <= MAX_DEGREE // 4:
            raise InputError(f"the degree of an operator must be from 0 to {MAX_DEGREE // 4}, got {each}")
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
    config = {"light_degree": degree, "view_degree": views, "samples": samples, "extension": extension}
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


def transfer_operators(
    surface: Surface,
    brdf: Brdf,
    degree: int = 4,
    *,
    view_degree: int | None = None,
    samples: int = 1024,
    extension: str = "smooth",
    shadowed: bool = True,
    memory: int = DEFAULT_MEMORY,
    progress: Callable[[int, int], object] | None = None,
) -> CoefficientMap:
    """Return the operators of all vertices, as a map whose coefficient ``out * n_in + in`` is an entry.

    Parameters
    ----------
    surface : Surface
        With tangents, views are in each vertex's frame, else in the axes of the positions. Its albedo scales the
        BRDF's matte part. Light is in the axes of the positions always.
    brdf : Brdf
    degree, view_degree, samples, extension
        See `plan_operators`.
    shadowed : bool
        Whether the surface takes light from itself.
    memory : int
        Bytes that a tile of vertices may take; the map comes on top.
    progress : callable, optional
        Told how many vertices are done, of how many.

    Returns
    -------
    CoefficientMap
        Shape (n_out * n_in, *surface.map_shape, channel), float32, of method ``"operator"``. Its degree,
        ``(view_degree + 1) (light_degree + 1) - 1``, is only what makes the count of its "coefficients" one of a
        degree: codecs and files take it as any map.
    """
    plan = plan_operators(brdf, degree, view_degree=view_degree, samples=samples, extension=extension)
    channel = channel_count(surface, plan)
    n_coeff = coefficient_count(plan.light_degree) * coefficient_count(plan.view_degree)
    operators_dvc = np.empty((n_coeff, surface.n_vertex, channel), np.float32)
    for first, end, tile_dvc in operator_tiles(surface, plan, shadowed=shadowed, memory=memory):
        operators_dvc[:, first:end] = tile_dvc
        if progress is not None:
            progress(end, surface.n_vertex)
    return operator_map(operators_dvc.reshape(n_coeff, *surface.map_shape, channel), surface, plan)


def operator_map(operators_dhwc: Any, surface: Surface, plan: OperatorPlan) -> CoefficientMap:
    """Return entries (n_out * n_in, height, width, channel) as a map that says what they are."""
    degree = (plan.view_degree + 1) * (plan.light_degree + 1) - 1
    return CoefficientMap(
        operators_dhwc,
        degree,
        "operator",
        1.0,
        "linear",
        plan.lights_s3,
        config=plan.config,
        name=surface.name,
        surface=surface,
    )


def channel_count(surface: Surface, plan: OperatorPlan) -> int:
    """Return the channels of the operators of a surface: 1 or 3."""
    albedo = 1 if surface.albedo_vc is None or plan.matte_sd is None else surface.albedo_vc.shape[1]
    parts = zip((plan.matte_sd, plan.gloss_sd), plan.channels, strict=True)
    return max(albedo, *(count for table, count in parts if table is not None), 1)


def operator_tiles(
    surface: Surface, plan: OperatorPlan, *, shadowed: bool = True, memory: int = DEFAULT_MEMORY
) -> Iterator[tuple[int, int, NDArray[np.float32]]]:
    """Yield the ends of each tile of vertices, whole rows of the map, and (n_out * n_in, vertex, channel) float32."""
    scene = RayScene(surface) if shadowed else None
    n_in, n_out = coefficient_count(plan.light_degree), coefficient_count(plan.view_degree)
    channel, n_sample = channel_count(surface, plan), len(plan.lights_s3)
    # A ray's start, its direction, the vertex and the answer; entries of both parts, turned, and as they are wanted.
    each = 48 * n_sample + 4 * 5 * n_in * n_out * channel + 8 * 100 * max(n_in, n_out)
    width = surface.map_shape[1]
    step = int(min(surface.n_vertex, memory // each, max(_VERTICES_AT_ONCE, width))) // width * width
    if step < 1:
        row = "one vertex's operator takes" if width == 1 else f"operators of one row of {width} vertices take"
        raise InputError(f"{row} {each * width} bytes: allow --memory that many, got {memory}")
    for first in range(0, surface.n_vertex, step):
        end = min(first + step, surface.n_vertex)
        normals_v3 = surface.normals_v3[first:end]
        own_v33 = frames_of(normals_v3) if surface.tangents_v3 is None else surface.frames()[first:end]
        seen_vs = _visibility(scene, np.arange(first, end), own_v33, plan.lights_s3)
        local_voic = _sum_tables(plan, seen_vs, surface, slice(first, end), (n_out, n_in, channel))
        turns_vii = frame_rotations(own_v33, plan.light_degree).astype(np.float32)
        operators_vcoi = local_voic.transpose(0, 3, 1, 2) @ turns_vii[:, None]
        if surface.tangents_v3 is None:
            back_voo = frame_rotations(own_v33, plan.view_degree).transpose(0, 2, 1).astype(np.float32)
            operators_vcoi = back_voo[:, None] @ operators_vcoi
        entries_dvc = operators_vcoi.transpose(2, 3, 0, 1).reshape(n_out * n_in, end - first, channel)
        yield first, end, np.ascontiguousarray(entries_dvc)


def _sum_tables(
    plan: OperatorPlan,
    seen_vs: NDArray[np.float32],
    surface: Surface,
    part: slice,
    shape: tuple[int, int, int],
) -> NDArray[np.float32]:
    """Return operators in the frames of vertices, (vertex, out, in, channel)."""
    total_voic = np.zeros((len(seen_vs), *shape), np.float32)
    for table_sd, count, albedo_vc in (
        (plan.matte_sd, plan.channels[0], surface.albedo_vc),
        (plan.gloss_sd, plan.channels[1], None),
    ):
        if table_sd is None:
            continue
        sums_voic = (seen_vs @ table_sd).reshape(len(seen_vs), *shape[:2], count)
        total_voic += sums_voic if albedo_vc is None else sums_voic * albedo_vc[part, None, None]
    return total_voic


def _visibility(
    scene: RayScene | None, vertices_v: NDArray[np.intp], frames_v33: NDArray[np.float64], lights_s3: NDArray
) -> NDArray[np.float32]:
    """Return 1 where vertices see the light of a direction of their frame, else 0: (vertex, sample)."""
    if scene is None:
        return np.ones((len(vertices_v), len(lights_s3)), np.float32)
    directions_vs3 = np.matmul(lights_s3.astype(np.float32), frames_v33.astype(np.float32))
    hidden_r = scene.occluded(np.repeat(vertices_v, len(lights_s3)), directions_vs3.reshape(-1, 3))
    return 1.0 - hidden_r.reshape(len(vertices_v), -1).astype(np.float32)


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
