"""Glossy transfer: matrices from the coefficients of light to those of what each vertex reflects, over views.

``L_out(v) = integral f(s, v) max(0, n.s) V(s) L(s) ds`` (noise-resistant-fitting, eq. 2), projected on the light's
directions and on the views' (its footnote 2; Sloan, Kautz and Snyder 2002). No band limit lies between: each light
direction s of a fixed pattern in the vertex's frame has one table, the coefficients over views of f(s, .) times the
basis functions at s, so that a vertex is the sum of the tables of the directions that it sees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.rotation_batch import rotate_many
from clrelight.memory import DEFAULT_MEMORY
from clrelight.surface import Surface
from clrelight.transfer.brdfs import Brdf
from clrelight.transfer.lobes import frames_of
from clrelight.transfer.operator_plan import OperatorPlan, plan_operators
from clrelight.transfer.rays import RayScene
from clrelight.transfer.reflection import OPERATOR

_VERTICES_AT_ONCE = 4096


def transfer_operators(
    surface: Surface,
    brdf: Brdf,
    degree: int = 4,
    *,
    view_degree: int | None = None,
    samples: int = 1024,
    extension: str = "smooth",
    light_frame: str = "global",
    shadowed: bool = True,
    memory: int = DEFAULT_MEMORY,
    progress: Callable[[int, int], object] | None = None,
) -> CoefficientMap:
    """Return the operators of all vertices, as a map whose coefficient ``out * n_in + in`` is an entry.

    Parameters
    ----------
    surface : Surface
        With tangents, views are in each vertex's frame, else in the axes of the positions. Its albedo scales the
        BRDF's matte part.
    brdf : Brdf
    degree, view_degree, samples, extension, light_frame
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
    plan = plan_operators(
        brdf, degree, view_degree=view_degree, samples=samples, extension=extension, light_frame=light_frame
    )
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
        OPERATOR,
        1.0,
        "linear",
        np.array([[0.0, 0.0, 1.0]]),  # entries are of no lights
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
    local_light = plan.config["light_frame"] == "local"
    if local_light and surface.tangents_v3 is None:
        raise InputError("light in frames of vertices needs a surface with tangents, which say what those are")
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
        operators_vcoi = local_voic.transpose(0, 3, 1, 2)
        if not local_light:
            operators_vcoi = operators_vcoi @ _turns(own_v33, n_in)[:, None]
        if surface.tangents_v3 is None:
            back_voo = _turns(own_v33, n_out).transpose(0, 2, 1)
            operators_vcoi = back_voo[:, None] @ operators_vcoi
        entries_dvc = operators_vcoi.transpose(2, 3, 0, 1).reshape(n_out * n_in, end - first, channel)
        yield first, end, np.ascontiguousarray(entries_dvc)


def _turns(frames_v33: NDArray[np.float64], n_coeff: int) -> NDArray[np.float32]:
    """Return the matrices that take coefficients in common axes to each frame's, (vertex, n_coeff, n_coeff)."""
    return rotate_many(np.eye(n_coeff), frames_v33).astype(np.float32)


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
