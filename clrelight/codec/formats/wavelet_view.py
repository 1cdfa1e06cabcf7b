"""How body 6 of the codec `wavelet` becomes coefficients or images: all of it, or a part, at any level."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body
from clrelight.codec.damage import Damage
from clrelight.codec.entropy.unit_index import Stored
from clrelight.codec.formats.klt_decode import UnitsView
from clrelight.codec.formats.klt_regions import Held, join_parts
from clrelight.codec.formats.wavelet_planes import planes_to_maps
from clrelight.codec.formats.wavelet_units import ABSENT, Tables, step_of
from clrelight.codec.views import Region
from clrelight.codec.workspace import Shape
from clrelight.device import Device


class _Maker:
    """See `clrelight.codec.formats.klt_decode.Maker`."""

    def __init__(self, tables: Tables, channel: int, device: Device) -> None:
        self._device, self._channel = device, channel
        self._step_k = np.where(tables.code_k == ABSENT, 0.0, step_of(tables.code_k))
        self._place_kd, self._rotation_kdc = tables.places(channel), tables.rotations(channel)

    def coefficients(self, parts: Iterable[Held], region: Region) -> NDArray[np.float32]:
        """See `Maker`."""
        return join_parts(((part.region, self._made(part.array(self._device))) for part in parts), region)

    def _made(self, planes_jyx: NDArray[np.float32]) -> NDArray[np.float32]:
        shape = (len(self._step_k), *planes_jyx.shape[1:], self._channel)
        if not len(planes_jyx):
            return np.zeros(shape, np.float32)
        planes = self._device.upload(np.ascontiguousarray(planes_jyx))
        return planes_to_maps(planes, shape, self._rotation_kdc, self._step_k, self._place_kd, self._device)

    def operator(self, basis_ik: NDArray[np.float64], count: int) -> NDArray[np.float64]:
        """Return what makes images (light, channel) of planes: (n_light * channel, n_plane)."""
        channel = self._channel
        operator_icj = np.zeros((len(basis_ik), channel, count))
        weight_ik = basis_ik * self._step_k
        for k in np.flatnonzero(self._place_kd[:, 0] >= 0):
            rotation_dc = np.eye(channel) if self._rotation_kdc is None else self._rotation_kdc[k]
            operator_icj[:, :, self._place_kd[k]] = weight_ik[:, k, None, None] * rotation_dc.T
        return operator_icj.reshape(-1, count)


class WaveletView(UnitsView):
    """Body 6 of `wavelet`."""

    def __init__(self, body: Body, tables: Tables, stored: Stored, shape: Shape, damage: Damage | None = None) -> None:
        super().__init__(body, stored, shape, damage)
        self._tables = tables

    def _maker(self, device: Device) -> _Maker:
        return _Maker(self._tables, self._shape[3], device)

    def relight_rows(
        self, directions_i3: NDArray[np.float64], region: Region, device: Device
    ) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """See `UnitsView`."""
        basis_ik = self._functions_at(directions_i3)
        count, channel = self._stored.n_plane, self._shape[3]
        operator_mj = self._maker(device).operator(basis_ik, count) if count else np.zeros((len(basis_ik) * channel, 0))
        return self._relit(region, operator_mj, device, lambda images: images)
