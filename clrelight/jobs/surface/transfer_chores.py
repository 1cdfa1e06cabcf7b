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
    kept, (first, end) = report_for(report), part
    with on_one_thread():
        coeffs_kvc, rays = _tracing(source, asked, kept).some((first, end), block)
    write_arrays(out, {"coeffs_kvc": coeffs_kvc, "rays": np.array(rays)})
    return kept


def transfer_hits(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    parts: Sequence[Sequence[int]],
    report: Report | None = None,
    **asked: Any,
) -> Report:
    """Trace the rays of parts of the vertices, of interreflected transfer; else as `transfer_part`.

    Parameters
    ----------
    out : path
        Gets what `clrelight.jobs.surface.tracing.Tracing.hits` returns.
    parts : sequence of (first, end)
        Of vertices that are looked at together.
    """
    kept = report_for(report)
    with on_one_thread():
        found = _tracing(source, asked, kept).hits([(first, end) for first, end in parts])
    write_arrays(out, found)
    return kept


def _tracing(source: str | os.PathLike[str], asked: dict[str, Any], report: Report) -> Tracing:
    path, wanted = os.path.abspath(os.fsdecode(source)), _asked(asked)
    files = [path] if wanted.lights is None else [path, os.fsdecode(wanted.lights)]
    tracing: Tracing = _held.get((look_of(*files), wanted), lambda _: prepare_transfer(path, wanted, report))
    return tracing


def _asked(given: dict[str, Any]) -> Asked:
    told: dict[str, Any] = dict.fromkeys(("samples", "lights", "albedo", "threshold", "up", "texels"))
    told |= {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
    return Asked(**told)
