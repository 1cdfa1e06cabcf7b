"""Reflectances of glossy surfaces in the frame of the normal: modified Phong, Blinn-Phong, and a GGX microfacet lobe.

All are reciprocal and reflect no more than they receive (`tests/test_scenes_materials.py`). A material is a few lobes,
each a colour times a function of the two directions, so that colours meet the sum over lights once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

Colour = tuple[float, float, float]

_LEAST_COSINE = 1e-4


class Material(Protocol):
    """What a surface does with light."""

    def lobes(
        self, lights_l3: NDArray[np.float32], views_i3: NDArray[np.float32]
    ) -> list[tuple[Colour, NDArray[np.float32]]]:
        """Return colours and factors of (light, view) whose products sum to the BRDF in 1/sr; all are above z = 0."""
        ...


@dataclass(frozen=True)
class Phong:
    """The modified Phong model (Lafortune and Willems 1994, eq. 8): ``kd / pi + ks (n + 2) / (2 pi) cos^n a``.

    a is the angle between the view and the mirrored light. Energy: kd + ks <= 1.

    Attributes
    ----------
    diffuse, specular : tuple of float
        kd and ks, linear RGB.
    exponent : float
        n.
    """

    diffuse: Colour = (0.40, 0.34, 0.27)
    specular: Colour = (0.35, 0.33, 0.30)
    exponent: float = 24.0

    def __post_init__(self) -> None:
        _check_colours(self.diffuse, self.specular, shared=True)
        _check_range("exponent", self.exponent, 0.0, 1e4)

    def lobes(
        self, lights_l3: NDArray[np.float32], views_i3: NDArray[np.float32]
    ) -> list[tuple[Colour, NDArray[np.float32]]]:
        """Return the diffuse and the mirror's lobe."""
        mirrored_l3 = lights_l3 * np.float32([-1.0, -1.0, 1.0])
        shape_li = np.maximum(mirrored_l3 @ views_i3.T, 0.0) ** np.float32(self.exponent)
        glossy_li = np.float32((self.exponent + 2.0) / (2.0 * math.pi)) * shape_li
        return [(self.diffuse, np.full_like(shape_li, 1.0 / math.pi)), (self.specular, glossy_li)]


@dataclass(frozen=True)
class Blinn:
    """Blinn's halfway vector with the energy of its peak (Giesen 2009): ``ks (n+2)(n+4) / (8 pi (2^(-n/2)+n)) cos^n h``.

    h is the angle between the normal and the halfway vector; beside it ``kd / pi``. Attributes as of `Phong`.
    """

    diffuse: Colour = (0.40, 0.34, 0.27)
    specular: Colour = (0.35, 0.33, 0.30)
    exponent: float = 80.0

    def __post_init__(self) -> None:
        _check_colours(self.diffuse, self.specular, shared=True)
        _check_range("exponent", self.exponent, 0.0, 1e4)

    def lobes(
        self, lights_l3: NDArray[np.float32], views_i3: NDArray[np.float32]
    ) -> list[tuple[Colour, NDArray[np.float32]]]:
        """Return the diffuse lobe and that about the halfway vector."""
        n = self.exponent
        scale = (n + 2.0) * (n + 4.0) / (8.0 * math.pi * (2.0 ** (-n / 2.0) + n))
        _, upright_li = _halfway(lights_l3, views_i3)
        shape_li = upright_li ** np.float32(n)
        return [(self.diffuse, np.full_like(shape_li, 1.0 / math.pi)), (self.specular, np.float32(scale) * shape_li)]


@dataclass(frozen=True)
class Ggx:
    """A GGX lobe (Walter et al. 2007) on a diffuse base that gets what the lobe leaves (Ashikhmin and Shirley 2000).

    ``D F G / (4 (n.l) (n.v))`` with Schlick's Fresnel term and the height-correlated Smith term (Heitz 2014, eq. 99),
    and ``28 kd / (23 pi) (1 - F0) (1 - (1 - n.l / 2)^5) (1 - (1 - n.v / 2)^5)``.

    Attributes
    ----------
    diffuse, specular : tuple of float
        kd, and F0, the Fresnel reflectance at normal incidence; linear RGB.
    roughness : float
        GGX alpha.
    """

    diffuse: Colour = (0.40, 0.34, 0.27)
    specular: Colour = (0.30, 0.27, 0.22)
    roughness: float = 0.30

    def __post_init__(self) -> None:
        _check_colours(self.diffuse, self.specular, shared=False)
        _check_range("roughness", self.roughness, 0.01, 1.0)

    def lobes(
        self, lights_l3: NDArray[np.float32], views_i3: NDArray[np.float32]
    ) -> list[tuple[Colour, NDArray[np.float32]]]:
        """Return the lobe as it reflects at normal incidence, what it reflects more at grazing, and the base."""
        n_l, n_v = (np.maximum(each[:, 2], np.float32(_LEAST_COSINE)) for each in (lights_l3, views_i3))
        n_l, n_v = n_l[:, None], n_v[None, :]
        l_h, n_h = _halfway(lights_l3, views_i3)
        a2 = np.float32(self.roughness**2)
        density_li = a2 / (np.float32(math.pi) * (n_h * n_h * (a2 - 1) + 1) ** 2)
        smith_li = n_l * np.sqrt(n_v * n_v * (1 - a2) + a2) + n_v * np.sqrt(n_l * n_l * (1 - a2) + a2)
        facets_li = np.float32(0.5) * density_li / smith_li
        grazing_li = (1 - l_h) ** 5
        base_li = (1 - (1 - n_l / 2) ** 5) * (1 - (1 - n_v / 2) ** 5) * np.float32(28.0 / (23.0 * math.pi))
        below = tuple(kd * (1.0 - f0) for kd, f0 in zip(self.diffuse, self.specular, strict=True))
        return [
            (self.specular, facets_li * (1 - grazing_li)),
            ((1.0, 1.0, 1.0), facets_li * grazing_li),
            (below, base_li),  # type: ignore[list-item]
        ]


MATERIALS: dict[str, type[Phong] | type[Blinn] | type[Ggx]] = {"phong": Phong, "blinn": Blinn, "ggx": Ggx}
"""Materials by the names that options take."""


def evaluate_brdf(
    material: Material, lights_l3: NDArray[np.floating], views_i3: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Return the BRDF in 1/sr, shape (n_light, n_view, 3); directions in the frame of the normal, above z = 0."""
    lobes = material.lobes(lights_l3.astype(np.float32), views_i3.astype(np.float32))
    return np.sum([lobe_li[..., None] * np.float32(colour) for colour, lobe_li in lobes], axis=0, dtype=np.float32)


def _halfway(
    lights_l3: NDArray[np.float32], views_i3: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the halfway vector's cosines with the light and with the normal, each (light, view)."""
    cosine_li = np.clip(lights_l3 @ views_i3.T, -1.0, 1.0)
    length_li = np.sqrt(np.maximum(2.0 + 2.0 * cosine_li, np.float32(1e-12)))  # |l + v|
    l_h = np.clip((1.0 + cosine_li) / length_li, 0.0, 1.0)
    n_h = np.clip((lights_l3[:, 2][:, None] + views_i3[:, 2][None, :]) / length_li, 0.0, 1.0)
    return l_h, n_h


def _check_colours(diffuse: Colour, specular: Colour, *, shared: bool) -> None:
    for label, colour in (("diffuse", diffuse), ("specular", specular)):
        if len(colour) != 3 or not all(0.0 <= value <= 1.0 for value in colour):
            raise InputError(f"{label} must be three reflectances from 0 to 1, got {colour}")
    if shared and max(kd + ks for kd, ks in zip(diffuse, specular, strict=True)) > 1.0 + 1e-9:
        raise InputError(f"diffuse and specular together must not be above 1, got {diffuse} and {specular}")


def _check_range(label: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise InputError(f"{label} must be from {low:g} to {high:g}, got {value:g}")
