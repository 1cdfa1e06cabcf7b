"""Coefficients that are made of photographs when they are asked for, part by part: no map of them lies anywhere."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.finite import check_coefficients
from clrelight.codec.streams import Linear, Source, parts_of
from clrelight.codec.workspace import PARTS, Workspace
from clrelight.fit.precision import DOUBLE
from clrelight.fit.prepare import PreparedFit
from clrelight.fit.tile import TileFit
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.bands import Bands, bands_of
from clrelight.streaming import Buffer


class FittedSource(Source):
    """The coefficients of a prepared fit, fitted anew whenever they are read; see `fitted_source`."""

    def __init__(self, prepared: PreparedFit, workspace: Workspace, bands: Bands) -> None:
        shape = (coefficient_count(prepared.degree), *prepared.stack.image_shape)
        super().__init__(shape, prepared.device, workspace)
        self._report, self._bands = prepared.report, bands
        self.basis, self.lights_i3 = prepared.record.basis, prepared.record.fitted_lights
        self._scaling = prepared.scaling()
        self._fit = TileFit(prepared, self._scaling.curve, [Buffer(), Buffer()])
        self.sample_type = np.dtype(prepared.stack.images_ihwc.dtype)
        self._mask_hw, self._n_light = prepared.stack.mask_hw, prepared.stack.n_light
        integers = np.issubdtype(prepared.stack.images_ihwc.dtype, np.integer)  # others may be far from the peak
        if prepared.method.is_linear and integers and prepared.precision != DOUBLE:
            plan, curve = prepared.plan, self._scaling.curve
            synthesis_kr = np.eye(self.shape[0]) if plan.synthesis_kr is None else plan.synthesis_kr
            self.linear = Linear(plan.analysis_ri * curve.operator_scale(), synthesis_kr, curve)

    def read_samples(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray:
        """See `Source`; black where pixels do not count."""
        since = time.perf_counter()
        samples_ihwc = self._bands.part(rows, columns)
        if self._mask_hw is not None:
            samples_ihwc[:, ~self._mask_hw[slice(*rows), slice(*columns)]] = 0
        self._report.add("read", since)
        return samples_ihwc

    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Source`."""
        return self.read_part((first, end), (0, self.shape[2]))

    def read_part(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """See `Source`."""
        since = time.perf_counter()
        return self._fitted(self._bands.part(rows, columns), rows, slice(*columns), since)

    def read_some(self, row: int, columns: slice) -> NDArray[np.float32]:
        """See `Source`."""
        since, rows = time.perf_counter(), (row, row + 1)
        samples_ihwc = self._bands.row(row)
        if samples_ihwc.dtype.kind == "f":  # of which those that are no radiance are named by their places
            coeffs_khwc = self._fitted(samples_ihwc, rows, slice(None), since)
            self.check(coeffs_khwc, row)
            return coeffs_khwc[:, :, columns]
        return self._fitted(np.ascontiguousarray(samples_ihwc[:, :, columns]), rows, columns, since)

    def read_scattered(self, places: Sequence[tuple[int, slice]]) -> NDArray[np.float32]:
        """See `Source`; where coefficients are linear in samples, as many pixels at once as a part may take."""
        if self.linear is None or self._mask_hw is not None:
            return super().read_scattered(places)
        n_coeff, _, width, channel = self.shape
        counts = [len(range(*columns.indices(width))) for _, columns in places]
        pixel_bytes = channel * (2 * self._n_light * self.sample_type.itemsize + 4 * n_coeff)
        most = max(self.workspace.memory_bytes // PARTS // pixel_bytes, 1)
        found = np.empty((n_coeff, 1, sum(counts), channel), np.float32)
        first, done = 0, 0
        while first < len(places):
            end, held = first + 1, counts[first]
            while end < len(places) and held + counts[end] <= most:
                end, held = end + 1, held + counts[end]
            found[:, :, done : done + held] = self._fit_places(places[first:end])
            first, done = end, done + held
        return found

    def _fit_places(self, places: Sequence[tuple[int, slice]]) -> NDArray[np.float32]:
        since = time.perf_counter()
        read = [self._bands.row(row)[:, :, columns].copy() for row, columns in places]
        scaled = self._scaling.scale(np.concatenate(read, axis=2), places[0][0])
        since = self._report.add("read", since)
        return self._fit.run(0, 1, scaled, since).coeffs_khwc

    def _fitted(
        self, samples_ihwc: NDArray, rows: tuple[int, int], columns: slice, since: float
    ) -> NDArray[np.float32]:
        scaled = self._scaling.scale(samples_ihwc, rows[0], columns.start or 0)
        since = self._report.add("read", since)
        return self._fit.run(*rows, scaled, since, columns).coeffs_khwc

    @contextmanager
    def rows(self, multiple: int = 1) -> Iterator[Iterator[tuple[int, NDArray[np.float32]]]]:
        """See `Source`; nothing is fitted ahead: the device has other work meanwhile."""
        parts = parts_of(self.shape[1], self.workspace.part_rows(self.shape, multiple))
        yield ((part.start, self.read_rows(part.start, part.stop)) for part in parts)

    def check(self, coeffs_khwc: NDArray[np.float32], first_row: int) -> None:
        """Raise InputError that names a coefficient which is not finite."""
        check_coefficients(coeffs_khwc, self.device, first_row)


@contextmanager
def fitted_source(prepared: PreparedFit, workspace: Workspace) -> Iterator[FittedSource]:
    """Lend the coefficients of a prepared fit to a codec."""
    with bands_of(prepared.stack) as bands:
        yield FittedSource(prepared, workspace, bands)
