"""Reflection maps of an environment or a light and a reflectance, as files; and spheres as these show them."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import BrdfCoefficients, brdf_coefficients
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.jobs.inputs import opened_on, path_text, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.pictures import (
    check_animation,
    holds_floats,
    is_animation,
    name_pictures,
    show,
    write_animation,
    write_view,
)
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light
from clrelight.lighting.projection import is_separable, project_environment
from clrelight.lighting.relighting import TONEMAPS, automatic_exposure
from clrelight.shrm.explicit import explicit_maps
from clrelight.shrm.lookup import look_up, view_sphere
from clrelight.shrm.orders import sufficient_coefficients
from clrelight.shrm.prefilter import build_shrm, to_global
from clrelight.shrm.record import Shrm
from clrelight.store import read_light, read_shrm, write_shrm

SAMPLES_PER_DEGREE = 10
"""Rows of a map for each degree F (frequency-space-environment-maps, 5.2)."""

_FEWEST_ROWS = 16
_MAPS_AT_ONCE = 1 << 24
"""Bytes of dynamic maps that are made together."""

LightLike = Environment | Light | str | os.PathLike[str]


def build_reflection(
    source: LightLike,
    brdf: CentredBrdf,
    out: str | os.PathLike[str] | None = None,
    *,
    epsilon: float | None = None,
    degree: int | None = None,
    order: int | None = None,
    rows: int | None = None,
    frame: str = "global",
    method: str = "device",
    device: Device | str | None = None,
    report: Report | None = None,
) -> Shrm:
    """Return the reflection map of a light and a reflectance, float32; written where `out` is given.

    Parameters
    ----------
    source : Environment, Light or path of a light file
    brdf : CentredBrdf
    out : path, optional
    epsilon : float, optional
        Part of the reflectance's energy that may be left out: the least orders are taken; 0.03 by default.
    degree, order : int, optional
        F and P instead.
    rows : int, optional
        By default ten for each degree, 16 at least; columns are twice as many.
    frame : str
        ``"global"`` or ``"local"``, see `shrm.record.FRAMES`.
    method : str
        One of `shrm.expansion.METHODS`: ``"device"`` also sums the azimuths of a lat-long map there.
    device : Device or str, optional
        Of the direct projection of maps, and of method ``"device"``.
    report : Report, optional

    Raises
    ------
    InputError
        If orders do not suffice, exceed what the map or the light holds, or `out` cannot be written.
    """
    kept = report_for(report)
    if (degree is None) != (order is None) or (epsilon is not None and degree is not None):
        raise InputError("give orders F and P, both of them, or epsilon")
    with claimed([out], paths_among(source), kept), opened_on(device, kept) as opened:
        since = time.perf_counter()
        chosen = _coefficients(brdf, epsilon, degree, order)
        since = kept.add("reflectance", since)
        light = _light_of(source, chosen.degree, method, opened)
        since = kept.add("project", since)
        count = rows or max(_FEWEST_ROWS, SAMPLES_PER_DEGREE * chosen.degree)
        made = build_shrm(light, chosen, count, frame=frame, method=method, dtype=np.float32, device=opened)
        since = kept.add("prefilter", since)
        if out is not None:
            write_shrm(out, made)
            kept.add("write", since)
    share = float(chosen.shares()[-1, -1].min())
    kept.facts = {"file": out, "degree": made.degree, "order": made.order, "rows": count, "columns": 2 * count}
    kept.facts |= {"channels": made.channels, "frame": frame, "centre": made.centre, "config": dict(made.config)}
    kept.facts |= {"share": share, "bytes": made.maps_khwc.nbytes}
    return made


def _coefficients(brdf: CentredBrdf, epsilon: float | None, degree: int | None, order: int | None) -> BrdfCoefficients:
    if degree is None or order is None:
        return sufficient_coefficients(brdf, 0.03 if epsilon is None else epsilon)
    return brdf_coefficients(brdf, degree, order)


def _light_of(source: LightLike, degree: int, method: str, device: Device) -> Light:
    """Return the light to a degree; InputError where the source does not hold it."""
    if isinstance(source, Environment):
        if degree > source.resolved_degree:
            raise InputError(
                f"the map is fine enough for degree {source.resolved_degree}, F = {degree} is asked for: "
                "take a finer map, a smaller degree or a larger epsilon"
            )
        how = "separable-device" if method == "device" and is_separable(source) else "auto"
        return project_environment(source, degree, method=how, device=device)
    light = source if isinstance(source, Light) else read_light(source)
    if degree > light.degree:
        raise InputError(f"the light has degree {light.degree}, F = {degree} is asked for")
    return light


def render_reflection(
    source: Shrm | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    view: Sequence[float] = (0.0, -1.0, 0.3),
    size: int = 256,
    rotate: tuple[str, Sequence[float]] | float | None = None,
    turntable: int | None = None,
    exposure: float | None = 0.0,
    tonemap: str | None = None,
    transfer: str = "srgb",
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Write a sphere as a reflection map shows it, or many while the light goes round once.

    One dynamic map a picture (frequency-space-environment-maps, eq. 12), looked up at every pixel's direction.

    Parameters
    ----------
    source : Shrm or path
    out : path
        Floats (.exr, .hdr, .tif), 8-bit pictures, or a .gif; several need a number field such as ``%03d``.
    view : three numbers
        Towards the camera.
    size : int
        Pixels of a side.
    rotate : float or (str, numbers), optional
        Turn the light: degrees about z, or a form and numbers of `harmonics.rotation.rotation_matrix`.
    turntable : int, optional
        So many pictures, the light going round about z once.
    exposure : float, optional
        Stops; None for automatic.
    tonemap : str, optional
        Of 8-bit pictures, see `lighting.relighting.TONEMAPS`.
    transfer : str
        Curve of 8-bit pictures.
    """
    kept = report_for(report)
    target = path_text(out, "an image to write")
    if tonemap is not None and tonemap not in TONEMAPS:
        raise InputError(f"tone mapping must be one of {', '.join(TONEMAPS)}, got {tonemap!r}")
    if turntable is not None and turntable < 1:
        raise InputError(f"a turntable has 1 picture at least, got {turntable}")
    if is_animation(target):
        check_animation()
    count = turntable or 1
    names = [target] if is_animation(target) else name_pictures(target, count)
    turned = rotation_of(rotate)
    with claimed(names, paths_among(source), kept):
        since = time.perf_counter()
        shrm = to_global(source if isinstance(source, Shrm) else read_shrm(source))
        sphere = view_sphere(size, np.asarray(view, np.float64), shrm.centre)
        since = kept.add("read", since)
        frames, stops = [], exposure
        with stage(progress, "rendering") as tell:
            turns_i33 = np.stack([rotation_matrix("axis", (0, 0, 1, 360.0 * i / count)) @ turned for i in range(count)])
            # Light turned by R is what a view turned back sees: one product makes the maps of many views.
            step = max(1, _MAPS_AT_ONCE // shrm.maps_khwc[0].nbytes)
            for first in range(0, count, step):
                backs_i33 = turns_i33[first : first + step]
                for back, map_hwc in zip(backs_i33, explicit_maps(shrm, sphere.view_3 @ backs_i33), strict=True):
                    frames.append(sphere.picture(look_up(map_hwc, sphere.central_n3 @ back)).astype(np.float32))
                    tell(len(frames), count)
        since = kept.add("render", since)
        stops = automatic_exposure(frames[0]) if stops is None else stops
        _write(names, frames, 2.0**stops, tonemap, transfer)
        kept.add("write", since)
    kept.facts = {"files": names, "size": size, "degree": shrm.degree, "order": shrm.order, "exposure": stops}
    return kept


def rotation_of(rotate: tuple[str, Sequence[float]] | float | None) -> NDArray[np.float64]:
    """Return the matrix of degrees about z, or of a form and numbers of `harmonics.rotation.rotation_matrix`."""
    if rotate is None:
        return np.eye(3)
    if isinstance(rotate, int | float):
        return rotation_matrix("axis", (0.0, 0.0, 1.0, float(rotate)))
    return rotation_matrix(*rotate)


def _write(
    names: list[str], frames: list[NDArray[np.float32]], scale: float, tonemap: str | None, transfer: str
) -> None:
    scaled = [np.float32(scale) * frame for frame in frames]
    if is_animation(names[0]):
        write_animation(names[0], [show(frame, tonemap, transfer) for frame in scaled])
        return
    for name, frame in zip(names, scaled, strict=True):
        if tonemap is not None and holds_floats(name):
            raise InputError(f"--tonemap is for 8-bit files, but {name} holds linear radiance: leave it out")
        write_view(name, frame, tonemap, transfer)
