"""Pictures as bytes of a few functions of the light at each pixel: what ``.ptm`` and ``.rti`` files hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.exchange.codes import check_picture, display_values, row_pieces
from clrelight.exchange.rows import Rows
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


@dataclass
class Refit:
    """A fit put into other functions of the light: least squares to display values all over the hemisphere.

    Attributes
    ----------
    coefficients : CoefficientMap
    terms : callable
    whole_bias : bool
        Whether biases are whole numbers from 0 to 255.
    """

    coefficients: CoefficientMap
    terms: Terms
    whole_bias: bool = False

    def __post_init__(self) -> None:
        check_picture(self.coefficients, "such a file")
        directions_i3 = make_pattern("uniform", _LIGHTS)
        self._directions_i3 = directions_i3[directions_i3[:, 2] >= _LEAST_HEIGHT]
        self._basis_ik = self.coefficients.functions_at(self._directions_i3)
        self._solver_ti = np.linalg.pinv(self.terms(self._directions_i3)).astype(np.float32)
        self._squared, self._count = 0.0, 0

    def quantiser(self, progress: Callable[[int, int], None] | None) -> tuple[NDArray, NDArray]:
        """Return scales and biases of which codes 0 to 255 reach from the lowest to the highest coefficients."""
        height, count = self.coefficients.image_shape[0], len(self._solver_ti)
        low_t, high_t = np.zeros(count), np.zeros(count)
        for first, end in row_pieces(self.coefficients, len(self._directions_i3)):
            if progress is not None:
                progress(first, 2 * height)
            found_tpc, _ = self._solved(first, end)
            low_t = np.minimum(low_t, found_tpc.min(axis=(1, 2)))
            high_t = np.maximum(high_t, found_tpc.max(axis=(1, 2)))
        spread_t = np.maximum(high_t - low_t, 1e-6)
        bias_t = -255.0 * low_t / spread_t
        if not self.whole_bias:
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
        """Yield rows and their codes (row, column, 3 · term), and keep what is lost."""
        height, width, _ = self.coefficients.image_shape
        rows = list(row_pieces(self.coefficients, len(self._directions_i3)))
        for first, end in reversed(rows) if from_bottom else rows:
            if progress is not None:
                progress(height + (height - end if from_bottom else first), 2 * height)
            found_tpc, shown_ipc = self._solved(first, end)
            scaled_tpc = found_tpc / scale_t[:, None, None].astype(np.float32)
            codes_tpc = np.rint(np.clip(scaled_tpc + bias_t[:, None, None].astype(np.float32), 0.0, 255.0))
            codes_hwp = codes_tpc.astype(np.uint8).transpose(1, 2, 0).reshape(end - first, width, -1)
            made = CodedMap(codes_hwp, scale_t, bias_t, self.terms)
            back = made.display_values(self._directions_i3, 0, end - first).reshape(shown_ipc.shape)
            self._squared += float(np.sum((back - shown_ipc) ** 2, dtype=np.float64))
            self._count += shown_ipc.size
            yield first, end, codes_hwp

    @property
    def decibels(self) -> float:
        """What is left of the fit in the pieces so far, a PSNR of display values, peak 1."""
        return float(-10.0 * np.log10(self._squared / self._count)) if self._squared else float("inf")

    def measure(self, made: CodedMap) -> float:
        """Return what is left of the fit in a file that was written, a PSNR of display values, peak 1."""
        self._squared, self._count = 0.0, 0
        for first, end in row_pieces(self.coefficients, len(self._directions_i3)):
            shown_ipc = display_values(self.coefficients, self._basis_ik, first, end)
            back = made.display_values(self._directions_i3, first, end).reshape(shown_ipc.shape)
            self._squared += float(np.sum((back - shown_ipc) ** 2, dtype=np.float64))
            self._count += shown_ipc.size
        return self.decibels

    def _solved(self, first: int, end: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        shown_ipc = display_values(self.coefficients, self._basis_ik, first, end)
        return np.tensordot(self._solver_ti, shown_ipc, 1), shown_ipc
