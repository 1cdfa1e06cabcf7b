"""Radiance that surfaces reflect: their functions times light, in global axes and in each vertex's frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.errors import InputError
from clrelight.fit import method_ids
from clrelight.harmonics.index import coefficient_count
from clrelight.lighting.light import Light
from clrelight.memory import TILE_BYTES
from clrelight.surface import Surface, surface_facts
from clrelight.tiles import row_tiles
from clrelight.transfer.lit_functions import Functions, seen_degree
from clrelight.transfer.sources import DistantLight, Source, shade_by


def is_hemispherical(coefficients: CoefficientMap | FitRecord) -> bool:
    """Return whether a map's functions are known on the upper hemisphere of their frames only.

    Those are that a fit made in local frames: by one of the methods of ``clrelight fit``, from samples above each
    vertex's horizon. Transfer projects over the whole sphere, and so do fits in global axes.
    """
    facts = surface_facts(coefficients.surface, coefficients.config) or {}
    return facts.get("frame") == "local" and coefficients.method in method_ids()


def tiles_of(coefficients: CoefficientMap, surface: Surface, memory: int = TILE_BYTES) -> Iterator[Functions]:
    """Yield the functions of a map's vertices from first to last, in tiles that take so many bytes to light."""
    height, width, channel = coefficients.image_shape
    n_coeff = coefficients.n_coeff
    hemispherical = is_hemispherical(coefficients)
    wide = coefficient_count(seen_degree(coefficients.degree)) if hemispherical else n_coeff
    step = max(1, memory // (width * 8 * 3 * (4 * wide + n_coeff)))
    frames_v33 = None if surface.tangents_v3 is None else surface.frames()
    for first, end in row_tiles((0, height), step):
        rows_khwc = coefficients.read_rows(first, end, np.empty((n_coeff, end - first, width, channel), np.float32))
        held = slice(first * width, end * width)
        yield Functions(
            rows_khwc.reshape(n_coeff, -1, channel),
            surface.vertices_v3[held],
            None if frames_v33 is None else frames_v33[held],
            hemispherical,
        )


def shade_vertices(
    coefficients: CoefficientMap,
    sources: Sequence[Source],
    *,
    surface: Surface | None = None,
    memory: int = TILE_BYTES,
) -> NDArray[np.float32]:
    """Return the radiance that each vertex reflects under several lights together, (n_vertex, channel) float32.

    Parameters
    ----------
    coefficients : CoefficientMap
        With `surface`, or given one beside it; its functions take the direction to the light.
    sources : sequence of Source
        `DistantLight`, `DirectionalLight`, and those of `point_lights`, `area_lights` and `local_lights`.
    surface : Surface, optional
        Where the map has none.
    memory : int
        Bytes that are held beside the map and the result.
    """
    mesh = surface_of(coefficients, surface)
    if mesh.argument != "light":
        raise InputError("functions of the direction to the eye are for one fixed light: they take no other")
    if not sources:
        raise InputError("shading needs one light or more, got none")
    tiles = tiles_of(coefficients, mesh, memory)
    return np.concatenate([shade_by(sources, functions).astype(np.float32) for functions in tiles])


def surface_of(coefficients: CoefficientMap, surface: Surface | None = None) -> Surface:
    """Return the surface of a map, the given one where the map has none; InputError where there is none that fits."""
    mesh = coefficients.surface or surface
    if mesh is None:
        raise InputError("the map holds no surface: say whose functions it has (--mesh MESH)")
    if mesh.map_shape != coefficients.image_shape[:2] and mesh.n_vertex != np.prod(coefficients.image_shape[:2]):
        height, width = coefficients.image_shape[:2]
        raise InputError(
            f"the mesh has {mesh.n_vertex} vertices, the map {height * width} functions ({height}×{width})"
        )
    return mesh


def shade_views(
    coefficients: CoefficientMap, eyes_v3: NDArray[np.float64], *, surface: Surface | None = None
) -> NDArray[np.float32]:
    """Return the radiance that vertices send in directions of their own, (n_vertex, channel) float32.

    Parameters
    ----------
    coefficients : CoefficientMap
        Functions of the direction to the eye.
    eyes_v3 : ndarray, shape (n_vertex, 3), float64
        Unit vectors to the eye, in the axes of the positions.
    surface : Surface, optional
        Where the map has none.
    """
    mesh, first, parts = surface_of(coefficients, surface), 0, []
    for functions in tiles_of(coefficients, mesh):
        count = len(functions.points_n3)
        parts.append(send(functions, eyes_v3[first : first + count]).astype(np.float32))
        first += count
    return np.concatenate(parts)


def send(functions: Functions, eyes_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return functions of the direction to the eye at these directions, (n, channel).

    Directions below a horizon, under which a vertex at an outline sees the eye, are taken as at the horizon.
    """
    if not functions.hemispherical or functions.frames_n33 is None:
        return functions.evaluate(eyes_n3)
    normals_n3 = functions.frames_n33[:, 2]
    height_n = np.einsum("na,na->n", eyes_n3, normals_n3)[:, None]
    level_n3 = eyes_n3 - np.minimum(height_n, 0.0) * normals_n3
    length_n = np.linalg.norm(level_n3, axis=1, keepdims=True)
    level_n3 = np.where(length_n > 0.0, level_n3 / np.where(length_n > 0.0, length_n, 1.0), normals_n3)
    raised_n3 = np.where(height_n < 0.0, level_n3 + 1e-9 * normals_n3, eyes_n3)
    return functions.evaluate(raised_n3)


def shade_recoloured(
    coefficients: CoefficientMap, light: Light, colours_vc: NDArray, *, degree: int = 1, surface: Surface | None = None
) -> NDArray[np.float32]:
    """Return a map of one channel in colours that are chosen afterwards, (n_vertex, 3) float32.

    ``colour_vc sum_k T_kv L_kc`` with the coefficients up to `degree` alone: four of them where that is 1
    (spherical-harmonic-lighting, section Rendering SH Diffuse Surfaces).

    Parameters
    ----------
    coefficients : CoefficientMap
        Of one channel: shadows of a white surface, without light from surface to surface.
    light : Light
    colours_vc : ndarray, shape (3,) or (n_vertex, 3)
        Reflectance of all vertices, or of each.
    degree : int
    surface : Surface, optional
        Where the map has none.
    """
    if coefficients.image_shape[2] != 1:
        raise InputError(f"recolouring takes a map of 1 channel, got {coefficients.image_shape[2]}")
    colours = np.asarray(colours_vc, np.float32)
    n_vertex = surface_of(coefficients, surface).n_vertex
    if colours.shape not in ((3,), (n_vertex, 3)) or not (colours >= 0).all():
        raise InputError(
            f"colours must be 3 numbers not below 0, or {n_vertex} rows of them, got shape {colours.shape}"
        )
    return colours * shade_vertices(cut_degree(coefficients, degree), [DistantLight(light)], surface=surface)


def cut_degree(coefficients: CoefficientMap, degree: int) -> CoefficientMap:
    """Return a map without the coefficients above a degree; InputError where it is not of that degree."""
    if not 0 <= degree <= coefficients.degree:
        raise InputError(f"the map is of degree {coefficients.degree}, it cannot be cut to {degree}")
    held = coefficients.to_float32().coeffs_khwc[: coefficient_count(degree)]
    return replace(coefficients, coeffs_khwc=held, degree=degree)
