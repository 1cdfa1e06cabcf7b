"""Lights that stand near a surface: where they are seen from each pixel, and how much of them arrives there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.directions import are_unit
from clrelight.errors import InputError
from clrelight.light_files import read_light_file, read_table


@dataclass(frozen=True)
class NearLights:
    """Positions of point lights beside the pixels they light.

    Attributes
    ----------
    positions_i3 : ndarray, shape (n_light, 3), float64
        In pixels from the middle of the image, z from the surface's mean height towards the camera.
    """

    positions_i3: NDArray[np.float64]

    def __post_init__(self) -> None:
        bad = np.flatnonzero(~np.isfinite(self.positions_i3).all(axis=1) | ~(self.positions_i3[:, 2] > 0.0))
        if len(bad):
            raise InputError(
                f"light {bad[0]} lies at z = {self.positions_i3[bad[0], 2]:.4g} pixels, "
                "expected lights in front of the surface, z > 0"
            )

    @classmethod
    def of(cls, positions_i3: NDArray[np.float64], n_light: int, pixel: float) -> NearLights:
        """Return lights at positions in the unit that a pixel is `pixel` wide in; InputError if they do not fit."""
        if not (np.isfinite(pixel) and pixel > 0.0):
            raise InputError(f"the width of a pixel must be positive, got {pixel:g}")
        if positions_i3.shape != (n_light, 3):
            raise InputError(f"positions must be ({n_light}, 3), a line a light, got shape {positions_i3.shape}")
        return cls(positions_i3 / pixel)

    @property
    def directions_i3(self) -> NDArray[np.float64]:
        """Unit vectors from the middle of the image."""
        return self.positions_i3 / np.linalg.norm(self.positions_i3, axis=1, keepdims=True)

    def falloff(self, place_3p: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return squared distances from places to lights, (n_light, P), in units of their mean from the middle."""
        unit = np.mean(np.sum(self.positions_i3**2, axis=1))
        squared_ip = np.zeros((len(self.positions_i3), place_3p.shape[1]))
        for axis in range(3):
            squared_ip += (self.positions_i3[:, axis, None] - place_3p[axis]) ** 2
        return (squared_ip / unit).astype(np.float32)

    def towards(self, place_3p: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return unit vectors from places to lights, (n_light, P, 3)."""
        towards_ip3 = self.positions_i3[:, None] - place_3p.T.astype(np.float64)
        return (towards_ip3 / np.linalg.norm(towards_ip3, axis=2, keepdims=True)).astype(np.float32)


def places(
    rows_p: NDArray[np.intp], columns_p: NDArray[np.intp], heights_hw: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Return positions of pixels, (3, P), in pixels from the middle of the image."""
    height, width = heights_hw.shape
    x_p, y_p = columns_p - (width - 1) / 2.0, (height - 1) / 2.0 - rows_p
    return np.stack([x_p, y_p, heights_hw[rows_p, columns_p]]).astype(np.float32)


def read_positions(path: Path, n_light: int, pixel: float) -> tuple[NearLights, list[str]]:
    """Return lights from a file of positions x y z, written as light files are, and notes.

    Parameters
    ----------
    path : Path
    n_light : int
        Lights of the stack.
    pixel : float
        Width of a pixel on the object in the file's unit.

    Raises
    ------
    InputError
        If the file does not parse, holds another number of lights, or a light is not in front of the surface.
    """
    file = read_light_file(path)
    if len(file.directions_i3) != n_light:
        raise InputError(f"{path} holds {len(file.directions_i3)} positions, the stack has {n_light} lights")
    notes = [*file.notes]
    if are_unit(file.directions_i3):
        notes.append(f"{path.name}: all positions are 1 from the origin; are they directions?")
    return NearLights.of(file.directions_i3, n_light, pixel), notes


def read_gains(path: Path, n_light: int, channel: int) -> NDArray[np.float64]:
    """Return intensities of lights, (n_light, 1 or channel), from a table with a line or a column a light.

    Raises
    ------
    InputError
        If the table does not fit the stack, or a number is not positive.
    """
    values = read_table(path)
    if values.shape[0] != n_light and values.shape[1] == n_light:
        values = values.T
    try:
        return check_gains(values, n_light, channel)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def check_gains(gains_ic: NDArray[np.float64], n_light: int, channel: int) -> NDArray[np.float64]:
    """Return gains by their mean; InputError where they do not fit a stack, or one is not positive."""
    if gains_ic.ndim != 2 or gains_ic.shape[0] != n_light or gains_ic.shape[1] not in (1, channel):
        wanted = f"{n_light}×1" + (f" or {n_light}×{channel}" if channel > 1 else "")
        raise InputError(f"{'×'.join(map(str, gains_ic.shape))} intensities, expected {wanted}")
    bad = np.flatnonzero(~(np.isfinite(gains_ic) & (gains_ic > 0.0)).all(axis=1))
    if len(bad):
        raise InputError(f"light {bad[0]} has intensity {gains_ic[bad[0]].tolist()}, expected positive numbers")
    return np.ascontiguousarray(gains_ic / gains_ic.mean())
