"""Decoded maps in bases of their own, and parts of them at a level of resolution."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.streams import Target
from clrelight.device import Device
from clrelight.tiles import Rectangle


@dataclass(frozen=True)
class Region(Rectangle):
    """A part of an image at a level of resolution, in pixels there."""

    level: int = 0


class View(Protocol):
    """A decoded map in a basis of its own."""

    def to_coeffs(self, device: Device) -> NDArray[np.float32]:
        """Return the (n_coeff, height, width, channel) coefficients."""
        ...

    def relight(self, directions_i3: NDArray[np.float64], device: Device) -> NDArray[np.float32]:
        """Return images (n_light, height, width, channel), float32 linear radiance in units of the peak.

        PayloadError where they are not finite: no encoder wrote such a map.
        """
        ...


class Regions(View, Protocol):
    """A map of which parts are decoded without the rest, at lower resolutions too."""

    @property
    def curve(self) -> str:
        """Curve that the values of `shown` are behind, one of `clrelight.conventions.TRANSFERS`."""
        ...

    def shown(self, region: Region, device: Device) -> NDArray[np.float32]:
        """Return coefficients of what `relight_region` evaluates at a light and then takes from behind the curve.

        Those of radiance (`coefficients`) where it is linear; else they hold only nearly what is shown.
        """
        ...

    def coefficients(self, region: Region, device: Device) -> NDArray[np.float32]:
        """Return those of a part, (n_coeff, height, width, channel); PayloadError where it is damaged."""
        ...

    def put_rows(self, target: Target, device: Device) -> None:
        """Put all of them, from top to bottom, in as little memory as the target's workspace has."""
        ...

    def relight_region(self, directions_i3: NDArray[np.float64], region: Region, device: Device) -> NDArray[np.float32]:
        """Return a part of the images that `relight` returns."""
        ...

    def relight_rows(
        self, directions_i3: NDArray[np.float64], region: Region, device: Device
    ) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Yield the same from top to bottom, each band of rows with its place among those of the part."""
        ...
