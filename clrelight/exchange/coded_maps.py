"""Pictures as bytes of a few functions of the light at each pixel: what ``.ptm`` and ``.rti`` files hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.exchange.codes import check_picture
from clrelight.exchange.rows import Rows
from clrelight.exchange.shown_sums import ShownSums, code_values, slabs_of
from clrelight.matmul import pack_operator
from clrelight.metrics import SumOfErrors
from clrelight.opencl.arguments import DeviceArray
from clrelight.sampling import make_pattern

Terms = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Functions of unit directions: (n, 3) to (n, term)."""

_LIGHTS = 150
"""Directions at which functions are fitted to display values."""
_LEAST_HEIGHT = 0.15
"""z of the lowest of them: nobody lights a relief from the horizon, and few functions would have to bend for it."""


@dataclass(frozen=True)
class CodedMap:
    """Display values ``sum_t f_t(s) (code_t - bias_t) scale_t``.

    Attributes
    ----------
    codes_hwp : Rows, shape (height, width, 3 · term), or (height, width, term + 3), uint8
        The first row on top: all terms of each channel; or those of luminance, then a colour it is multiplied with.
    scale_t, bias_t : ndarray, shape (term,), float64
    terms : callable
        The functions f_t.
    """

    codes_hwp: Rows
    scale_t: NDArray[np.float64]
    bias_t: NDArray[np.float64]
    terms: Terms

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and 3."""
        return self.codes_hwp.shape[0], self.codes_hwp.shape[1], 3

    def display_values(self, directions_i3: NDArray[np.float64], first: int, end: int) -> NDArray[np.float32]:
        """Return display values of rows, (n_light, rows, width, 3), float32 in 0 .. 1."""
        codes_hwp, count = self.codes_hwp[first:end], len(self.scale_t)
        weights_it = self.terms(directions_i3) * self.scale_t
        constant_i = -(weights_it @ self.bias_t)
        groups = [codes_hwp[:, :, t : t + count] for t in range(0, codes_hwp.shape[2] - count + 1, count)]
        sums = [np.tensordot(weights_it.astype(np.float32), each.astype(np.float32), (1, 2)) for each in groups]
        shown_ihwc = np.stack(sums, axis=3) + constant_i.astype(np.float32)[:, None, None, None]
        if len(groups) == 1:
            shown_ihwc = shown_ihwc * (codes_hwp[:, :, count:].astype(np.float32) / np.float32(255.0))
        return np.clip(shown_ihwc, 0.0, 1.0)


class Refit:
    """A fit put into other functions of the light: least squares to display values all over the hemisphere.

    Parameters
    ----------
    coefficients : CoefficientMap
    terms : callable
    device : Device
        Where display values are made, and summed.
    whole_bias : bool
        Whether biases are whole numbers from 0 to 255.
    """

    def __init__(self, coefficients: CoefficientMap, terms: Terms, device: Device, *, whole_bias: bool = False) -> None:
        check_picture(coefficients, "such a file")
        directions_i3 = make_pattern("uniform", _LIGHTS)
        directions_i3 = directions_i3[directions_i3[:, 2] >= _LEAST_HEIGHT]
        basis_ik = coefficients.functions_at(directions_i3)
        self.coefficients, self._device, self._whole_bias = coefficients, device, whole_bias
        self._terms_it = terms(directions_i3)
        self._solver_ti = np.linalg.pinv(self._terms_it)
        self._sums = ShownSums(coefficients, basis_ik, self._solver_ti, (0.0, 1.0), device)
        self._squared, self._count = 0.0, 0

    def quantiser(self, progress: Callable[[int, int], None] | None) -> tuple[NDArray, NDArray]:
        """Return scales and biases of which codes 0 to 255 reach from the lowest to the highest coefficients."""
        height, count = self.coefficients.image_shape[0], len(self._solver_ti)
        low_t, high_t = np.zeros(count), np.zeros(count)
        for first, _, slabs in slabs_of(self.coefficients, self._sums):
            if progress is not None:
                progress(first, 2 * height)
            for coeffs_kcp in slabs:
                found_tq = self._device.download(self._sums.solve(coeffs_kcp)[0])
                low_t = np.minimum(low_t, found_tq.min(axis=1))
                high_t = np.maximum(high_t, found_tq.max(axis=1))
        spread_t = np.maximum(high_t - low_t, 1e-6)
        bias_t = -255.0 * low_t / spread_t
        if not self._whole_bias:
            return spread_t / 255.0, bias_t
        bias_t = np.clip(np.rint(bias_t), 0, 255)
        below_t = np.divide(-low_t, bias_t, out=np.zeros(count), where=bias_t > 0)
        above_t = np.divide(high_t, 255.0 - bias_t, out=np.zeros(count), where=bias_t < 255)
        return np.maximum(np.maximum(below_t, above_t), 1e-8), bias_t

    def pieces(
        self,
        scale_t: NDArray,
        bias_t: NDArray,
        progress: Callable[[int, int], None] | None,
        *,
        from_bottom: bool = False,
    ) -> Iterator[tuple[int, int, NDArray[np.uint8]]]:
        """Yield rows and their codes (channel, row, column, term), and keep what is lost."""
        height, width, channel = self.coefficients.image_shape
        # Terms are divided by their scales where they are made.
        solver_ti = self._solver_ti / scale_t[:, None]
        sums = self._sums.with_solver(solver_ti)
        errors = self._errors(scale_t, bias_t)
        for first, end, slabs in slabs_of(self.coefficients, sums, from_bottom=from_bottom):
            if progress is not None:
                progress(height + (height - end if from_bottom else first), 2 * height)
            made = []
            for coeffs_kcp in slabs:
                scaled_tq, shown_iq = sums.solve(coeffs_kcp)
                codes_qt = code_values(scaled_tq, bias_t, len(scale_t), self._device)[0]
                self._weigh(errors, codes_qt, shown_iq)
                made.append(codes_qt.reshape(channel, -1, len(scale_t)))
            codes_crwt = np.concatenate(made, axis=1).reshape(channel, end - first, width, -1)
            yield first, end, np.broadcast_to(codes_crwt, (3, *codes_crwt.shape[1:]))

    @property
    def decibels(self) -> float:
        """What is left of the fit in the pieces so far, a PSNR of display values, peak 1."""
        return float(-10.0 * np.log10(self._squared / self._count)) if self._squared else float("inf")

    def measure(self, made: CodedMap) -> float:
        """Return what is left of the fit in a file that was written, a PSNR of display values, peak 1."""
        self._squared, self._count = 0.0, 0
        terms, channel = len(made.scale_t), self.coefficients.image_shape[2]
        errors = self._errors(made.scale_t, made.bias_t)
        for first, end, slabs in slabs_of(self.coefficients, self._sums):
            codes_pct = made.codes_hwp[first:end].reshape(-1, 3, terms)[:, :channel]
            start = 0
            for coeffs_kcp in slabs:
                stop = start + coeffs_kcp.shape[2]
                codes_qt = np.moveaxis(codes_pct[start:stop], 1, 0).reshape(-1, terms)
                self._weigh(errors, codes_qt, self._sums.solve(coeffs_kcp)[1])
                start = stop
        return self.decibels

    def _errors(self, scale_t: NDArray, bias_t: NDArray) -> SumOfErrors:
        """Return what sums the errors of codes and 1 at all lights."""
        weights_it = self._terms_it * scale_t
        back_ij = np.concatenate([weights_it, -(weights_it @ bias_t)[:, None]], axis=1)
        return SumOfErrors(self._device, pack_operator(self._device, back_ij), 1.0, "linear")

    def _weigh(self, errors: SumOfErrors, codes_qt: NDArray[np.uint8], shown_iq: DeviceArray) -> None:
        columns, terms = codes_qt.shape
        codes_jq = np.ones((terms + 1, columns), np.float32)
        codes_jq[:-1] = codes_qt.T
        ones_q = np.ones(columns, np.float32)
        found_i = errors.between(self._device.upload(codes_jq), shown_iq, ones_q, slice(0, columns))
        self._squared += float(found_i.sum())
        self._count += columns * len(found_i)
