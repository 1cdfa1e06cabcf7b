"""Light on functions at places of a surface: what is far away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.rotation_batch import rotate_many
from clrelight.lighting.lamps import WHITE, checked_colour
from clrelight.lighting.light import Light
from clrelight.lighting.relighting import check_channels
from clrelight.transfer.lit_functions import Functions


class Source(Protocol):
    """Light on functions at places."""

    @property
    def is_distant(self) -> bool:
        """Whether it is the same at all places."""
        ...

    def shade(self, functions: Functions) -> NDArray[np.float64]:
        """Return the radiance that each function makes of it, (n, channel) float64."""
        ...


@dataclass(frozen=True)
class DistantLight:
    """Light from everywhere, the same for all vertices."""

    light: Light
    is_distant = True

    def shade(self, functions: Functions) -> NDArray[np.float64]:
        """See `Source`. In local frames the light is turned into each (noise-resistant-fitting, section II-B)."""
        used = coefficient_count(min(self.light.degree, functions.light_degree))
        coeffs_kc = self.light.coeffs_kc[:used]
        if functions.frames_n33 is None:
            return functions.receive(coeffs_kc[None])
        return functions.receive(rotate_many(coeffs_kc, functions.frames_n33))


@dataclass(frozen=True)
class DirectionalLight:
    """A distant lamp; a white surface that faces it reflects the radiance ``colour / pi``."""

    direction_3: Sequence[float]
    colour: Sequence[float] = WHITE
    is_distant = True

    def __post_init__(self) -> None:
        set_vector(self, "direction_3", "a direction to a light")
        if not np.any(self.direction_3):
            raise InputError("a direction to a light must not be all zeros")
        checked_colour(self.colour)

    def shade(self, functions: Functions) -> NDArray[np.float64]:
        """See `Source`: the functions themselves, in the direction to the lamp (noise-resistant-fitting, eq. 6)."""
        d_3 = np.asarray(self.direction_3) / np.abs(self.direction_3).max()
        d_3 = d_3 / np.linalg.norm(d_3)
        values_nc = functions.evaluate(np.broadcast_to(d_3, functions.points_n3.shape))
        return tint(values_nc, checked_colour(self.colour))


def tint(values_nc: NDArray[np.float64], colour_c: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values times a colour, either of 1 or 3 channels; InputError for 2 or others beside 3."""
    if values_nc.shape[1] > 1 and len(colour_c) > 1:
        check_channels(values_nc.shape[1], len(colour_c))
    return values_nc * colour_c


def set_vector(record: object, label: str, what: str) -> None:
    """Make a field of a frozen record a tuple of three floats; InputError if it is none."""
    value = np.asarray(getattr(record, label), np.float64)
    if value.shape != (3,) or not np.isfinite(value).all():
        raise InputError(f"{what} must be three finite numbers, got {getattr(record, label)}")
    object.__setattr__(record, label, tuple(float(v) for v in value))


def sum_lights(lights: Sequence[Light]) -> NDArray[np.float64]:
    """Return the coefficients of lights from everywhere together, (n_coeff, 1 or 3), of the largest degree."""
    coeffs_kc = np.zeros((max(len(light.coeffs_kc) for light in lights), max(light.channels for light in lights)))
    for light in lights:
        coeffs_kc[: len(light.coeffs_kc)] += light.coeffs_kc
    return coeffs_kc


def add_light(total_nc: NDArray[np.float64], more_nc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of two lots of radiance, of which one may be gray."""
    if 1 not in (total_nc.shape[1], more_nc.shape[1]):
        check_channels(total_nc.shape[1], more_nc.shape[1])
    return total_nc + more_nc


def shade_by(sources: Sequence[Source], functions: Functions) -> NDArray[np.float64]:
    """Return the radiance that each function makes of several lights together, (n, channel) float64."""
    total_nc = sources[0].shade(functions)
    for source in sources[1:]:
        total_nc = add_light(total_nc, source.shade(functions))
    return total_nc
