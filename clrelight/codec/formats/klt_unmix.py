"""How planes of the codec `klt` become coefficients."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clrelight import recycling
from clrelight.codec.formats.klt_regions import Held
from clrelight.codec.formats.klt_units import Parsed
from clrelight.codec.registry import refuse_infinite
from clrelight.codec.slabs import CACHED_BYTES
from clrelight.codec.transforms.code_values import radiance_of
from clrelight.codec.transforms.lifting import join_channels, padded_width
from clrelight.codec.transforms.whitening import reshaped
from clrelight.codec.views import Region
from clrelight.codec.workspace import Shape
from clrelight.device import Device
from clrelight.matmul import PackedOperator, apply_operator, pack_operator, tile_defines

_LEAD = 15
"""Pixels that the first tile of a row may have less than others: these begin where a line of the caches does."""


class Unmixing:
    """Makes finite coefficients of planes; see `clrelight.codec.formats.klt_decode.Maker`.

    Of radiance; `as_coded`, of code values where these are coded.
    """

    def __init__(self, parsed: Parsed, shape: Shape, device: Device, *, as_coded: bool = False) -> None:
        self._device, self._basis = device, parsed.head.basis
        self._transfer = "linear" if as_coded else parsed.head.transfer
        self._n_coeff, self._channel = shape[0], shape[3]
        self._operator_mj = parsed.operator_kcj.reshape(self._n_coeff * self._channel, -1)
        self._in_place = device.style == "cpu" and device.shares_memory
        self._packed: dict[float, PackedOperator] = {}

    def coefficients(self, parts: Iterable[Held], region: Region) -> NDArray[np.float32]:
        """See `Maker`."""
        coeffs_khwc = recycling.empty((self._n_coeff, *region.shape, self._channel), np.float32)
        for part in parts:
            top, left = part.region.top - region.top, part.region.left - region.left
            height, width = part.region.shape
            if self._in_place and self._transfer != "srgb":
                self._unmix(part, coeffs_khwc, top, left)
                continue
            step = max(CACHED_BYTES // (4 * padded_width(width) * len(self._operator_mj)), 1)
            for first in range(0, height, step):
                end = min(first + step, height)
                made = self._made(part.rows(part.region.top + first, part.region.top + end))
                coeffs_khwc[:, top + first : top + end, left : left + width] = made
        return coeffs_khwc

    def _made(self, part: Held) -> NDArray[np.float32]:
        """Return the coefficients of a part of few rows."""
        if self._in_place:
            made = recycling.empty((self._n_coeff, *part.region.shape, self._channel), np.float32)
            self._unmix(part, made, 0, 0)
        else:
            made = self._multiplied(part)
        if self._transfer == "srgb":  # what is not bent is bounded by the kernels
            made = radiance_of(made, self._device, self._basis)
            refuse_infinite(made, "klt", self._device)
        return made

    @cached_property
    def _as_it_is(self) -> PackedOperator:
        return pack_operator(self._device, self._operator_mj)

    def _unmix(self, part: Held, coeffs_khwc: NDArray[np.float32], top: int, left: int) -> None:
        """Put the coefficients of a part where they belong, from planes in memory that a CPU shares."""
        if part.values is None:
            height, width = part.region.shape
            most = np.finfo(np.float32).max
            mean_m = np.clip(self._operator_mj[:, -1], -most, most).astype(np.float32)
            mean_kc = mean_m.reshape(self._n_coeff, 1, 1, self._channel)
            coeffs_khwc[:, top : top + height, left : left + width] = mean_kc
            return
        operator, tile = self._operator(part.scale), tile_defines(self._device)
        assert operator.heights_b is not None
        height, width = part.region.shape
        self._device.launch(
            "codec/unmix.cl",
            "unmix_planes",
            (-(-(width + _LEAD) // int(str(tile["TILE"]))), height),
            self._device.empty(coeffs_khwc.shape, np.float32, coeffs_khwc),
            *(part.values, operator.packed_o, operator.heights_b),
            *(top, left, part.top, part.left, width, *coeffs_khwc.shape, operator.heights_b.shape[0]),
            *part.values.shape,
            defines=tile,
        )
        self._device.finish()

    def _operator(self, scale: float) -> PackedOperator:
        if scale not in self._packed:
            scaled = self._operator_mj * np.append(np.full(self._operator_mj.shape[1] - 1, scale), 1.0)
            together = 3 if self._channel == 3 else 1
            self._packed[scale] = pack_operator(self._device, scaled, together=together)
        return self._packed[scale]

    def _multiplied(self, part: Held) -> NDArray[np.float32]:
        """Return the same from a device of its own memory, through a product and its channels interleaved."""
        (height, width), count = part.region.shape, self._operator_mj.shape[1] - 1
        n_value, pitch = len(self._operator_mj), padded_width(width)
        source = recycling.empty((count + 1, height, pitch), np.float32)
        source[count], source[:count, :, width:] = 1.0, 1.0
        source[:count, :, :width] = part.array(self._device)
        made = self._device.empty((n_value, height * pitch), np.float32)
        apply_operator(self._device, self._as_it_is, self._device.upload(source.reshape(count + 1, -1)), made)
        shape = (self._n_coeff, height, width, self._channel)
        ones = np.ones(self._n_coeff, np.float32)
        return join_channels(reshaped(made, (n_value, height, pitch)), shape, ones, self._device)
