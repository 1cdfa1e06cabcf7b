"""One tile of a fit on the device: its samples in, its coefficients and maps out."""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.fit.plan import FitPlan
from clrelight.fit.precision import compute_dtype
from clrelight.fit.prepare import PreparedFit
from clrelight.fit.registry import Columns, Shrunk
from clrelight.fit.scaling import ScaledTile, round_coefficients
from clrelight.harmonics.index import coefficient_count
from clrelight.matmul import PackedOperator, SampleCurve, apply_operator, pack_operator, pad_columns
from clrelight.opencl.arguments import DeviceArray
from clrelight.streaming import Buffer


@dataclass(frozen=True)
class FittedTile:
    """Rows first..end of a fit, as `CoefficientMap` holds them."""

    first: int
    end: int
    coeffs_khwc: NDArray
    lambda_hwc: NDArray[np.float32] | None
    rank_hwc: NDArray[np.int32] | None

    def clear(self, outside_hw: NDArray[np.bool_]) -> None:
        """Set pixels that do not count to 0: they must not cost bits either."""
        self.coeffs_khwc[:, outside_hw] = 0.0
        if self.lambda_hwc is not None:
            self.lambda_hwc[outside_hw] = 0.0
        if self.rank_hwc is not None:
            self.rank_hwc[outside_hw] = 0


class TileFit:
    """A prepared fit on its device, whose matrices go there once and whose memory tiles share.

    Parameters
    ----------
    prepared : PreparedFit
    curve : SampleCurve
        That of nearly all tiles, for which the matrices are scaled.
    coeffs_of : list of Buffer
        What tiles put their coefficients into, in turns.
    """

    def __init__(self, prepared: PreparedFit, curve: SampleCurve, coeffs_of: list[Buffer]) -> None:
        self._prepared, self._device = prepared, prepared.device
        dtype = self._dtype = compute_dtype(prepared.arithmetic)
        # Fresh memory costs a page fault per 4 KiB, as much time as a kernel.
        self._coeffs_of = itertools.cycle(coeffs_of)
        self._components, self._energies, self._unrounded = Buffer(), Buffer(), Buffer()
        self._one_pass_of = functools.cache(
            lambda curve: prepared.method.one_pass(prepared.device, prepared.plan, curve, prepared.arithmetic)
        )
        # Neither of the two knows this object: its memory must go with it, not when Python looks for circles.
        self._operators = functools.cache(
            lambda: _Operators.upload(prepared.device, prepared.plan, curve.operator_scale(), dtype)
        )

    def run(self, first: int, end: int, scaled: ScaledTile, since: float, columns: slice = slice(None)) -> FittedTile:
        """Return rows first..end, or columns of them, from their samples; time since `since` goes to the report."""
        device, mask_hw = self._device, self._prepared.stack.mask_hw
        shape_hwc = scaled.samples_ihwc.shape[1:]
        source_ip = device.upload(scaled.samples_ihwc.reshape(len(scaled.samples_ihwc), -1))
        count = source_ip.shape[1]
        one_pass = self._one_pass_of(scaled.curve)
        if one_pass is not None:
            n_coeff = coefficient_count(self._prepared.degree)
            coeffs = _lend(device, next(self._coeffs_of), (n_coeff, count), self._dtype)
            maps = one_pass(source_ip, coeffs)
            coeffs_kp = device.download(coeffs)
        else:
            coeffs_kp, maps, since = self._run_apart(source_ip, scaled, since)
        tile = FittedTile(
            first,
            end,
            coeffs_kp.reshape(-1, *shape_hwc),
            None if maps.lambda_q is None else device.download(maps.lambda_q)[:count].reshape(shape_hwc),
            None if maps.rank_q is None else device.download(maps.rank_q)[:count].reshape(shape_hwc),
        )
        if maps.unmet_q is not None:
            self._refuse(device.download(maps.unmet_q)[:count].reshape(shape_hwc), first, columns.start or 0)
        scaled.restore(tile.coeffs_khwc)
        if mask_hw is not None:
            tile.clear(~mask_hw[first:end, columns])
        self._prepared.report.add("synthesize" if one_pass is None else "fit", since)
        return tile

    def _refuse(self, unmet_hwc: NDArray[np.int32], first: int, left: int) -> None:
        """Raise InputError where a pixel that counts cannot be fitted; the tile begins at that row and column."""
        bad_hwc, mask_hw = unmet_hwc != 0, self._prepared.stack.mask_hw
        if mask_hw is not None:
            bad_hwc &= mask_hw[first : first + len(bad_hwc), left : left + bad_hwc.shape[1], None]
        if bad_hwc.any():
            row, column, channel = np.argwhere(bad_hwc)[0]
            place = f"pixel at row {first + row}, column {left + column}, channel {channel}"
            raise InputError(f"{self._prepared.method.id}: {place}: {self._prepared.method.unmet}")

    def _run_apart(
        self, source_ip: DeviceArray, scaled: ScaledTile, since: float
    ) -> tuple[NDArray[np.float32], Shrunk, float]:
        """Project, shrink and synthesize one after another; return coefficients, maps, and when the last began."""
        device, prepared, operators = self._device, self._prepared, self._operators()
        columns, curve = source_ip.shape[1], scaled.curve
        padded = pad_columns(columns)
        z_rq = _lend(device, self._components, (operators.analysis.shape[0], padded), self._dtype)
        energy_q = _lend(device, self._energies, (padded,), self._dtype)
        weight_i = operators.energy_i
        apply_operator(device, operators.analysis, source_ip, z_rq, curve=curve, energy_q=energy_q, weight_i=weight_i)
        device.finish()
        since = prepared.report.add("project", since)
        exponent_p = None if scaled.exponent_hwc is None else scaled.exponent_hwc.ravel()
        tile_columns = Columns(source_ip, curve, z_rq, energy_q, operators.singular_r, prepared.arithmetic, exponent_p)
        maps = prepared.method.shrink(device, prepared.plan, tile_columns)
        device.finish()
        since = prepared.report.add("shrink", since)
        return self._synthesize(operators.synthesis, z_rq, columns), maps, since

    def _synthesize(self, synthesis: PackedOperator | None, z_rq: DeviceArray, columns: int) -> NDArray[np.float32]:
        buffer, is_single = next(self._coeffs_of), self._dtype == np.float32
        if synthesis is None:
            values_kp = self._device.download(z_rq)[:, :columns]
        else:
            where = buffer if is_single else self._unrounded
            coeffs = _lend(self._device, where, (synthesis.shape[0], columns), self._dtype)
            apply_operator(self._device, synthesis, z_rq, coeffs)
            values_kp = self._device.download(coeffs)
            if is_single:
                return values_kp
        coeffs_kp = buffer.lend(values_kp.shape, np.float32)
        round_coefficients(values_kp, coeffs_kp)
        return coeffs_kp


@dataclass(frozen=True)
class _Operators:
    """The plan on the device, for methods that project, shrink and synthesize one after another."""

    analysis: PackedOperator
    synthesis: PackedOperator | None
    energy_i: DeviceArray
    singular_r: DeviceArray

    @classmethod
    def upload(cls, device: Device, plan: FitPlan, scale: float, dtype: np.dtype) -> Self:
        return cls(
            pack_operator(device, plan.analysis_ri * scale, dtype),
            None if plan.synthesis_kr is None else pack_operator(device, plan.synthesis_kr, dtype),
            device.upload((plan.energy_i * scale**2).astype(dtype)),
            device.upload(plan.singular_r.astype(dtype)),
        )


def _lend(device: Device, buffer: Buffer, shape: tuple[int, ...], dtype: np.dtype) -> DeviceArray:
    return device.empty(shape, dtype, buffer.lend(shape, dtype) if device.shares_memory else None)
