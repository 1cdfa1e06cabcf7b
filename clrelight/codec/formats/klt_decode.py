"""How body 4 of the codec `klt` becomes coefficients or images: all of it, or a part, at any level."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH, basis_of
from clrelight.codec.bodies import Body
from clrelight.codec.damage import Damage
from clrelight.codec.entropy.unit_index import Stored
from clrelight.codec.entropy.units import MARGIN, PRECINCT, tile_sides
from clrelight.codec.factored import finite_images
from clrelight.codec.formats.klt_regions import Held, UnitReader
from clrelight.codec.formats.klt_rows import sums_by_rows
from clrelight.codec.formats.klt_salvage import Salvage
from clrelight.codec.formats.klt_units import Parsed
from clrelight.codec.formats.klt_unmix import Unmixing
from clrelight.codec.streams import Target
from clrelight.codec.transforms.code_values import bent
from clrelight.codec.views import Region
from clrelight.codec.workspace import Shape
from clrelight.device import Device
from clrelight.errors import PayloadError
from clrelight.harmonics.index import degree_of
from clrelight.matmul import multiply_columns

_SIDE, _LARGER = PRECINCT + 2 * MARGIN, 0.8
"""Rows that a precinct's transform looks at; of a strip's bytes, those of pieces at the least for which it is taken."""
_KEPT_BYTES = 1 << 26
"""Bytes of planes that a view keeps, for the lights that follow the first."""


class Strips:
    """Planes of rows, decoded strip by strip."""

    def __init__(self, reader: UnitReader, shape: Shape, count: int, memory: int, device: Device) -> None:
        self._reader, self._count, self._device = reader, count, device
        _, self._height, self._width, _ = shape
        self._step, self._columns = _strip_sides(shape, count, memory)
        self._held: list[Held] = []

    def rows(self, first: int, end: int) -> Iterator[Held]:
        """Yield the planes of some rows; they are asked for from top to bottom."""
        while first < end:
            if not any(part.region.top <= first < part.region.bottom for part in self._held):
                top = first // self._step * self._step
                self._held = []  # its memory goes first
                self._held = self._decode(top, min(top + self._step, self._height))
            last = min(end, *(part.region.bottom for part in self._held if part.region.bottom > first))
            for part in self._held:
                if part.region.top <= first < part.region.bottom:
                    yield part.rows(first, last)
            first = last

    def _decode(self, top: int, bottom: int) -> list[Held]:
        whole = Region(top, 0, bottom, self._width)
        if self._columns >= self._width or not self._count:
            return list(self._reader.parts(whole))
        planes_jyx = np.empty((self._count, bottom - top, self._width), np.float32)
        for left in range(0, self._width, self._columns):
            right = min(left + self._columns, self._width)
            planes_jyx[:, :, left:right] = self._reader.planes(Region(top, left, bottom, right))
        return [Held(whole, self._device.hold(planes_jyx))]


def bytes_at_once(shape: Shape, count: int) -> int:
    """Return about the bytes that planes take at the least while a body is decoded."""
    _, height, width, _ = shape
    return 4 * count * (min(height, PRECINCT) * width + 2 * min(height, _SIDE) * min(width, _SIDE))


def _strip_sides(shape: Shape, count: int, memory: int) -> tuple[int, int]:
    """Return the rows of strips, and the columns that are decoded together: all where they fit half of the memory.

    In pieces, units at the edges of precincts are decoded up to nine times, in strips as wide as the image up to three
    times: these are taken where they need no more, or at most a quarter where not even pieces fit.
    """
    _, height, width, _ = shape
    half = memory // 2  # the window of a strip, and what is made of it
    if 4 * count * height * width <= half:
        return height, width
    if (rows := half // max(4 * count * width, 1) - 2 * MARGIN) >= PRECINCT:
        return rows // PRECINCT * PRECINCT, width
    rows, columns = tile_sides(height, width, count, half)
    pieces, wide = bytes_at_once(shape, count), 4 * count * min(height, _SIDE) * width
    if columns < width and wide * (_LARGER if memory < pieces else 1.0) <= pieces:
        return min(PRECINCT, height), width
    return rows, columns


class Maker(Protocol):
    """Makes coefficients of planes."""

    def coefficients(self, parts: Iterable[Held], region: Region) -> NDArray[np.float32]:
        """Return coefficients (n_coeff, height, width, channel) of a region, of its planes in steps, part by part."""
        ...


class UnitsView(ABC):
    """A body in units that is relit without its coefficients: light by light, only sums of planes are transformed back.

    See `clrelight.codec.views.Regions`.
    """

    def __init__(self, body: Body, stored: Stored, shape: Shape, damage: Damage | None) -> None:
        self._stored, self._shape, self._basis = stored, shape, SH
        self._planes = UnitPlanes(body, stored, shape, damage)

    def take_basis(self, basis: str) -> None:
        """Take the coefficients to be of a basis, which bodies need not say; PayloadError of those that say another."""
        self._basis = basis

    @property
    def curve(self) -> str:
        """Curve that what is shown lies behind."""
        return "linear"

    def shown(self, region: Region, device: Device) -> NDArray[np.float32]:
        """Return coefficients of what a part shows at any light, behind the curve."""
        return self.coefficients(region, device)

    def _functions_at(self, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        return basis_of(self._basis).evaluate(directions_i3, degree_of(self._shape[0]))

    @abstractmethod
    def _maker(self, device: Device) -> Maker:
        """Return what makes coefficients."""

    @abstractmethod
    def relight_rows(
        self, directions_i3: NDArray[np.float64], region: Region, device: Device
    ) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Yield rows of a part of the images at a level, from top to bottom, each band with its place among them."""

    def relight_region(self, directions_i3: NDArray[np.float64], region: Region, device: Device) -> NDArray[np.float32]:
        """Return a part of the images at a level."""
        images_ihwc = np.empty((len(directions_i3), *region.shape, self._shape[3]), np.float32)
        for rows, band_ihwc in self.relight_rows(directions_i3, region, device):
            images_ihwc[:, rows] = band_ihwc
        return images_ihwc

    def to_coeffs(self, device: Device) -> NDArray[np.float32]:
        """Return the (n_coeff, height, width, channel) float32 coefficients."""
        return self.coefficients(Region(0, 0, *self._shape[1:3]), device)

    def coefficients(self, region: Region, device: Device) -> NDArray[np.float32]:
        """Return those of a part, at its level; only units that it hangs on are read."""
        return self._maker(device).coefficients(self._planes.parts(region, device), region)

    def put_rows(self, target: Target, device: Device) -> None:
        """Put all coefficients, strip by strip."""
        maker, strips = self._maker(device), self._planes.strips(target.workspace.memory_bytes, device)
        for part in target.row_parts():
            region = Region(part.start, 0, part.stop, self._shape[2])
            target.put_rows(part.start, maker.coefficients(strips.rows(part.start, part.stop), region))

    def relight(self, directions_i3: NDArray[np.float64], device: Device) -> NDArray[np.float32]:
        """Return images (n_light, height, width, channel), float32 linear radiance in units of the peak."""
        return self.relight_region(directions_i3, Region(0, 0, *self._shape[1:3]), device)

    def _relit(
        self,
        region: Region,
        operator_mj: NDArray[np.float64],
        device: Device,
        finish: Callable[[NDArray[np.float32]], NDArray[np.float32]],
    ) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Yield images of which `finish` makes what is shown; a row of the operator is a light's channel."""
        channel = self._shape[3]
        n_light = len(operator_mj) // channel
        for rows, sums in self._planes.sums(region, operator_mj, device):
            with np.errstate(over="ignore", invalid="ignore"):  # what no encoder wrote: it is refused here
                band = sums.reshape(n_light, channel, *sums.shape[1:]).transpose(0, 2, 3, 1)
                shown = finite_images(finish(band))
            yield rows, shown


class UnitView(UnitsView):
    """Body 4 of `klt`. Behind a curve, its code values are evaluated at a light, and become radiance then."""

    def __init__(self, body: Body, parsed: Parsed, shape: Shape, damage: Damage | None = None) -> None:
        super().__init__(body, parsed.stored, shape, damage)
        self._parsed, self._basis = parsed, parsed.head.basis

    def take_basis(self, basis: str) -> None:
        """See `UnitsView`."""
        if basis != self._basis:
            raise PayloadError(f"the klt body is of basis {self._basis}, what it comes with says {basis}")

    @property
    def curve(self) -> str:
        """See `UnitsView`."""
        return self._parsed.head.transfer

    def shown(self, region: Region, device: Device) -> NDArray[np.float32]:
        """See `UnitsView`."""
        maker = Unmixing(self._parsed, self._shape, device, as_coded=True)
        return maker.coefficients(self._planes.parts(region, device), region)

    def _maker(self, device: Device) -> Maker:
        return Unmixing(self._parsed, self._shape, device)

    def relight_rows(
        self, directions_i3: NDArray[np.float64], region: Region, device: Device
    ) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """See `UnitsView`."""
        channel = self._shape[3]
        basis_ik = self._functions_at(directions_i3)
        operator_mj = np.einsum("ik,kcj->icj", basis_ik, self._parsed.operator_kcj).reshape(len(basis_ik) * channel, -1)
        count = self._parsed.head.n_plane

        def finish(images: NDArray[np.float32]) -> NDArray[np.float32]:
            images += operator_mj[:, count].astype(np.float32).reshape(-1, 1, 1, channel)
            return bent(images, device, decode=True) if self._parsed.head.transfer == "srgb" else images

        return self._relit(region, operator_mj[:, :count], device, finish)


class UnitPlanes:
    """Planes of a body in units, and sums of them times weights, of parts of the image.

    Parameters
    ----------
    body : Body
    stored : Stored
        Where its streams lie.
    shape : tuple of int
        (n_coeff, height, width, channel).
    damage : Damage, optional
        Told of units that are damaged, where they are streams of their own; without it they are a PayloadError.
    """

    def __init__(self, body: Body, stored: Stored, shape: Shape, damage: Damage | None = None) -> None:
        self._body, self._stored, self._shape = body, stored, shape
        self._salvage: Salvage | None = None
        if damage is not None and stored.n_plane and not stored.together:
            self._salvage = Salvage(shape, stored, damage)
        self._planes_jyx: NDArray[np.float32] | None = None  # of a small image, once they are asked for

    def parts(self, region: Region, device: Device) -> Iterator[Held]:
        """Yield the planes of a region, part by part."""
        return self._reader(device).parts(region)

    def strips(self, memory: int, device: Device) -> Strips:
        """Return what gives planes of all rows, in so many bytes."""
        return Strips(self._reader(device), self._shape, self._stored.n_plane, memory, device)

    def _reader(self, device: Device) -> UnitReader:
        return UnitReader(self._body, self._stored, self._shape, device, self._salvage)

    def sums(
        self, region: Region, operator_mj: NDArray[np.float64], device: Device
    ) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Yield rows of the region and their sums (n_sum, rows, width), from top to bottom.

        By whichever is less work: sums of wavelet coefficients, or planes first.
        """
        n_sum, count = operator_mj.shape
        reader = self._reader(device)
        height, width = region.shape
        if not count:
            yield slice(0, height), np.zeros((n_sum, height, width), np.float32)
        elif region == reader.whole and 4 * count * height * width <= _KEPT_BYTES:
            if self._planes_jyx is None:
                self._planes_jyx = reader.planes(region)
            yield slice(0, height), _sum_planes(self._planes_jyx, operator_mj, device)
        elif n_sum >= count:
            yield slice(0, height), _sum_planes(reader.planes(region), operator_mj, device)
        else:
            for part in sums_by_rows(reader, region, operator_mj, self._shape[1:3], device):
                yield slice(part.region.top - region.top, part.region.bottom - region.top), part.array(device)


def _sum_planes(
    planes_jyx: NDArray[np.float32], operator_mj: NDArray[np.float64], device: Device
) -> NDArray[np.float32]:
    count, height, width = planes_jyx.shape
    return multiply_columns(device, operator_mj, planes_jyx.reshape(count, -1)).reshape(-1, height, width)
