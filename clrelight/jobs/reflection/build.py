"""Reflection maps of an environment or a light and a reflectance, as files."""

from __future__ import annotations

import os
import time

import numpy as np

from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import BrdfCoefficients, brdf_coefficients
from clrelight.brdf.named import as_brdf
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.jobs.inputs import opened_on, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Report, report_for
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light
from clrelight.lighting.projection import is_separable, project_environment
from clrelight.shrm.orders import sufficient_coefficients
from clrelight.shrm.prefilter import build_shrm
from clrelight.shrm.record import Shrm
from clrelight.shrm.zonal import build_zonal
from clrelight.store import read_light, write_shrm

SAMPLES_PER_DEGREE = 10
"""Rows of a map for each degree F (frequency-space-environment-maps, 5.2)."""

METHOD = "device"
"""How orders become columns, where nobody says otherwise."""

_FEWEST_ROWS = 16

LightLike = Environment | Light | str | os.PathLike[str]


def build_reflection(
    source: LightLike,
    brdf: CentredBrdf | str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    epsilon: float | None = None,
    degree: int | None = None,
    order: int | None = None,
    rows: int | None = None,
    frame: str | None = None,
    method: str | None = None,
    device: Device | str | None = None,
    report: Report | None = None,
) -> Shrm:
    """Return the reflection map of a light and a reflectance, float32; written where `out` is given.

    Parameters
    ----------
    source : Environment, Light or path of a light file
    brdf : CentredBrdf, or a text as of `brdf.named.parse_brdf`
    out : path, optional
    epsilon : float, optional
        Part of the reflectance's energy that may be left out: the least orders are taken; 0.03 by default.
    degree, order : int, optional
        F and P instead.
    rows : int, optional
        By default ten for each degree, 16 at least; columns are twice as many.
    frame : str, optional
        One of `shrm.record.FRAMES`; by default ``"zonal"`` where the reflectance differs by the view's angle from the
        central direction but not by its azimuth (Kajiya and Kay's fibres), else ``"global"``. Another's coefficients
        of q > 0 are left out of zonal maps, which a note says.
    method : str, optional
        One of `shrm.expansion.METHODS`, of global and local maps, default `METHOD`: ``"device"`` also sums the azimuths
        of a lat-long map there. Zonal maps are made by ``"fft"``.
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
    brdf = as_brdf(brdf)
    with claimed([out], paths_among(source), kept), opened_on(device, kept) as opened:
        since = time.perf_counter()
        chosen = _coefficients(brdf, epsilon, degree, order)
        since = kept.add("reflectance", since)
        light = light_of(source, chosen.degree, opened, method or METHOD)
        since = kept.add("project", since)
        count = rows or max(_FEWEST_ROWS, SAMPLES_PER_DEGREE * chosen.degree)
        if frame is None:
            frame = "global" if brdf.has_azimuth or brdf.is_radial else "zonal"
        if frame == "zonal":
            made = _zonal(light, chosen, count, method, kept)
        else:
            how = method or METHOD
            made = build_shrm(light, chosen, count, frame=frame, method=how, dtype=np.float32, device=opened)
        since = kept.add("prefilter", since)
        if out is not None:
            write_shrm(out, made)
            kept.add("write", since)
    share = float(chosen.shares()[-1, -1].min())
    kept.facts = {"file": out, "degree": made.degree, "order": made.order, "rows": count, "columns": 2 * count}
    kept.facts |= {"channels": made.channels, "frame": frame, "centre": made.centre, "config": dict(made.config)}
    kept.facts |= {"share": share, "maps": len(made.maps_khwc), "bytes": made.maps_khwc.nbytes}
    return made


def _zonal(light: Light, chosen: BrdfCoefficients, rows: int, method: str | None, report: Report) -> Shrm:
    if method not in (None, "fft"):
        raise InputError(f"zonal reflection maps are made by fft, not {method}: ask for --frame global or local")
    if chosen.has_azimuth:
        alone = np.einsum("lpc->", chosen.rho_lpqc[:, :, 0] ** 2) / (chosen.shares()[-1, -1] @ chosen.energy_c)
        report.note(f"zonal maps hold {alone:.1%} of the energy of these orders: the rest differs by azimuth")
    return build_zonal(light, chosen, rows, dtype=np.float32)


def _coefficients(brdf: CentredBrdf, epsilon: float | None, degree: int | None, order: int | None) -> BrdfCoefficients:
    if degree is None or order is None:
        return sufficient_coefficients(brdf, 0.03 if epsilon is None else epsilon)
    return brdf_coefficients(brdf, degree, order)


def light_of(source: LightLike, degree: int, device: Device, method: str = METHOD) -> Light:
    """Return the light of a map, light or light file to a degree; InputError where the source does not hold it."""
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
