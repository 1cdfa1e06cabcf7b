"""Fit coefficients to every pixel of a stack: to a file, piece by piece, or to a map in memory."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, overload

from clrelight.bases import SH
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.fit import FitMethod, prepare_fit
from clrelight.fit.precision import MIXED
from clrelight.fit.selection import AUTO, WITHIN
from clrelight.holdout import HoldoutRule
from clrelight.jobs.confidence import write_confidence
from clrelight.jobs.farm import Farm, shared_source
from clrelight.jobs.fitting import Fitting
from clrelight.jobs.half_tiles import check_rows
from clrelight.jobs.inputs import StackLike, lend_stack, opened_on, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store.fits import coefficient_dtype


@overload
def fit(
    source: StackLike,
    method: str | FitMethod = "cls",
    degree: int | str = 6,
    *,
    out: None = None,
    holdout: int | None = None,
    holdout_by: str = "index",
    lights: int | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    basis: str = SH,
    precision: str = MIXED,
    within: float = WITHIN,
    store: str = "float32",
    measure: bool | None = None,
    confidence: str | os.PathLike[str] | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> CoefficientMap: ...


@overload
def fit(
    source: StackLike,
    method: str | FitMethod = "cls",
    degree: int | str = 6,
    *,
    out: str | os.PathLike[str],
    holdout: int | None = None,
    holdout_by: str = "index",
    lights: int | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    basis: str = SH,
    precision: str = MIXED,
    within: float = WITHIN,
    store: str = "float32",
    measure: bool | None = None,
    confidence: str | os.PathLike[str] | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    farm: Farm | None = None,
    **options: Any,
) -> Report: ...


def fit(
    source: StackLike,
    method: str | FitMethod = "cls",
    degree: int | str = 6,
    *,
    out: str | os.PathLike[str] | None = None,
    holdout: int | None = None,
    holdout_by: str = "index",
    lights: int | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    basis: str = SH,
    precision: str = MIXED,
    within: float = WITHIN,
    store: str = "float32",
    measure: bool | None = None,
    confidence: str | os.PathLike[str] | None = None,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    farm: Farm | None = None,
    **options: Any,
) -> CoefficientMap | Report:
    """Fit coefficients of spherical harmonics, or of another basis, to every pixel and channel of a stack.

    Parameters
    ----------
    source : path or LightStack
    method : str or FitMethod
        ``"project"``, ``"uls"``, ``"sloan"``, ``"cls"``, ``"ceb"``, ``"ceb-crossing"``, ``"spline"``,
        ``"spectrum"``, ``"constrained"``, or ``"auto"``: the best at unseen lights, as far as those to fit can tell.
    degree : int or str
        Largest degree, or ``"auto"``.
    out : path, optional
        A fit file to write, piece by piece; without it the map is returned.
    holdout : int, optional
        Keep every K-th light out of the fit, and measure there too.
    holdout_by : str
        Which ones: ``"index"``, every K-th direction in the order of the photographs, or ``"place"``, blocks as large
        as the gaps between lights (`clrelight.holdout.split_chosen`).
    lights : int, optional
        Fit so many well-spread lights only.
    weights : str
        ``"uniform"``, or ``"solid-angle"``: least squares and bound weighted by the lights' Voronoi cells.
    sampling : str
        ``"hemisphere"``, or ``"scattered"`` for samples that cover a part of it.
    basis : str
        ``"sh"``, or a hemispherical one of `clrelight.bases` (``uls`` and ``spline``): ``"hsh"``, ``"gram-schmidt"``...
    precision : str
        ``"mixed"``: float32, and float64 where lambda would be in doubt; ``"single"``; ``"double"``.
    within : float
        Decibels at unseen lights that ``"auto"`` may give for fewer coefficients.
    store : str
        ``"float32"`` or ``"float16"``: the type of the coefficients.
    measure : bool, optional
        Whether to measure PSNR; default: where `out` or `report` is given.
    confidence : path, optional
        A picture to write of the PSNR that is expected under each light direction (of ``spectrum``, also where auto
        takes it): decibels in a format of floats, 5 to a decibel in 8 bits (`clrelight.fit.confidence`).
    memory : int or str
        Bytes that tiles may take, such as ``"1GiB"``; a map that is returned comes on top.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).
    farm : Farm, optional
        Other processes that fit rows of the stack, with the same result; it is a file then, and `out` is given.
    **options
        Of the method: ``energy``, ``iterations`` and ``solver`` (cls), ``energy`` (ceb), ``fill`` (project), ``lam``
        and ``per`` (spline), ``level``, ``slope``, ``edge``, ``heat``, ``noise``, ``azimuth``, ``tilt``, ``limit`` and
        ``share`` (spectrum), ``energy``, ``lower``, ``upper``, ``nonnegative`` and ``at`` (constrained). None means
        the default.

    Returns
    -------
    CoefficientMap
        Coefficients of linear radiance in units of the peak; with `out` instead the report.

    Raises
    ------
    InputError
        If the method cannot fit this degree to these lights, samples are negative or not finite, a row takes more
        than `memory`, the device cannot compute in this precision, or `out` cannot be written.
    """
    kept, budget, dtype = report_for(report), count_bytes(memory), coefficient_dtype(store)
    path = shared_source(farm, source, "the stack", out)
    model = method if isinstance(method, str | FitMethod) else str(method)
    wanted = degree if isinstance(degree, str) else whole(degree, "degree")
    every, count = (None if n is None else whole(n, name) for n, name in ((holdout, "holdout"), (lights, "lights")))
    with (
        claimed([out, confidence], paths_among(source), kept),
        opened_on(device, kept) as opened,
        lend_stack(source, kept) as stack,
    ):
        rule = HoldoutRule(every, count, holdout_by)
        split = rule.split(stack.directions_i3)
        chosen = stack if len(split[0]) == stack.n_light else stack.select(split[0])
        with stage(progress, "choosing a model" if AUTO in (model, wanted) else "preparing"):
            prepared = prepare_fit(
                *(chosen, model, wanted),
                options={name: value for name, value in options.items() if value is not None},
                weights=weights,
                sampling=sampling,
                basis=basis,
                precision=precision,
                within=within,
                device=opened,
                unseen_t3=stack.directions_i3[split[1]] if len(split[1]) else None,
            )
        prepared = replace(prepared, config={**prepared.config, **rule.to_config()})
        job = Fitting(stack, split, prepared, dtype, budget, kept, progress, farm, path)
        job.tell_facts()
        if out is not None:
            check_rows(prepared, dtype, budget)
        if confidence is not None:
            write_confidence(confidence, prepared, kept)
        if out is not None:
            job.to_file(out, True if measure is None else measure)
            return kept
        return job.to_map(report is not None if measure is None else measure)
