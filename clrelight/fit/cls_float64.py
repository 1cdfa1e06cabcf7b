"""CLS in float64 for the columns whose lambda float32 cannot give."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.fit.columns import LANES, private_room
from clrelight.fit.plan import FitPlan
from clrelight.matmul import SampleCurve, sample_defines
from clrelight.opencl.arguments import DeviceArray

LAMBDA_TOLERANCE = 2e-5
"""Relative error of lambda above which a column is solved again in float64."""
_PROJECTION_ERROR = 0.7
"""Rounding error of a component, in eps32 times the norm of the samples; at 0.3 a comparison with float64 finds
lambda off by 1e-4."""


def refine_columns(
    device: Device,
    plan: FitPlan,
    source_ip: DeviceArray,
    curve: SampleCurve,
    chosen: NDArray[np.intp],
    lambda_n: DeviceArray,
    z_rq: DeviceArray | None = None,
) -> DeviceArray:
    """Solve chosen columns again in float64: what float32 cannot give to `LAMBDA_TOLERANCE`.

    Near ``E_c = |c(0)|^2`` lambda is ill-conditioned: it follows small components of z, which carry the rounding
    errors of large sums.

    Parameters
    ----------
    chosen : ndarray, shape (n,), int
        Columns, at least one.
    lambda_n : DeviceArray, shape (at least P,), float32
        What was found; replaced at the chosen columns.
    z_rq : DeviceArray, shape (rank, Q), float32, optional
        Components of all columns, replaced at the chosen ones. Default: an array for the chosen columns alone, padded
        by repeating the last.

    Returns
    -------
    DeviceArray
        The shrunk components: `z_rq`, or the array made for them.
    """
    padded = np.resize(chosen, -(-len(chosen) // LANES) * LANES).astype(np.int32)
    padded[len(chosen) :] = chosen[-1]
    places = padded
    if z_rq is None:
        places = np.arange(len(padded), dtype=np.int32)
        z_rq = device.empty((len(plan.singular_r), len(padded)), np.float32)
    scale = curve.operator_scale()
    device.launch(
        "fit/cls_float64.cl",
        "refine_rq",
        (len(padded) // LANES,),
        z_rq,
        lambda_n,
        source_ip,
        device.upload(padded),
        device.upload(places),
        device.upload(np.ascontiguousarray(plan.analysis_ri.T * scale)),
        device.upload(plan.singular_r),
        device.upload(plan.energy_i * scale**2),
        device.upload(curve.table(source_ip.dtype)),
        1.0 / curve.peak,
        *source_ip.shape,
        *z_rq.shape,
        defines={
            **sample_defines(source_ip.dtype),
            "CURVE": curve.mode(source_ip.dtype),
            "ROOM": private_room(len(plan.singular_r)),
        },
    )
    return z_rq


def component_rounding(plan: FitPlan) -> float:
    """Return the rounding error of a component that is summed in float32, in units of ``sqrt(E_c)``.

    A projection of samples rounds by some eps32 times their norm; the norm that counts is that of the weighted samples,
    sqrt(E_c / mean weight).
    """
    return float(_PROJECTION_ERROR * np.finfo(np.float32).eps / np.sqrt(plan.energy_i.mean()))
