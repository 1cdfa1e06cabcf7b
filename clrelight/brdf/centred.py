"""What a reflectance is when its angles are taken from a central direction, and how those angles see the normal."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

CENTRES = ("normal", "reflection", "tangent")
"""Directions that angles are taken from: the normal, the view mirrored at it, or a tangent of the surface."""


@dataclass(frozen=True)
class CentredBrdf(ABC):
    """A BRDF times the cosine of the light's angle, in angles from its central direction C.

    ``cos(theta_i) = C . L``, ``cos(theta_o) = C . V`` (frequency-space-environment-maps, 3.1), and ``phi`` is the
    azimuth of V less that of L about C. About the reflection vector ``theta_o`` runs to pi, where the view grazes the
    surface. All are even in ``phi``.

    Attributes
    ----------
    id : str
        Name on the command line and in files.
    centre : str
        One of `CENTRES`.
    is_radial : bool
        Whether it depends on ``theta_i`` alone: its maps need the order P = 0 only.
    has_azimuth : bool
        Whether it depends on ``phi``: else all coefficients of q > 0 are 0.
    least_angles : int
        How many angles ``theta_i`` of Gauss's rule in 0 .. pi its narrowest lobe takes, to some 1e-5 of its integral.
    """

    id: ClassVar[str]
    centre: ClassVar[str] = "reflection"
    is_radial: ClassVar[bool] = False
    has_azimuth: ClassVar[bool] = True

    @property
    def channels(self) -> int:
        """1 or 3."""
        return 1

    @property
    def least_angles(self) -> int:
        """See above; 1 where nothing is narrower than what the orders of any map resolve."""
        return 1

    @abstractmethod
    def evaluate(
        self, theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the values (..., channel) in 1/sr; angles in radians are broadcast against each other."""

    @abstractmethod
    def to_config(self) -> dict[str, Any]:
        """Return its name and numbers, JSON values only."""


@dataclass(frozen=True)
class Cosines:
    """Cosines between light L, view V and normal N, each (...,) float64."""

    light_normal: NDArray[np.float64]
    view_normal: NDArray[np.float64]
    light_view: NDArray[np.float64]

    @property
    def half_normal(self) -> NDArray[np.float64]:
        """Of the angle between the normal and the half vector (L + V) / |L + V|."""
        return np.clip((self.light_normal + self.view_normal) / self.half_length, -1.0, 1.0)

    @property
    def half_length(self) -> NDArray[np.float64]:
        """``|L + V|``, twice the cosine between the light and the half vector; never 0."""
        return np.sqrt(np.maximum(2.0 + 2.0 * self.light_view, 1e-300))


def reflection_cosines(theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]) -> Cosines:
    """Return the cosines where angles are taken from the reflection vector R.

    The normal lies halfway between R and V: at ``theta_o / 2`` and V's azimuth.
    """
    across = np.sin(theta_i) * np.cos(phi)
    cosine_i = np.cos(theta_i)
    light_normal = across * np.sin(0.5 * theta_o) + cosine_i * np.cos(0.5 * theta_o)
    light_view = across * np.sin(theta_o) + cosine_i * np.cos(theta_o)
    # Where theta_o = pi the cosine is 6e-17, not 0.
    view_normal = np.broadcast_to(np.cos(0.5 * theta_o), light_normal.shape)
    return Cosines(light_normal, view_normal, light_view)


def check_positive(value: float, what: str, *, zero: bool = False) -> None:
    """Raise InputError unless a number is finite and positive, or 0 where that is allowed."""
    number = float(value)
    if not (np.isfinite(number) and (number > 0.0 or (zero and number == 0.0))):
        raise InputError(f"{what} must be a number {'of at least' if zero else 'above'} 0, got {value!r}")
