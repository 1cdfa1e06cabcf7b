"""What pictures of surfaces are made of: a map and its surface, lights of any kind, backgrounds."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.index import degree_of
from clrelight.jobs.inputs import FittedLike, Packed, decoded_of, lend_fitted, opened_on
from clrelight.jobs.report import Progress, Report
from clrelight.jobs.surface.meshes import frame_as_made, is_mesh_file, take_surface_of
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light
from clrelight.lighting.lookup import look_up
from clrelight.lighting.projection import project_environment
from clrelight.store import read_light
from clrelight.surface import Surface
from clrelight.transfer.painting import Background
from clrelight.transfer.sources import DirectionalLight, DistantLight, Source, sum_lights
from clrelight.transfer.texels import texel_surface

LightMaker = Callable[[int], Light]
"""Makes a light of a degree."""

LightLike = Any
"""Three numbers, a `Light`, the path of one, an `Environment`, a `Source`, or a `LightMaker`."""

BACKGROUNDS = ("black", "transparent", "environment")


@contextmanager
def lend_map(
    source: FittedLike, device: Device | str | None, report: Report, progress: Progress | None
) -> Iterator[CoefficientMap]:
    """Lend the coefficients of a fit, or of an encoding after decoding, which alone needs a device."""
    since = time.perf_counter()
    with lend_fitted(source, report) as held:
        report.add("read", since)
        if not isinstance(held, Packed):
            yield decoded_of(held, source, None, report, progress)  # type: ignore[arg-type]  # none decodes it
            return
        with opened_on(device, report) as opened:
            yield decoded_of(held, source, opened, report, progress)


def surface_for(
    coefficients: CoefficientMap, mesh: Surface | str | os.PathLike[str] | None, up: str | None, report: Report
) -> tuple[Surface, Surface | None]:
    """Return the surface of a map, or the one given beside it, and the mesh that wears the map as a texture, if any.

    What is to be said of the mesh's file is noted. `up` is that of `read_mesh`.
    """
    own, (height, width) = coefficients.surface, coefficients.image_shape[:2]
    if up is not None and (mesh is None or isinstance(mesh, Surface)):
        raise InputError("--mesh-up is for the file that --mesh names")
    if mesh is None:
        if own is None:
            raise InputError("the map holds no surface: say whose functions it has by --mesh (mesh file, fit or stack)")
        return own, None
    if up is not None and not is_mesh_file(mesh):
        raise InputError("--mesh-up is for mesh files: fits and stacks hold their surface as it stands")
    surface = take_surface_of(coefficients.config, mesh, up=up)
    report.note(*surface.notes)
    worn = surface.texture_v2 is not None and surface.n_vertex != height * width and width > 1
    if own is not None:
        if not (worn and own.grid is not None):
            raise InputError("the map holds its surface: leave out --mesh, unless it wears the map as a texture")
        return own, surface
    if worn:
        return frame_as_made(coefficients.config, texel_surface(surface, height, width)), surface
    if surface.n_vertex != height * width:
        raise InputError(
            f"{surface.name}: the mesh has {surface.n_vertex} vertices, the map {height * width} functions "
            f"({height}×{width}): give the mesh that it was made of"
        )
    # A map of several columns says that the vertices are a grid, which mesh files do not.
    gridded = surface if surface.map_shape == (height, width) else replace(surface, grid=(height, width))
    return frame_as_made(coefficients.config, gridded), None


def sources_of(light: LightLike, degree: int, report: Report) -> list[Source]:
    """Return lights of any kind as those that surfaces take.

    Parameters
    ----------
    light : LightLike or a sequence of them
        None: no light.
    degree : int
        To which those are made that are of no degree yet.
    report : Report
        Gets a note where an environment is projected to more than it resolves.
    """
    if light is None:
        return []
    if isinstance(light, list | tuple) and not _is_numbers(light):
        return [source for each in light for source in sources_of(each, degree, report)]
    if isinstance(light, Light):
        return [DistantLight(light)]
    if isinstance(light, str | os.PathLike):
        return [DistantLight(read_light(light))]
    if isinstance(light, Environment):
        since = time.perf_counter()
        made = project_environment(light, min(degree, MAX_DEGREE))
        report.add("project", since)
        return [DistantLight(made)]
    if _is_numbers(light):
        return [DirectionalLight(tuple(float(v) for v in np.asarray(light)))]
    if hasattr(light, "shade") and hasattr(light, "is_distant"):
        return [light]
    if callable(light):
        return [DistantLight(light(min(degree, MAX_DEGREE)))]
    raise InputError(
        "a light is three numbers, a Light or the path of one, an Environment, a PointLight, SphereLight, PolygonLight "
        f"or LocalLights, got {type(light).__name__}"
    )


def _is_numbers(light: object) -> bool:
    try:
        held = np.asarray(light)
    except ValueError:
        return False
    return held.shape == (3,) and held.dtype.kind in "fiu"


def background_of(
    wanted: str | Sequence[float], light: LightLike, sources: Sequence[Source]
) -> tuple[Background | None, bool]:
    """Return the radiance behind a surface (None: none), and whether the picture has alpha."""
    if not isinstance(wanted, str):
        colour_c = np.asarray(wanted, np.float64)
        if colour_c.shape not in ((1,), (3,)) or not (np.isfinite(colour_c).all() and (colour_c >= 0.0).all()):
            raise InputError(f"a background colour is 1 or 3 finite numbers that are not negative, got {wanted}")
        return lambda directions_n3: np.broadcast_to(colour_c, (len(directions_n3), len(colour_c))), False
    if wanted not in BACKGROUNDS:
        raise InputError(f"a background is one of {', '.join(BACKGROUNDS)}, or 1 or 3 numbers, got {wanted!r}")
    if wanted != "environment":
        return None, wanted == "transparent"
    maps = [each for each in (light if isinstance(light, list | tuple) else [light]) if isinstance(each, Environment)]
    distant = [source.light for source in sources if isinstance(source, DistantLight)]
    if len(maps) == 1 and len(distant) == 1:
        return lambda directions_n3: look_up(maps[0], directions_n3), False
    if not distant:
        raise InputError("a background environment needs light from everywhere: an environment, sky or light file")
    coeffs_kc = sum_lights(distant)
    return lambda directions_n3: _evaluate(coeffs_kc, directions_n3), False


def _evaluate(coeffs_kc: NDArray[np.float64], directions_n3: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.maximum(evaluate_basis(directions_n3, degree_of(len(coeffs_kc))) @ coeffs_kc, 0.0)
