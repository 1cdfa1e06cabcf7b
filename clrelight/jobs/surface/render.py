"""Pictures of a surface whose vertices carry functions, under any light, from anywhere."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import is_dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.jobs.frames import Rotation
from clrelight.jobs.inputs import FittedLike, path_text, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for
from clrelight.jobs.surface.frames import SurfaceFrames, colour_of, place_camera, turn_background, turn_sources
from clrelight.jobs.surface.inputs import LightLike, background_of, lend_map, sources_of, surface_for
from clrelight.jobs.surface.pictures import Showing, numbers_to_make, picture_names
from clrelight.jobs.unfinished import seen_inputs, unfinished_images
from clrelight.jobs.written import count_bytes, count_stops
from clrelight.memory import DEFAULT_MEMORY
from clrelight.surface import Surface
from clrelight.transfer.cameras import Camera, Framing, picture_size
from clrelight.transfer.lit_functions import seen_degree
from clrelight.transfer.painting import Painter
from clrelight.transfer.reflection import OPERATOR, operator_degrees, reflect_map
from clrelight.transfer.shading import cut_degree, is_hemispherical, surface_of
from clrelight.transfer.sources import DistantLight, Source, sum_lights
from clrelight.transfer.views import MAX_SUBSAMPLES, SUBSAMPLES


def render(
    source: FittedLike,
    light: LightLike = None,
    *,
    out: str | os.PathLike[str] | None = None,
    mesh: Surface | str | os.PathLike[str] | None = None,
    mesh_up: str | None = None,
    camera: Camera | Framing | Sequence[float] | None = None,
    size: int | Sequence[int] = 512,
    subsamples: int = SUBSAMPLES,
    shading: str = "vertex",
    background: str | Sequence[float] = "black",
    exposure: float | str = 0.0,
    rotate: Rotation | None = None,
    turntable: int | None = None,
    turns: str = "view",
    about: Sequence[float] | None = None,
    tonemap: str | None = None,
    transfer: str = "srgb",
    degree: int | None = None,
    recolour: ArrayLike | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> NDArray[np.float32] | Report:
    """Return, or write, pictures of a surface whose vertices carry functions.

    Parameters
    ----------
    source : path, URL, CoefficientMap or Encoded
        A map of functions of a surface's vertices: of the direction to the light, or to the eye under a fixed light.
    light : LightLike or a list of them, optional
        They shine together: directions (three numbers), a `Light` or the path of a light file, an `Environment`, a
        `PointLight`, `SphereLight`, `PolygonLight` or `LocalLights`, or a function that makes a `Light` of a degree.
        None for functions of the direction to the eye.
    out : path, optional
        Where to write; the name decides as of `relight`.
    mesh : path or Surface, optional
        Where the map holds no surface: a mesh file, a fit or stack of ours that holds one. Or a mesh with texture
        coordinates that wears the map as its texture.
    mesh_up : str, optional
        The axis of the mesh's file that points up, as `transfer` was told: ``"y"`` or ``"z"``.
    camera : Camera, Framing or three numbers, optional
        Numbers: from the surface to the eye, at the distance from which it is seen whole. Default: (1, -2, 1).
    size : int or two ints
        Width and height of a picture, one number being both.
    subsamples : int
        Rays of a pixel are its square.
    shading : str
        ``"vertex"``: radiance of vertices is interpolated (Gouraud). ``"pixel"``: functions are evaluated at each ray,
        towards lights and eye as it has them; a parameter grid is read as a texture.
    background : str or 1 or 3 numbers
        ``"black"``, ``"transparent"`` (alpha), ``"environment"`` (the light from everywhere), or radiance.
    exposure, tonemap, rotate
        As of `relight`.
    turntable : int, optional
        So many pictures of one time round.
    turns : str
        ``"view"``: the camera goes round; ``"light"``: light from everywhere and from directions does.
    about : three numbers, optional
        Axis of the turntable, through the middle of the surface; default: z.
    transfer : str
        ``"srgb"`` or ``"linear"``: curve of 8-bit files.
    degree : int, optional
        Leave out coefficients above it.
    recolour : three numbers, optional
        Of a map of one channel: colour of the surface.
    memory : int or str
        Bytes that are held beside the map and the picture.
    device : Device or str, optional
        Decodes encoded files.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings.

    Returns
    -------
    ndarray, float32
        Linear radiance, (height, width, channel), for a turntable (n, height, width, channel); with a transparent
        background alpha is the last channel, and the others are multiplied by it. With `out` instead the report.

    Raises
    ------
    InputError
        If there is no surface, the mesh is another one's, the camera sees nothing, or an option does not fit.
    """
    target = None if out is None else path_text(out, "an image to write")
    shown = Showing(count_stops(exposure), tonemap, transfer)
    shown.check(target)
    frames = SurfaceFrames.asked(turntable, turns, about)
    kept = report_for(report)
    names = picture_names(target, frames.count, background == "transparent")
    held = count_bytes(memory)
    inputs = paths_among(source, mesh, *(light if isinstance(light, list | tuple) else [light]))
    seen = seen_inputs([source])
    with claimed(names, inputs, kept), lend_map(source, device, kept, progress) as given:
        surface, body = surface_for(given, mesh, mesh_up, kept)
        coefficients = _prepare(given, surface, degree, shading)
        unturned = sources_of(light, _light_degree(coefficients), kept)
        sources = turn_sources(unturned, rotate)
        if coefficients.method == OPERATOR:
            surface, coefficients, sources = *_reflected(coefficients, sources, degree), []
        behind, has_alpha = background_of(background, light, unturned)
        behind = turn_background(behind, rotate)
        painter = Painter(coefficients, surface, picture_size(size), _checked(subsamples), shading, held, body)
        placed = place_camera(camera, body or surface, picture_size(size), frames)
        colour_c = colour_of(recolour, coefficients)
        asked = [shown, frames, unturned, rotate, surface, body, placed, size, subsamples, shading, held, background]
        known = seen if all(map(is_dataclass, unturned)) else None  # others may change unseen
        unfinished = unfinished_images(names, known, ["render", *asked, colour_c, degree, kept.device])
        numbers = numbers_to_make(unfinished, frames.count, kept)
        pictures = frames.paint(painter, sources, placed, behind, colour_c, kept, numbers)
        images_ihwc = shown.show(pictures, names, numbers, has_alpha, kept, progress, unfinished)
    if target is not None:
        kept.facts = {"files": names, **kept.facts, **_facts(coefficients, surface, placed)}
        return kept
    return images_ihwc if frames.is_turntable else images_ihwc[0]


def _light_degree(coefficients: CoefficientMap) -> int:
    """Return the degree up to which light has an effect."""
    if coefficients.method == OPERATOR:
        return operator_degrees(coefficients)[0]
    return seen_degree(coefficients.degree) if is_hemispherical(coefficients) else coefficients.degree


def _reflected(
    operators: CoefficientMap, sources: Sequence[Source], degree: int | None
) -> tuple[Surface, CoefficientMap]:
    """Return a surface and its functions of the direction to the eye, made of operators under distant light."""
    lights = [source.light for source in sources if isinstance(source, DistantLight)]
    if not lights or len(lights) < len(sources):
        raise InputError("operators take light from everywhere: light files, environments, skies and caps")
    if degree is not None:
        raise InputError("--degree cuts functions; operators have two degrees")
    made = reflect_map(operators, sum_lights(lights))
    return surface_of(made), made


def _prepare(given: CoefficientMap, surface: Surface, degree: int | None, shading: str) -> CoefficientMap:
    """Return the map on its surface, cut to a degree, and in memory where that is needed."""
    coefficients = replace(given, surface=surface)
    coefficients = coefficients if degree is None or given.method == OPERATOR else cut_degree(coefficients, degree)
    return coefficients.to_float32() if shading == "pixel" else coefficients


def _checked(subsamples: int) -> int:
    if not 1 <= whole(subsamples, "subsamples") <= MAX_SUBSAMPLES:
        raise InputError(f"subsamples must be 1 to {MAX_SUBSAMPLES}, got {subsamples}")
    return int(subsamples)


def _facts(coefficients: CoefficientMap, surface: Surface, camera: Camera) -> dict[str, object]:
    placed = {"eye": camera.eye_3, "target": camera.target_3, "up": camera.up_3, "height": camera.height}
    return {
        "vertices": surface.n_vertex,
        "faces": len(surface.faces_f3),
        "degree": coefficients.degree,
        "camera": {**placed, "field_of_view": camera.field_of_view},
    }
