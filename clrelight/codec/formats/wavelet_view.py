"""How body 6 of the codec `wavelet` becomes coefficients or images: all of it, or a part, at any level."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body
from clrelight.codec.damage import Damage
from clrelight.codec.entropy.unit_index import Stored
from clrelight.codec.factored import finite_images
from clrelight.codec.formats.klt_decode import UnitPlanes
from clrelight.codec.formats.wavelet_planes import planes_to_maps
from clrelight.codec.formats.wavelet_units import ABSENT, Tables, step_of
from clrelight.codec.rooms import Shape
from clrelight.codec.streams import Target
from clrelight.codec.views import Region
from clrelight.device import Device
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degree_of


class _Maker:
    """Makes coefficients of planes."""

    def __init__(self, tables: Tables, channel: int, device: Device) -> None:
        self._device, self._channel = device, channel
        self._step_k = np.where(tables.code_k == ABSENT, 0.0, step_of(tables.code_k))
        self._place_kd, self._rotation_kdc = tables.places(channel), tables.rotations(channel)

    def coefficients(self, planes_jyx: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return maps (n_coeff, height, width, channel) of planes in steps, (n_plane, height, width)."""
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


class WaveletView:
    """A body that is relit without its coefficients: light by light, only sums of planes are transformed back.

    See `clrelight.codec.views.Regions`.
    """

    def __init__(self, body: Body, tables: Tables, stored: Stored, shape: Shape, damage: Damage | None = None) -> None:
        self._tables, self._stored, self._shape = tables, stored, shape
        self._planes = UnitPlanes(body, stored, shape, damage)

    def to_coeffs(self, device: Device) -> NDArray[np.float32]:
        """Return the (n_coeff, height, width, channel) float32 coefficients."""
        return self.coefficients(Region(0, 0, *self._shape[1:3]), device)

    def coefficients(self, region: Region, device: Device) -> NDArray[np.float32]:
        """Return those of a part, at its level; only units that it hangs on are read."""
        return _Maker(self._tables, self._shape[3], device).coefficients(self._planes.of(region, device))

    def put_rows(self, target: Target, device: Device) -> None:
        """Put all coefficients, strip by strip."""
        maker = _Maker(self._tables, self._shape[3], device)
        strips = self._planes.strips(target.room.memory_bytes, device)
        for part in target.row_parts():
            target.put_rows(part.start, maker.coefficients(strips.rows(part.start, part.stop)))

    def relight(self, directions_i3: NDArray[np.float64], device: Device) -> NDArray[np.float32]:
        """Return images (n_light, height, width, channel), float32 linear radiance in units of the peak."""
        return self.relight_region(directions_i3, Region(0, 0, *self._shape[1:3]), device)

    def relight_region(self, directions_i3: NDArray[np.float64], region: Region, device: Device) -> NDArray[np.float32]:
        """Return a part of the images at a level."""
        n_coeff, _, _, channel = self._shape
        basis_ik = evaluate_basis(directions_i3, degree_of(n_coeff))
        count = self._stored.n_plane
        images = np.zeros((len(basis_ik), *region.shape, channel), np.float32)
        if count:
            operator_mj = _Maker(self._tables, channel, device).operator(basis_ik, count)
            with np.errstate(over="ignore", invalid="ignore"):  # what no encoder wrote: it is refused below
                sums = self._planes.sums(region, operator_mj, device)
            images = sums.reshape(len(basis_ik), channel, *region.shape).transpose(0, 2, 3, 1)
        return np.ascontiguousarray(finite_images(images))
