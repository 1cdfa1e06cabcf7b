"""CLS with Newton in one pass over the samples: what ``fit/cls_columns.cl`` needs, made once for all tiles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.fit.cls_float64 import LAMBDA_TOLERANCE, component_rounding, refine_columns
from clrelight.fit.columns import private_room
from clrelight.fit.plan import FitPlan
from clrelight.fit.registry import Shrunk
from clrelight.matmul import SampleCurve, apply_operator, pack_operator, sample_defines, tile_defines
from clrelight.opencl.arguments import DeviceArray

_LAST = 8
"""Components of the least singular values that are summed in float64 where lambda follows them (LAST in the kernel)."""
_NODES = 16
_SMALLEST_SQUARE = 1e-15
"""The kernel divides by products of two sigma^2 and cubes reciprocals: above this, all stay normal numbers."""


def fits_one_pass(device: Device, plan: FitPlan) -> bool:
    """Return whether the kernel is for this device and for these singular values."""
    squares = plan.singular_r**2
    return (
        device.shares_memory
        and plan.synthesis_kr is not None
        and len(squares) > 1
        and bool(squares.min() > _SMALLEST_SQUARE)
        and _largest_lambda(plan) < 1.0 / _SMALLEST_SQUARE
    )


class OnePassFit:
    """The constant arrays of a CLS fit on a device, and a run over columns.

    Parameters
    ----------
    device : Device
    plan : FitPlan
        One for which `fits_one_pass` holds.
    curve : SampleCurve
    iterations : int
        Cap on the steps of the search for lambda.
    ends : bool
        Whether these are enough for the search to end; where not, coefficients beyond the bound are scaled onto it.
    refined : bool
        Whether columns whose lambda is in doubt are solved again in float64, which the device must have.
    """

    def __init__(
        self, device: Device, plan: FitPlan, curve: SampleCurve, iterations: int, *, ends: bool, refined: bool
    ) -> None:
        if plan.synthesis_kr is None:
            raise ValueError("expected a least-squares plan, got one without a synthesis")
        self._device, self._plan, self._curve, self._iterations = device, plan, curve, iterations
        self._ends, self._refined = ends, refined
        scale = curve.operator_scale()
        square_r = plan.singular_r**2
        self._analysis = pack_operator(device, plan.analysis_ri * scale)
        self._synthesis = pack_operator(device, plan.synthesis_kr)
        first, end = np.log2(square_r.min() / 4.0), np.log2(_largest_lambda(plan))
        self._node_step = max(float(end - first), 1.0) / (_NODES - 1)
        nodes_n = 2.0 ** (first + self._node_step * np.arange(_NODES))
        self._first_node = float(nodes_n[0])
        singles = (
            plan.energy_i * scale**2,
            plan.singular_r,
            square_r,
            1.0 / square_r,
            square_r[:, None] / (square_r[:, None] + nodes_n) ** 2,
        )
        weight_i, singular_r, squares_r, inverse_r, table_rn = (self._upload(values) for values in singles)
        last = (device.upload(_last_rows(plan) * scale),) if refined else ()
        self._tables = (weight_i, *last, singular_r, squares_r, inverse_r, table_rn)

    def _upload(self, values: NDArray[np.float64]) -> DeviceArray:
        return self._device.upload(np.ascontiguousarray(values, np.float32))

    def __call__(self, source_ip: DeviceArray, coeffs_kp: DeviceArray) -> Shrunk:
        """Fill coefficients, shape (n_coeff, P), from code values, shape (n_light, P), and return lambda."""
        device, plan, curve = self._device, self._plan, self._curve
        tile = tile_defines(device)
        columns = source_ip.shape[1]
        analysis_b, synthesis_b = self._analysis.heights_b, self._synthesis.heights_b
        if analysis_b is None or synthesis_b is None:
            raise ValueError("expected operators in row blocks, as CPUs read them")
        lambda_p, doubt_p = device.empty((columns,), np.float32), device.empty((columns,), np.float32)
        device.launch(
            "fit/cls_columns.cl",
            "fit_cls_kp",
            (-(-columns // int(str(tile["TILE"]))),),
            coeffs_kp,
            lambda_p,
            doubt_p,
            source_ip,
            *(self._analysis.packed_o, analysis_b),
            *(self._synthesis.packed_o, synthesis_b),
            *self._tables,
            device.upload(curve.table(source_ip.dtype)),
            1.0 / curve.peak,
            self._first_node,
            self._node_step,
            component_rounding(plan),
            LAMBDA_TOLERANCE,
            self._iterations,
            *source_ip.shape,
            *(len(plan.singular_r), analysis_b.shape[0], synthesis_b.shape[0]),
            defines={
                **tile,
                **sample_defines(source_ip.dtype),
                "CURVE": curve.mode(source_ip.dtype),
                "ROOM": _local_room(device, len(plan.singular_r), tile),
                "N_NODE": _NODES,
                "REFINED": int(self._refined),
                "ONTO_BOUND": int(not self._ends),
            },
        )
        if not self._refined:
            return Shrunk(lambda_p)
        doubtful = np.flatnonzero(device.download(doubt_p) > LAMBDA_TOLERANCE)
        if len(doubtful):
            t_rf = refine_columns(device, plan, source_ip, curve, doubtful, lambda_p)
            again_kf = device.empty((coeffs_kp.shape[0], t_rf.shape[1]), np.float32)
            apply_operator(device, self._synthesis, t_rf, again_kf)
            device.download(coeffs_kp)[:, doubtful] = device.download(again_kf)[:, : len(doubtful)]
        return Shrunk(lambda_p)


def _local_room(device: Device, components: int, tile: Mapping[str, object]) -> int:
    """Return how many components a program is built for, of `private_room` as many as local memory has."""
    row_bytes = 4 * int(str(tile["TILE"]))
    # Beside z: samples, eight sums, eight of float64, and energy, lambda and doubt.
    left = device.info.local_memory_bytes // row_bytes - int(str(tile["CHUNK"])) - 28
    return max(components, min(private_room(components), left))


def _last_rows(plan: FitPlan) -> NDArray[np.float64]:
    """Return the rows of the analysis of the least singular values, transposed, shape (n_light, _LAST)."""
    last_it = np.zeros((plan.analysis_ri.shape[1], _LAST))
    last_ir = plan.analysis_ri[-_LAST:].T
    last_it[:, : last_ir.shape[1]] = last_ir
    return last_it


def _largest_lambda(plan: FitPlan) -> float:
    """Return a lambda at which the bound holds for any column: sigma_1 |z| / sqrt(E_c) with the largest |z|."""
    counted = plan.energy_i > 0.0
    ratio_ri = plan.analysis_ri[:, counted] / np.sqrt(plan.energy_i[counted])
    return float(plan.singular_r.max() * np.sqrt(np.linalg.norm(ratio_ri @ ratio_ri.T, 2)))
