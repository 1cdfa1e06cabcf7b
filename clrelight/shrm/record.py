"""The spherical harmonic reflection map: for each central direction of a lat-long map, coefficients of the view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CENTRES
from clrelight.described import Described
from clrelight.errors import InputError
from clrelight.harmonics.index import degree_of

FRAMES = ("local", "global", "zonal")
"""Where views are measured: in the frame ``Rz(beta) Ry(alpha)`` of each central direction, in that of the world, or by
their angle from the central direction alone, where no azimuth counts: coefficients of q = 0 only."""


@dataclass(frozen=True, repr=False)
class Shrm(Described):
    """Radiance reflected towards every view, for every central direction; checked when made.

    ``B(alpha, beta, view) = sum_k maps_k(alpha, beta) y_k(view)`` (frequency-space-environment-maps, eq. 6 and 7), with
    our real harmonics: where B_pq is the paper's for q >= 0, but for Condon and Shortley's sign, the maps of q and -q
    hold ``sqrt(2) Re B_pq`` and ``-sqrt(2) Im B_pq``. A zonal map holds q = 0 alone, ``sum_p maps_p f_p0(theta_o)``.

    Attributes
    ----------
    maps_khwc : ndarray, shape ((P + 1)**2, height, width, channel), zonal (P + 1, ...), float32 or float64
        Linear radiance. Row h has ``alpha = pi (h + 1/2) / height``, columns the azimuths ``beta`` of
        `harmonics.latlong.longitude_azimuths`: no row lies at a pole.
    frame : str
        One of `FRAMES`.
    degree : int
        F, the largest degree of light that counted.
    centre : str
        What the central direction is, one of `brdf.centred.CENTRES`.
    source, axes : str
        Of the light, see `lighting.Light`.
    config : mapping
        Of the reflectance, JSON values only.
    """

    maps_khwc: NDArray[np.floating]
    frame: str
    degree: int
    centre: str = "reflection"
    source: str = ""
    axes: str = ""
    config: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape, dtype = self.maps_khwc.shape, self.maps_khwc.dtype
        if dtype not in (np.float32, np.float64) or len(shape) != 4 or min(shape) < 1 or shape[3] not in (1, 3):
            raise InputError(
                f"a reflection map is float32 or float64 (coefficient, height, width, 1 or 3), got {dtype} {shape}"
            )
        if self.frame not in FRAMES:
            raise InputError(f"frame must be one of {', '.join(FRAMES)}, got {self.frame!r}")
        try:
            if self.frame != "zonal":
                degree_of(shape[0])
        except ValueError as error:
            raise InputError(f"reflection map: {error}") from None
        if self.centre not in CENTRES:
            raise InputError(f"centre must be one of {', '.join(CENTRES)}, got {self.centre!r}")
        if self.degree < 0:
            raise InputError(f"the degree F must be at least 0, got {self.degree}")
        if not np.isfinite(self.maps_khwc).all():
            raise InputError("values of a reflection map must be finite numbers")

    @property
    def order(self) -> int:
        """P, the largest p."""
        return len(self.maps_khwc) - 1 if self.frame == "zonal" else degree_of(len(self.maps_khwc))

    @property
    def channels(self) -> int:
        """1 or 3."""
        return int(self.maps_khwc.shape[3])

    def angles(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ``alpha`` of the rows and ``beta`` of the columns, in radians."""
        return grid_angles(*self.maps_khwc.shape[1:3])


def grid_angles(height: int, width: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the polar angles of rows (height,) and azimuths of columns (width,) of a reflection map, in radians."""
    from clrelight.harmonics.latlong import longitude_azimuths  # loads SciPy, which reading files can do without

    return np.pi * (np.arange(height) + 0.5) / height, longitude_azimuths(width)


def grid_directions(height: int, width: int) -> NDArray[np.float64]:
    """Return the central directions (height, width, 3) of a reflection map, unit vectors."""
    alpha_h, beta_w = grid_angles(height, width)
    sine_h1 = np.sin(alpha_h)[:, None]
    x_hw, y_hw = sine_h1 * np.cos(beta_w), sine_h1 * np.sin(beta_w)
    return np.stack([x_hw, y_hw, np.broadcast_to(np.cos(alpha_h)[:, None], x_hw.shape)], axis=-1)
