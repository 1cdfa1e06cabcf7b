"""What a glossy mesh reflects under a light, from its operators."""

from __future__ import annotations

import os
import time
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.jobs.inputs import FittedLike, lend_coefficients, opened_on, path_text, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.surface.meshes import MeshLike, frame_as_made, take_surface_of
from clrelight.lighting.light import Light
from clrelight.store import read_light, write_fit
from clrelight.transfer.reflection import reflect as reflect_towards
from clrelight.transfer.reflection import reflect_map


def reflect(
    operators: FittedLike,
    light: Light | str | os.PathLike[str],
    *,
    view: ArrayLike | None = None,
    out: str | os.PathLike[str] | None = None,
    mesh: MeshLike | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap | NDArray[np.float32] | Report:
    """Return what a glossy surface reflects under a light: towards an eye, or over all directions.

    Parameters
    ----------
    operators : path, CoefficientMap or Encoded
        Of `transfer_operators`, or encoded.
    light : Light or path
        In the axes of the mesh.
    view : array_like, shape (3,) or (n_vertex, 3), optional
        Directions from the surface to the eye, of any length. Radiance is returned, (height, width, channel) float32.
        Without it a map of coefficients over directions to the eye.
    out : path, optional
        A fit file to write the map to; a view is not for files.
    mesh : path or Surface, optional
        The surface of operators that are encoded, in the same order.
    device : Device or str, optional
        For decoding.
    progress, report
        As of other verbs.
    """
    kept = report_for(report)
    target = None if out is None else path_text(out, "a fit to write")
    if target is not None and view is not None:
        raise InputError("a file holds radiance over all directions: give no view beside it")
    lit = light if isinstance(light, Light) else read_light(light)
    inputs = paths_among(operators, light, mesh)
    with (
        claimed([target], inputs, kept),
        opened_on(device, kept) as opened,
        lend_coefficients(operators, opened, kept, progress) as lent,
    ):
        held = lent
        if mesh is not None:
            held = replace(lent, surface=frame_as_made(lent.config, take_surface_of(lent.config, mesh)))
        since = time.perf_counter()
        with stage(progress, "reflecting"):
            if view is not None:
                towards = np.asarray(view, np.float64)
                length = np.linalg.norm(towards, axis=-1, keepdims=True)
                if not np.all(length > 0.0):
                    raise InputError("a view has no length, or is not finite")
                return reflect_towards(held, lit.coeffs_kc, towards / length)
            made = reflect_map(held, lit.coeffs_kc)
        since = kept.add("reflect", since)
        if target is None:
            return made
        write_fit(target, made)
        kept.add("write", since)
    kept.facts = {"file": target, "degree": made.degree, "shape": list(made.coeffs_khwc.shape), **kept.facts}
    return kept
