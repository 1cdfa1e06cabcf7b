"""A decoder that runs a compiled loop over a map's indices: what `subbands` and `range_coding` say, at its speed.

One work-item does it, since every symbol hangs on those before it: for CPUs, where kernels share memory with NumPy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.cosets import COSETS, relatives_of
from clrelight.codec.entropy.range_coding import Decoder
from clrelight.codec.entropy.symbols import ALPHABET, CLASSES
from clrelight.codec.transforms.lifting import Subband
from clrelight.device import Device
from clrelight.errors import PayloadError

if TYPE_CHECKING:
    from clrelight.codec.entropy.subbands import Statistics  # which imports this

# As in subbands.cl.
_STATE, _LOWER, _RANGE, _POINT, _AT, _FAULT = 5, *range(5)
_SCRATCH, _TABLES = 4, 3 * CLASSES + 2 * ALPHABET + 1
_FAULTS = {1: "no symbol lies where they point to", 2: "an index is too large"}
_ONES = (1 << 64) - 1


class SubbandDecoder:
    """A coder that reads what `range_coding.Encoder` wrote; PayloadError where the bytes cannot be that."""

    def __init__(self, device: Device, payload: bytes) -> None:
        self._device = device
        self._state = np.zeros(_STATE, np.uint64)
        self._state[_RANGE] = _ONES
        if len(payload) % 4:
            raise PayloadError(f"the range-coded bytes should be a multiple of 4, they are {len(payload)}")
        words = np.frombuffer(payload, "<u4").astype(np.uint32)
        self._count = len(words)
        first, second = np.append(words[:2], np.zeros(2, np.uint32))[:2].tolist()
        self._state[_POINT] = first << 32 | second
        self._state[_AT] = min(2, self._count)
        self._held = device.upload(words if len(words) else np.zeros(1, np.uint32))

    def decode_map(
        self,
        statistics: Statistics,
        bands: list[Subband],
        shape: tuple[int, int, int],
    ) -> NDArray[np.int32]:
        """See `subbands.code_indices`."""
        device, words = self._device, self._held
        indices_chw = np.zeros(shape, np.int32)
        most = max(_largest_batch(band) for band in bands)
        held: list[NDArray] = [indices_chw, np.zeros(shape, np.int32)]
        held += [statistics.magnitudes.counts, statistics.signs.counts, self._state]
        index, sizes, counts, signs, state = (device.empty(a.shape, a.dtype, a) for a in held)
        scratch = device.empty((_SCRATCH * most + _TABLES,), np.int32)
        slope_c, found_ct = np.zeros(shape[0]), np.zeros((shape[0], 3), np.int64)
        slope, found = (device.empty(a.shape, a.dtype, a) for a in (slope_c, found_ct))
        by_name = {(band.name, band.level): band for band in bands}
        for band in bands:
            low = band.name == "LL"
            slope_c[1:] = [statistics.slope(channel, low) for channel in range(1, shape[0])]
            place = device.upload(_describe_place(band, by_name))
            arrays = (index, sizes, place, slope, found, counts, signs, state, words, scratch)
            sides = (*shape, *words.shape, *scratch.shape)
            device.launch("codec/subbands.cl", "decode_subband", (1,), *arrays, *sides)
            device.finish()
            if fault := int(self._state[_FAULT]):
                raise PayloadError(f"the range-coded bytes are damaged: {_FAULTS[fault]}")
            for channel, (product, square, shift) in enumerate(found_ct.tolist()[1:], start=1):
                statistics.add_products(channel, low, product << 2 * shift, square << 2 * shift)
        return indices_chw

    def finish(self) -> None:
        """Raise PayloadError if bytes are left that no symbol needed."""
        left = (int(self._state[_POINT]) - int(self._state[_LOWER])) & _ONES
        if int(self._state[_AT]) < self._count or (int(self._state[_RANGE]) != _ONES and left >= (1 << 33) - 1):
            raise PayloadError("the range-coded bytes hold more than the indices")


def decoder_for(payload: bytes, device: Device) -> Decoder | SubbandDecoder:
    """Return the fastest decoder of maps for a device."""
    return SubbandDecoder(device, payload) if _is_fit(device) else Decoder(payload)


def _is_fit(device: Device) -> bool:
    return device.shares_memory and device.info.float64


def _largest_batch(band: Subband) -> int:
    height, width = band.shape
    counts = [-(-(height - row) // 2) * -(-(width - column) // 2) for row, column in COSETS]
    return max(counts[0], counts[1], counts[2] + counts[3])


def _describe_place(band: Subband, by_name: dict[tuple[str, int], Subband]) -> NDArray[np.int32]:
    relatives = [by_name[key] for key in relatives_of(band) if key in by_name]
    site = 0 if band.name == "LL" else 1
    place = [band.rows.start, band.columns.start, *band.shape, site, len(relatives)]
    for relative in relatives:
        place += [relative.rows.start, relative.columns.start, *relative.shape, relative.level > band.level]
    return np.array(place, np.int32)
