"""Reflectance of surfaces: diffuse, modified Phong, Blinn-Phong and GGX, in the frame of the normal."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

Colour = float | Sequence[float]

MAX_EXPONENT = 1e5
LEAST_ROUGHNESS = 0.02


@dataclass(frozen=True)
class Brdf(ABC):
    """What part of the light from s goes towards v, per steradian; both are unit vectors with the normal as z.

    A function is the sum of a matte part, which a vertex's albedo scales, and a glossy one, which it leaves alone. All
    are isotropic and reciprocal, and send on no more light than they get.

    Attributes
    ----------
    diffuse : float or sequence of 1 or 3 floats
        Reflectance of the matte part, 0 to 1.
    specular : float or sequence of 1 or 3 floats
        Strength of the glossy part, 0 to 1.
    """

    diffuse: Colour = 0.0
    specular: Colour = 0.0

    id: ClassVar[str]

    def __post_init__(self) -> None:
        for name in ("diffuse", "specular"):
            object.__setattr__(self, name, _colour(getattr(self, name), name))
        if len({len(self.diffuse_c), len(self.specular_c)} - {1}) > 1:
            raise InputError("diffuse and specular have 1 or 3 numbers each")
        self._check_energy()

    def _check_energy(self) -> None:
        """Raise InputError where more light would leave than arrives."""
        most = float(np.max(self.diffuse_c + self.specular_c))
        if most > 1.0 + 1e-9:
            raise InputError(f"diffuse and specular together must not exceed 1, they are {most:g}")

    @property
    def diffuse_c(self) -> NDArray[np.float64]:
        """Reflectance of the matte part as an array of 1 or 3."""
        return np.asarray(self.diffuse, np.float64)

    @property
    def specular_c(self) -> NDArray[np.float64]:
        """Strength of the glossy part as an array of 1 or 3."""
        return np.asarray(self.specular, np.float64)

    @property
    def channels(self) -> int:
        """1 or 3."""
        return max(len(self.diffuse_c), len(self.specular_c))

    def matte(self, light_i3: NDArray[np.float64], view_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the matte part (..., channel) in 1/sr; arguments (..., 3) are broadcast against each other."""
        shape = np.broadcast_shapes(light_i3.shape[:-1], view_i3.shape[:-1])
        return np.broadcast_to(self.diffuse_c / np.pi, (*shape, len(self.diffuse_c)))

    @abstractmethod
    def gloss(self, light_i3: NDArray[np.float64], view_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the glossy part (..., channel) in 1/sr, of directions above the horizon."""

    @property
    @abstractmethod
    def lobe_width(self) -> float:
        """Angle in radians from its mirror ray at which a lobe has fallen to about a third."""

    def evaluate(self, light_i3: NDArray[np.float64], view_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return f (..., channel) in 1/sr; 0 where either direction is below the horizon."""
        above = (light_i3[..., 2] > 0.0) & (view_i3[..., 2] > 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            total = self.matte(light_i3, view_i3) + self.gloss(light_i3, view_i3)
        return np.where(above[..., None], total, 0.0)

    def to_config(self) -> dict[str, Any]:
        """Return its name and numbers, JSON values only."""
        return {"brdf": self.id, **{name: _plain(value) for name, value in asdict(self).items()}}


@dataclass(frozen=True)
class Diffuse(Brdf):
    """Lambert's: alike in all directions, ``diffuse / pi``."""

    diffuse: Colour = 1.0

    id: ClassVar[str] = "diffuse"

    def _check_energy(self) -> None:
        if np.any(self.specular_c):
            raise InputError("a diffuse surface has no specular part: choose phong, blinn or ggx")

    def gloss(self, light_i3: NDArray[np.float64], view_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `Brdf`; 0."""
        return np.zeros((*np.broadcast_shapes(light_i3.shape[:-1], view_i3.shape[:-1]), 1))

    @property
    def lobe_width(self) -> float:
        """See `Brdf`."""
        return 1.0


@dataclass(frozen=True)
class Phong(Brdf):
    """The modified Phong model: ``diffuse / pi + specular (n + 2) / (2 pi) cos^n``, of the angle to the mirror ray.

    Its lobe sends on `specular` of light along the normal, less of other light (Lafortune and Willems 1994).

    Attributes
    ----------
    exponent : float
        n, 0 to `MAX_EXPONENT`.
    """

    specular: Colour = 1.0
    exponent: float = 10.0

    id: ClassVar[str] = "phong"

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_exponent(self.exponent)

    def gloss(self, light_i3: NDArray[np.float64], view_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `Brdf`."""
        mirrored = light_i3 * [-1.0, -1.0, 1.0]
        cosine = np.maximum(np.sum(mirrored * view_i3, axis=-1), 0.0)
        n = self.exponent
        return ((n + 2.0) / (2.0 * np.pi) * cosine**n)[..., None] * self.specular_c

    @property
    def lobe_width(self) -> float:
        """See `Brdf`."""
        return math.sqrt(2.0 / (self.exponent + 2.0))


@dataclass(frozen=True)
class BlinnPhong(Brdf):
    """Blinn's: a power of the cosine between the normal and the half vector, scaled to `specular` at the normal.

    Attributes
    ----------
    exponent : float
        n, 0 to `MAX_EXPONENT`.
    """

    specular: Colour = 1.0
    exponent: float = 40.0

    id: ClassVar[str] = "blinn"

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_exponent(self.exponent)

    def gloss(self, light_i3: NDArray[np.float64], view_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `Brdf`."""
        n = self.exponent
        scale = (n + 2.0) * (n + 4.0) / (8.0 * np.pi * (2.0 ** (-0.5 * n) + n))  # 1 along the normal, by integration
        return (scale * _half(light_i3, view_i3)[..., 2] ** n)[..., None] * self.specular_c

    @property
    def lobe_width(self) -> float:
        """See `Brdf`; the half vector turns half as far as the view."""
        return 2.0 * math.sqrt(2.0 / (self.exponent + 2.0))


@dataclass(frozen=True)
class Ggx(Brdf):
    """Microfacets of the GGX distribution (Walter et al. 2007), Smith's shadowing, Schlick's Fresnel.

    ``F D G / (4 n.s n.v)`` with ``a = roughness**2`` and the height-correlated G. The matte part is what the layer of
    facets lets through (Ashikhmin and Shirley 2000, eq. 5), so that both together never exceed the light.

    Attributes
    ----------
    specular : float or sequence
        Reflectance of the facets along their normal: 0.04 of plastic, near 1 of metals.
    roughness : float
        `LEAST_ROUGHNESS` to 1.
    """

    specular: Colour = 0.04
    roughness: float = 0.3

    id: ClassVar[str] = "ggx"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not LEAST_ROUGHNESS <= self.roughness <= 1.0:
            raise InputError(f"roughness must be from {LEAST_ROUGHNESS:g} to 1, got {self.roughness!r}")

    def _check_energy(self) -> None:
        """None is needed: the matte part gets what is left."""

    def matte(self, light_i3: NDArray[np.float64], view_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `Brdf`."""
        through = [1.0 - (1.0 - 0.5 * each[..., 2]) ** 5 for each in (light_i3, view_i3)]
        colour = 28.0 / (23.0 * np.pi) * self.diffuse_c * (1.0 - self.specular_c)
        return (through[0] * through[1])[..., None] * colour

    def gloss(self, light_i3: NDArray[np.float64], view_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `Brdf`."""
        half = _half(light_i3, view_i3)
        facing = np.clip(np.sum(light_i3 * half, axis=-1), 0.0, 1.0)[..., None]
        fresnel = self.specular_c + (1.0 - self.specular_c) * (1.0 - facing) ** 5
        into, density = ggx_facets(light_i3[..., 2], view_i3[..., 2], half[..., 2], self.roughness**4)
        return fresnel * (density * 0.5 / into)[..., None]

    @property
    def lobe_width(self) -> float:
        """See `Brdf`."""
        return 2.0 * self.roughness**2


BRDFS: dict[str, tuple[type[Brdf], str | None]] = {
    "diffuse": (Diffuse, None),
    "phong": (Phong, "exponent"),
    "blinn": (BlinnPhong, "exponent"),
    "ggx": (Ggx, "roughness"),
}
"""Functions by name, and what the number behind a colon is."""


def parse_brdf(text: str, diffuse: Colour | None = None, specular: Colour | None = None) -> Brdf:
    """Return the function that a text such as ``phong:20``, ``ggx:0.3`` or ``diffuse`` names.

    `diffuse` and `specular` replace its own; InputError where the text names none.
    """
    name, colon, number = str(text).partition(":")
    if name not in BRDFS or bool(colon) > (BRDFS[name][1] is not None):
        raise InputError(f"a BRDF is diffuse, phong:EXPONENT, blinn:EXPONENT or ggx:ROUGHNESS, got {text!r}")
    kind, parameter = BRDFS[name]
    given: dict[str, Any] = {"diffuse": diffuse, "specular": specular}
    if colon and parameter:
        try:
            given[parameter] = float(number)
        except ValueError:
            raise InputError(f"{name} takes a number behind the colon, got {number!r}") from None
    return kind(**{key: value for key, value in given.items() if value is not None})


def ggx_facets(light_z: NDArray, view_z: NDArray, half_z: NDArray, a2: float | np.float32) -> tuple[NDArray, NDArray]:
    """Return ``2 n.s n.v / G`` and D of the squared width a2, of cosines to the normal and in their type.

    D G / (4 n.s n.v) is D / 2 over the first: no quotient of two small numbers at the horizon (Heitz 2014, eq. 99).
    """
    into = view_z * np.sqrt(a2 + (1 - a2) * light_z**2) + light_z * np.sqrt(a2 + (1 - a2) * view_z**2)
    return into, a2 / (np.pi * ((a2 - 1) * half_z**2 + 1) ** 2)


def _half(light_i3: NDArray[np.float64], view_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    total = light_i3 + view_i3
    return total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-300)


def _check_exponent(exponent: float) -> None:
    if not 0.0 <= exponent <= MAX_EXPONENT:
        raise InputError(f"exponent must be from 0 to {MAX_EXPONENT:g}, got {exponent!r}")


def _colour(value: Any, name: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(v) for v in np.ravel(np.asarray(value, np.float64)))
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) not in (1, 3) or not all(0.0 <= v <= 1.0 for v in numbers):
        raise InputError(f"{name} takes 1 or 3 numbers from 0 to 1, got {value!r}")
    return numbers


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return list(value)
    return float(value) if isinstance(value, int | float) and not math.isnan(value) else value
