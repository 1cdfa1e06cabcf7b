"""The parts of `fit` as jobs: rows of a stack whose fit another process has prepared, and their errors."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack, closing

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.fit import PreparedFit
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.farm import write_arrays
from clrelight.jobs.half_tiles import tiles_of
from clrelight.jobs.held import Held, look_of
from clrelight.jobs.inputs import lend_stack, opened_on
from clrelight.jobs.report import Report, report_for
from clrelight.jobs.shared_fits import shared_fit
from clrelight.metrics import errors_of_rows

_held = Held()


def fit_part(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    plan: str,
    rows: Sequence[int],
    dtype: str,
    measured: bool,
    memory: int,
    device: Device | str | None = None,
    report: Report | None = None,
) -> Report:
    """Fit some rows of a stack.

    Parameters
    ----------
    source : path
        The stack.
    out : path
        Gets ``coeffs_khwc``, ``lambda_hwc`` or ``rank_hwc`` where the method has one, and ``sums_ti``: each light's sum
        of squared errors (`clrelight.metrics.errors_of_rows`), none where nothing is measured.
    plan : path
        Of `clrelight.jobs.shared_fits.share_fit`.
    rows : (first, end)
    dtype : str
        Of the coefficients: ``"float32"`` or ``"float16"``.
    measured : bool
    memory : int
        Bytes that tiles may take.
    device, report
        As of `clrelight.jobs.fit.fit`.

    Raises
    ------
    InputError
        If a file is not what it should be, or a sample cannot be fitted.
    """
    kept, (first, end) = report_for(report), rows
    with opened_on(device, kept) as opened:
        stack, prepared = _view_of(os.fsdecode(source), plan, opened, kept)
        _, width, channel = stack.image_shape
        shape = (coefficient_count(prepared.degree), end - first, width, channel)
        made: dict[str, NDArray] = {"coeffs_khwc": np.empty(shape, dtype)}
        with closing(tiles_of(prepared, np.dtype(dtype), memory, rows=(first, end))) as tiles:
            for tile in tiles:
                part = slice(tile.first - first, tile.end - first)
                made["coeffs_khwc"][:, part] = tile.coeffs_khwc
                for name, map_hwc in (("lambda_hwc", tile.lambda_hwc), ("rank_hwc", tile.rank_hwc)):
                    if map_hwc is not None:
                        made.setdefault(name, np.empty(shape[1:], map_hwc.dtype))[part] = map_hwc
        fitted = prepared.record.to_map(made["coeffs_khwc"])
        sums = list(errors_of_rows(fitted, stack, device=opened, rows=(first, end))) if measured else []
    write_arrays(out, {**made, "sums_ti": np.reshape(sums, (len(sums), stack.n_light))})
    return kept


def _view_of(source: str, plan: str, device: Device, report: Report) -> tuple[LightStack, PreparedFit]:
    """Return a stack and the fit of it: the last one's where they are the same."""
    path = os.path.abspath(source)

    def make(opened: ExitStack) -> tuple[LightStack, PreparedFit]:
        stack = opened.enter_context(lend_stack(path, report))
        return stack, shared_fit(stack, plan, device)

    return _held.get((look_of(path, plan), id(device)), make)
