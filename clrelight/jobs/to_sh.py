"""Turn a fit of a basis that spans the same functions into one of spherical harmonics."""

from __future__ import annotations

import os
import time
from dataclasses import replace

import numpy as np

from clrelight.bases import SH, basis_of
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.fit.linear import LARGEST_CONDITION
from clrelight.fit.plan import IMAGE_ROUNDING
from clrelight.jobs.inputs import FittedLike, decoded_of, lend_fitted, opened_on, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.matmul import multiply_columns
from clrelight.memory import TILE_BYTES
from clrelight.store import create_fit
from clrelight.tiles import row_tiles


def to_sh(
    source: FittedLike,
    *,
    out: str | os.PathLike[str] | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap | Report:
    """Return, or write, the spherical-harmonic coefficients of a fit of basis ``gram-schmidt``: the same functions.

    Parameters
    ----------
    source : path, URL, CoefficientMap or Encoded
    out : path, optional
        A fit file to write, some rows at a time; without it the map is returned.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    CoefficientMap
        With `out` instead the report. Coefficients of high degrees are huge and cancel: a note says what rounding of
        float32 costs from a condition number of 1e5 on.

    Raises
    ------
    InputError
        If the basis does not span spherical harmonics, the degree is too high for float32, or a file is none of ours.
    """
    kept = report_for(report)
    with (
        claimed([out], paths_among(source), kept),
        opened_on(device, kept) as opened,
        lend_fitted(source, kept, any_basis=True) as lent,
    ):
        held = decoded_of(lent, source, opened, kept, progress)
        matrix_kk = _matrix(held.basis, held.degree, kept)
        config = {name: value for name, value in held.config.items() if name != "basis"}
        record = replace(FitRecord.of(held), config={**config, "fitted_basis": held.basis})
        since, (height, width, channel) = time.perf_counter(), held.image_shape
        step = max(1, TILE_BYTES // (4 * held.n_coeff * width * channel))

        def rows_of(first: int, end: int) -> np.ndarray:
            shape = (held.n_coeff, end - first, width, channel)
            rows_khwc = held.read_rows(first, end, np.empty(shape, np.float32))
            return multiply_columns(opened, matrix_kk, rows_khwc.reshape(held.n_coeff, -1)).reshape(shape)

        if out is None:
            return record.to_map(rows_of(0, height))
        with create_fit(out, record, held.image_shape) as sink, stage(progress, "changing the basis") as tell:
            step = max(step // sink.coeffs_khwc.chunks[1], 1) * sink.coeffs_khwc.chunks[1]
            for first, end in row_tiles((0, height), step):
                sink.write_rows(first, rows_of(first, end), None, None)
                tell(end, height)
        kept.add("write", since)
    kept.facts = {"file": os.fsdecode(out), "basis": SH, "degree": record.degree, **kept.facts}
    return kept


def _matrix(basis: str, degree: int, report: Report) -> np.ndarray:
    """Return what makes spherical-harmonic coefficients; InputError where nothing does, or float32 cannot hold them."""
    known = basis_of(basis)
    if basis == SH:
        raise InputError("these are coefficients of spherical harmonics already")
    if known.to_sh is None:
        raise InputError(f"basis {basis} does not span spherical harmonics: of these, fit with --basis sh instead")
    matrix_kk = known.to_sh(degree)
    condition = float(np.linalg.cond(matrix_kk))
    report.facts["condition"] = condition
    if condition > LARGEST_CONDITION:
        raise InputError(
            f"at degree {degree} the condition number is {condition:.2g}, beyond float32 coefficients: spline with "
            "--basis sh fits such degrees"
        )
    if condition > 1e5:
        cost = f"{condition * IMAGE_ROUNDING:.0e} of the brightest sample"
        report.note(f"condition number {condition:.2g}: rounding of the float32 coefficients costs up to {cost}")
    return matrix_kk
