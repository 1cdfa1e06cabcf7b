"""Distant light as spherical-harmonic coefficients: the record, windows against ringing, turns about z."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.described import Described
from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.harmonics.hemisphere import project_onto_hemisphere
from clrelight.harmonics.index import coefficient_count, coefficient_index, degree_of, degrees_of_coefficients
from clrelight.harmonics.windows import window_factors


@dataclass(frozen=True, repr=False)
class Light(Described):
    """Radiance arriving from every direction of the sphere, band-limited; checked when made.

    Attributes
    ----------
    coeffs_kc : ndarray, shape (n_coeff, channel), float64
        Linear radiance; ``k = l (l + 1) + m``, 1 or 3 channels.
    source : str
        What it was made of.
    axes : str
        Where our x, y, z point in the source's view (see `layouts.parse_axes`); empty where it has no view.
    config : mapping
        How it was made, JSON values only.
    """

    coeffs_kc: NDArray[np.float64]
    source: str = ""
    axes: str = ""
    config: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = self.coeffs_kc.shape
        if self.coeffs_kc.dtype != np.float64 or len(shape) != 2 or shape[1] not in (1, 3):
            raise InputError(f"light must be float64 (n_coeff, 1 or 3), got {self.coeffs_kc.dtype} {shape}")
        try:
            degree_of(shape[0])
        except ValueError as error:
            raise InputError(f"light: {error}") from None
        bad = np.argwhere(~np.isfinite(self.coeffs_kc))
        if len(bad):
            k, c = (int(v) for v in bad[0])
            raise InputError(f"coefficient {k} of channel {c} is {self.coeffs_kc[k, c]}, expected a finite number")

    @property
    def degree(self) -> int:
        """Largest degree."""
        return degree_of(len(self.coeffs_kc))

    @property
    def channels(self) -> int:
        """1 or 3."""
        return int(self.coeffs_kc.shape[1])


def apply_window(light: Light, window: str, width: float | None = None) -> Light:
    """Return the light with each degree scaled by `window_factors`."""
    factors = window_factors(window, light.degree, width)[degrees_of_coefficients(light.degree)]
    config = {**light.config, "window": window, "window_width": light.degree + 1.0 if width is None else float(width)}
    return replace(light, coeffs_kc=factors[:, None] * light.coeffs_kc, config=config)


def turn_about_z(light: Light, angle: float) -> Light:
    """Return the light turned about z by `angle` in radians, counterclockwise seen from +z.

    ``f'(phi) = f(phi - angle)``, so each pair of orders m and -m turns by ``m angle``; exact.
    """
    turned = light.coeffs_kc.copy()
    for l in range(1, light.degree + 1):
        for m in range(1, l + 1):
            plus, minus = coefficient_index(l, m), coefficient_index(l, -m)
            cosine, sine = np.cos(m * angle), np.sin(m * angle)
            turned[plus] = cosine * light.coeffs_kc[plus] - sine * light.coeffs_kc[minus]
            turned[minus] = sine * light.coeffs_kc[plus] + cosine * light.coeffs_kc[minus]
    return replace(light, coeffs_kc=turned)


def set_coefficients(light: Light, changes: Mapping[tuple[int, int], tuple[float, ...]]) -> Light:
    """Return the light with some coefficients replaced, by (l, m).

    One number stands for all channels. Beyond the light's own degree it grows: the coefficients between are 0.
    """
    degree = max([light.degree, *(l for l, _ in changes)])
    if degree > MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    coeffs_kc = np.zeros((coefficient_count(degree), light.channels))
    coeffs_kc[: len(light.coeffs_kc)] = light.coeffs_kc
    for (l, m), values in changes.items():
        if abs(m) > l:
            name = f"L{l}{m}" if l < 10 > m else f"L{l},{m}"
            raise InputError(f"there is no coefficient {name}: |m| is at most {l}")
        if len(values) not in (1, light.channels):
            raise InputError(
                f"L{l}{m} needs {'1 or 3 numbers' if light.channels == 3 else '1 number'}, got {len(values)}"
            )
        coeffs_kc[coefficient_index(l, m)] = values
    return replace(light, coeffs_kc=coeffs_kc)


def share_below(light: Light) -> float:
    """Return the part of the light, over all channels, that comes from below the horizon (z < 0).

    Of the light as its degree shows it, which rings: it may lie a little outside 0 .. 1. 0 for no light at all.
    """
    total = float(light.coeffs_kc[0].sum())
    return 1.0 - float(project_onto_hemisphere(light.coeffs_kc, 0).sum()) / total if total else 0.0
