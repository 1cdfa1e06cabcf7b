"""Sums of display values under many lights, made on a device: what other formats hold of a fit."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.slabs import CACHED_BYTES, slabs
from clrelight.codec.transforms.whitening import reshaped
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.matmul import apply_operator, pack_operator
from clrelight.opencl.arguments import DeviceArray
from clrelight.streaming import reading_ahead
from clrelight.tiles import row_tiles

_PIECE_BYTES = 1 << 25
"""Of coefficients that are read at a time."""
_STRETCH = 1 << 10
"""Values of a work-item."""


class ShownSums:
    """Makes display values of a fit under lights, and sums of these, a slab of columns at a time.

    A slab's columns are all pixels of the first channel, then those of the next; display values of all lights and
    channels of one pixel are rows of it as well, (light · channel, pixel), in the same memory.

    Parameters
    ----------
    coefficients : CoefficientMap
    basis_ik : ndarray, shape (n_light, n_coeff), float64
        Functions in the directions of the lights.
    solver_td : ndarray, shape (term, n_light) or (term, n_light · channel), float64
        What display values are summed with: those of each channel alone, or of all channels together.
    span : (float, float)
        What radiance is cut to.
    device : Device
    """

    def __init__(
        self,
        coefficients: CoefficientMap,
        basis_ik: NDArray[np.float64],
        solver_td: NDArray[np.floating],
        span: tuple[float, float],
        device: Device,
    ) -> None:
        self._device, self._span, self._encode = device, span, int(coefficients.transfer == "srgb")
        self._basis, self._solver = pack_operator(device, basis_ik), pack_operator(device, solver_td)
        self.item_bytes = 4 * len(basis_ik) * coefficients.image_shape[2]

    def with_solver(self, solver_td: NDArray[np.floating]) -> ShownSums:
        """Return what sums with another matrix."""
        other = copy.copy(self)
        other._solver = pack_operator(self._device, solver_td)
        return other

    def solve(self, coeffs_kcp: NDArray[np.float32]) -> tuple[DeviceArray, DeviceArray]:
        """Queue the sums of some pixels, (term, pixel) or (term, channel · pixel), and their display values."""
        device, (_, channel, pixel) = self._device, coeffs_kcp.shape
        shown_iq = device.empty((self._basis.shape[0], channel * pixel), np.float32)
        apply_operator(device, self._basis, device.upload(coeffs_kcp.reshape(len(coeffs_kcp), -1)), shown_iq)
        size = math.prod(shown_iq.shape)
        defines = {**_defines(device, 1), "ENCODE": self._encode}
        grid = (-(-size // _STRETCH),)
        flat_p = reshaped(shown_iq, (size,))
        device.launch("exchange/shown.cl", "show_values_p", grid, flat_p, *self._span, size, defines=defines)
        rows = self._solver.shape[1]
        given = reshaped(shown_iq, (rows, size // rows))
        sums_tq = device.empty((self._solver.shape[0], given.shape[1]), np.float32)
        apply_operator(device, self._solver, given, sums_tq)
        return sums_tq, shown_iq


class LinearSums:
    """Makes sums of coefficients: what sums of display values come to where no curve lies between.

    Parameters
    ----------
    matrix_td : ndarray, shape (term, n_coeff · channel), float64
    device : Device
    """

    def __init__(self, matrix_td: NDArray[np.floating], device: Device) -> None:
        self._device, self._matrix = device, pack_operator(device, matrix_td)
        self.item_bytes = 4 * matrix_td.shape[1]

    def solve(self, coeffs_kcp: NDArray[np.float32]) -> tuple[DeviceArray, None]:
        """Queue the sums of some pixels, (term, pixel)."""
        source_dp = self._device.upload(coeffs_kcp.reshape(self._matrix.shape[1], -1))
        sums_tp = self._device.empty((self._matrix.shape[0], source_dp.shape[1]), np.float32)
        apply_operator(self._device, self._matrix, source_dp, sums_tp)
        return sums_tp, None


def code_values(sums_tq: DeviceArray, offset_t: NDArray[np.floating], group: int, device: Device) -> NDArray[np.uint8]:
    """Return the bytes nearest to sums and offsets, (term / group, column, group), of 0 to 255."""
    terms, columns = sums_tq.shape
    codes_q = device.empty((terms * columns,), np.uint8)
    grid = (-(-columns // _STRETCH), terms // group)
    offsets = device.upload(offset_t.astype(np.float32))
    defines = {**_defines(device, group), "ENCODE": 0}
    device.launch(
        "exchange/shown.cl", "code_values_q", grid, codes_q, sums_tq, offsets, terms, columns, defines=defines
    )
    return device.download(codes_q).reshape(-1, columns, group)


def slabs_of(
    coefficients: CoefficientMap, sums: ShownSums | LinearSums, *, from_bottom: bool = False
) -> Iterator[tuple[int, int, Iterator[NDArray[np.float32]]]]:
    """Yield rows, from the first to before the end, and coefficients of slabs of them, (n_coeff, channel, pixel).

    Slabs are of consecutive pixels; the next rows are read meanwhile.
    """
    n_coeff, (height, width, channel) = coefficients.n_coeff, coefficients.image_shape
    tiles = list(row_tiles((0, height), max(_PIECE_BYTES // (4 * n_coeff * channel * width), 1)))
    tiles = tiles[::-1] if from_bottom else tiles

    def read(rows: tuple[int, int]) -> NDArray[np.float32]:
        shape = (n_coeff, rows[1] - rows[0], width, channel)
        return coefficients.read_rows(*rows, np.empty(shape, np.float32)).reshape(n_coeff, -1, channel)

    with reading_ahead(read, tiles) as pieces:
        for (first, end), coeffs_kpc in zip(tiles, pieces, strict=True):
            yield first, end, _slabs(coeffs_kpc, sums.item_bytes)


def _slabs(coeffs_kpc: NDArray[np.float32], item_bytes: int) -> Iterator[NDArray[np.float32]]:
    for columns in slabs(coeffs_kpc.shape[1], item_bytes, CACHED_BYTES):
        yield np.ascontiguousarray(np.moveaxis(coeffs_kpc[:, columns], 2, 1))


def _defines(device: Device, group: int) -> dict[str, object]:
    return {"VECTOR": device.info.lanes, "STRETCH": _STRETCH, "GROUP": group}
