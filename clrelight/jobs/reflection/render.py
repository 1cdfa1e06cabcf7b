"""Spheres and meshes as a reflection map shows them, from anywhere, while the light or the view goes round."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.jobs.frames import Rotation
from clrelight.jobs.inputs import path_text, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for
from clrelight.jobs.surface.frames import Placed, SurfaceFrames, place_camera, rotation_of, turn_background
from clrelight.jobs.surface.inputs import background_of, sources_of
from clrelight.jobs.surface.meshes import MeshLike, take_surface
from clrelight.jobs.surface.pictures import Showing, numbers_to_make, picture_names
from clrelight.jobs.unfinished import Input, seen_inputs, unfinished_images
from clrelight.jobs.written import count_bytes, count_stops
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light
from clrelight.lighting.lookup import look_up
from clrelight.memory import DEFAULT_MEMORY, PIECE_BYTES
from clrelight.shrm.painting import Clock, Mesh, Sphere, distant_view
from clrelight.shrm.prefilter import to_global
from clrelight.shrm.record import Shrm
from clrelight.store import read_shrm
from clrelight.surface import Surface
from clrelight.transfer.cameras import Camera, Framing, middle_of, picture_size
from clrelight.transfer.painting import Background
from clrelight.transfer.views import MAX_SUBSAMPLES, SUBSAMPLES

VIEW = (0.0, -1.0, 0.3)
"""Towards the camera of a sphere, where nobody says otherwise."""

PAPER_TEXELS, PAPER_RATE = 6 * 64 * 64, 30.0
"""Texels of the paper's dynamic maps, and how many of them it made a second (frequency-space-environment-maps, 7.5)."""


def render_reflection(
    source: Shrm | str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    mesh: MeshLike | None = None,
    mesh_up: str | None = None,
    camera: Camera | Framing | Sequence[float] | None = None,
    view: Sequence[float] | None = None,
    views: str = "distant",
    size: int | Sequence[int] = 256,
    subsamples: int = SUBSAMPLES,
    background: str | Sequence[float] = "black",
    environment: Environment | Light | str | os.PathLike[str] | None = None,
    rotate: Rotation | None = None,
    turntable: int | None = None,
    turns: str = "light",
    about: Sequence[float] | None = None,
    exposure: float | str | None = 0.0,
    tonemap: str | None = None,
    transfer: str = "srgb",
    memory: int | str = DEFAULT_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
) -> NDArray[np.float32] | Report:
    """Return, or write, a sphere or a mesh as a reflection map shows it; many while light or view go round once.

    One dynamic map a picture (frequency-space-environment-maps, eq. 12), looked up in every pixel's own central
    direction. Light that turns leaves the reflection map as it is.

    Parameters
    ----------
    source : Shrm or path
    out : path, optional
        Floats (.exr, .hdr, .tif), 8-bit pictures, or a .gif or .apng; several need a number field such as ``%03d``.
    mesh : path or Surface, optional
        A mesh file, or a fit or stack that holds a surface; default: a sphere.
    mesh_up : str, optional
        The axis of the mesh's file that points up: ``"y"`` or ``"z"``.
    camera : Camera, Framing or three numbers, optional
        Of a mesh, as of `render`.
    view : three numbers, optional
        Of a sphere: towards the camera; default `VIEW`.
    views : str
        ``"distant"``: coefficients of one view count for the picture; ``"pixel"``: each pixel's own, which perspective
        differs in, at the cost of a lookup for each coefficient.
    size : int or two ints
        Width and height; a sphere's are equal.
    subsamples : int
        Of a mesh: rays of a pixel are its square.
    background : str or 1 or 3 numbers
        ``"black"``, ``"transparent"``, ``"environment"`` or radiance.
    environment : Environment, Light or path of a light file, optional
        What lies behind: in the axes of the reflection map's own.
    rotate : float or (str, numbers), optional
        Turn the light: degrees about z, or a form and numbers of `harmonics.rotation.rotation_matrix`.
    turntable : int, optional
        So many pictures of one time round.
    turns : str
        ``"light"`` or ``"view"``: what goes round.
    about : three numbers, optional
        Axis of the turntable; default: z.
    exposure : float, optional
        Stops; None or ``"auto"`` for automatic.
    tonemap, transfer, memory, progress, report
        As of `render`.

    Returns
    -------
    ndarray, float32
        As of `render`; with `out` the report, whose ``maps_a_second`` are dynamic maps of `PAPER_TEXELS` texels.

    Raises
    ------
    InputError
        If an option does not fit, or the camera sees nothing.
    """
    target = None if out is None else path_text(out, "an image to write")
    shown = Showing(None if exposure is None else count_stops(exposure), tonemap, transfer)
    shown.check(target)
    frames = SurfaceFrames.asked(turntable, turns, about)
    kept = report_for(report)
    names = picture_names(target, frames.count, background == "transparent")
    sides, held, clock = picture_size(size), count_bytes(memory), Clock()
    behind, has_alpha = _background(background, environment, kept)
    seen = _seen(source, environment)
    with claimed(names, paths_among(source, mesh, environment), kept):
        since = time.perf_counter()
        shrm = source if isinstance(source, Shrm) else read_shrm(source)
        shrm = shrm if shrm.frame == "zonal" else to_global(shrm)
        subject: Sphere | Mesh
        if mesh is None:
            placed, subject = _sphere(sides, view, camera, mesh_up, views, clock)
            surface, middle_3 = None, np.zeros(3)
        else:
            if view is not None:
                raise InputError("a view is for spheres: say from where a mesh is seen by a camera (--from)")
            surface = take_surface(mesh, up=mesh_up)
            kept.note(*surface.notes)
            subject = Mesh(surface, sides, _checked(subsamples), views, held, clock)
            placed, middle_3 = place_camera(camera, surface, sides, frames), middle_of(surface)
        kept.add("read", since)
        asked = [shown, frames, surface, placed, sides, subsamples, views, held, background, environment, rotate]
        unfinished = unfinished_images(names, seen, ["shrm render", *asked])
        numbers = numbers_to_make(unfinished, frames.count, kept, _together(shrm))
        steps = _steps(frames, placed, middle_3, rotate, behind, numbers)
        pictures = _paint(subject, shrm, steps, kept)
        images_ihwc = shown.show(pictures, names, numbers, has_alpha, kept, progress, unfinished)
    facts = _facts(sides, surface, placed, len(numbers) / max(kept.seconds.get("render", 0.0), 1e-9), clock)
    kept.facts = {"files": names, "degree": shrm.degree, "order": shrm.order, **kept.facts, **facts}
    if target is not None:
        return kept
    return images_ihwc if frames.is_turntable else images_ihwc[0]


def _seen(source: Shrm | str | os.PathLike[str], environment: object) -> list[Input] | None:
    """Return what files look like, before they are read; None where something may change unseen."""
    if isinstance(source, Shrm) or callable(environment):
        return None
    return seen_inputs([source, *paths_among(environment)])


def _sphere(
    sides: tuple[int, int],
    view: Sequence[float] | None,
    camera: object,
    mesh_up: str | None,
    views: str,
    clock: Clock,
) -> tuple[Camera, Sphere]:
    if camera is not None or mesh_up is not None or views != "distant":
        raise InputError("cameras, --mesh-up and --views are for meshes: a sphere is seen from afar, from --view")
    if sides[0] != sides[1]:
        raise InputError(f"a sphere fills a square, got {sides[0]} × {sides[1]} pixels")
    sphere = Sphere(sides[0], clock)
    return sphere.camera(np.asarray(VIEW if view is None else view, np.float64)), sphere


@dataclass(frozen=True)
class _Step:
    """One picture: its camera, the turn of its light, and what lies behind it."""

    camera: Camera
    turn: NDArray[np.float64]
    behind: Background | None


def _steps(
    frames: SurfaceFrames,
    camera: Camera,
    middle_3: NDArray[np.float64],
    rotate: Rotation | None,
    behind: Background | None,
    numbers: Sequence[int],
) -> Iterator[_Step]:
    turned = np.eye(3) if rotate is None else rotation_of(rotate)
    behind = turn_background(behind, rotate)
    for step in numbers:
        turn = ("axis", (*frames.axis, 360.0 * step / frames.count))
        if not step:
            yield _Step(camera, turned, behind)
        elif frames.turns == "light":
            yield _Step(camera, rotation_of(turn) @ turned, turn_background(behind, turn))
        else:
            yield _Step(camera.turned(turn[1][-1], frames.axis, middle_3), turned, behind)


def _together(shrm: Shrm) -> int:
    """Return how many dynamic maps are made together: the last digits of one may hang on how many."""
    return max(1, PIECE_BYTES // shrm.maps_khwc[0].nbytes)


def _paint(subject: Sphere | Mesh, shrm: Shrm, steps: Iterator[_Step], report: Report) -> Iterator[Placed]:
    """Yield pictures, the camera of each, and what lies behind it; dynamic maps of many views are made together."""
    while batch := list(itertools.islice(steps, _together(shrm))):
        since = time.perf_counter()
        maps: list[NDArray[np.floating] | None] = [None] * len(batch)
        if not isinstance(subject, Mesh) or subject.views == "distant":
            views_i3 = np.stack([distant_view(each.camera, each.turn) for each in batch])
            maps = list(subject.clock.sum_maps(shrm, views_i3))
        for each, map_hwc in zip(batch, maps, strict=True):
            picture = subject.paint(shrm, each.camera, each.turn, map_hwc)
            report.add("render", since)
            if picture.behind > 0.0:
                report.note(f"{picture.behind:.1%} of what is seen is the inner side of the surface, which is black")
            yield picture, each.camera, each.behind
            since = time.perf_counter()


def _background(wanted: str | Sequence[float], light: Any, report: Report) -> tuple[Background | None, bool]:
    """Return the radiance behind a subject, and whether the picture has alpha."""
    if wanted != "environment":
        if light is not None:
            raise InputError("an environment (--env) is what --background environment shows")
        return background_of(wanted, None, [])
    if light is None:
        raise InputError("--background environment shows a map, which a reflection map no longer holds: give --env")
    if isinstance(light, Environment):
        return lambda directions_n3: look_up(light, directions_n3), False
    return background_of(wanted, light, sources_of(light, 0, report))


def _facts(
    sides: tuple[int, int], surface: Surface | None, camera: Camera, rate: float, clock: Clock
) -> dict[str, Any]:
    placed = {"eye": camera.eye_3, "target": camera.target_3, "field_of_view": camera.field_of_view}
    facts: dict[str, Any] = {"size": sides[0]}
    if surface is not None:
        facts = {"size": list(sides), "vertices": surface.n_vertex, "faces": len(surface.faces_f3)}
    facts |= {"camera": placed, "frames_a_second": rate}
    if clock.seconds:
        facts["maps_a_second"] = clock.rate(PAPER_TEXELS)
    return facts


def _checked(subsamples: int) -> int:
    if not 1 <= whole(subsamples, "subsamples") <= MAX_SUBSAMPLES:
        raise InputError(f"subsamples must be 1 to {MAX_SUBSAMPLES}, got {subsamples}")
    return int(subsamples)
