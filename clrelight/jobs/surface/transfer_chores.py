"""The parts of `transfer` as jobs: the functions of some vertices."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from clrelight.jobs.farm import write_arrays
from clrelight.jobs.held import Held, look_of
from clrelight.jobs.report import Report, report_for
from clrelight.jobs.surface.asked import Asked
from clrelight.jobs.surface.tracing import Tracing, prepare_transfer
from clrelight.threads import on_one_thread

_held = Held()


def transfer_part(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    part: Sequence[int],
    block: int,
    report: Report | None = None,
    **asked: Any,
) -> Report:
    """Make the transfer functions of some vertices of a mesh.

    Parameters
    ----------
    source : path
        The mesh.
    out : path
        Gets ``coeffs_kvc``, (n_coeff, n, channel), and ``rays``, how many were traced.
    part : (first, end)
        Of the vertices, or texels.
    block : int
        Vertices that one process would write together.
    report : Report, optional
    **asked
        See `clrelight.jobs.surface.asked.Asked`.

    Raises
    ------
    InputError
        As of `clrelight.jobs.surface.transfer.transfer`.
    """
    kept, path, wanted = report_for(report), os.path.abspath(os.fsdecode(source)), _asked(asked)
    files = [path] if wanted.lights is None else [path, os.fsdecode(wanted.lights)]
    with on_one_thread():
        tracing: Tracing = _held.get((look_of(*files), wanted), lambda _: prepare_transfer(path, wanted, kept))
        (first, end) = part
        coeffs_kvc, rays = tracing.some((first, end), block)
    write_arrays(out, {"coeffs_kvc": coeffs_kvc, "rays": np.array(rays)})
    return kept


def _asked(given: dict[str, Any]) -> Asked:
    told: dict[str, Any] = dict.fromkeys(("samples", "lights", "albedo", "threshold", "up", "texels"))
    told |= {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
    return Asked(**told)
