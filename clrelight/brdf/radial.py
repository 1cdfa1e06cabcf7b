"""Reflectances of one symmetric lobe about a direction: Lambert's about the normal, Phong's about the mirrored view."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf, check_positive, reflection_cosines


def lobe_factors(exponent: float, degree: int) -> NDArray[np.float64]:
    """Return the factors A_l of ``(s + 1) / (2 pi) max(cos, 0)^s``, (degree + 1,): ``B_lm = A_l L_lm``.

    ``A_0 = 1``, ``A_1 = (s + 1) / (s + 2)``, ``A_l = A_(l-2) (s - l + 2) / (s + l + 1)``: integrals of ``x^s P_l(x)``
    over 0 .. 1. ``exp(-l^2 / (2 s))`` of frequency-space-environment-maps, section 6.3, approximates it.
    """
    s = float(exponent)
    factors_l = np.ones(degree + 1)
    for l in range(1, degree + 1):
        factors_l[l] = (s + 1.0) / (s + 2.0) if l == 1 else factors_l[l - 2] * (s - l + 2.0) / (s + l + 1.0)
    return factors_l


@dataclass(frozen=True)
class Phong(CentredBrdf):
    """``(s + 1) / (2 pi) max(R . L, 0)^s`` (frequency-space-environment-maps, 6.3), without a cosine besides.

    Attributes
    ----------
    exponent : float
        s, at least 0.
    """

    exponent: float = 32.0

    id: ClassVar[str] = "phong"
    is_radial: ClassVar[bool] = True
    has_azimuth: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_positive(self.exponent, "the exponent of a Phong lobe", zero=True)

    def evaluate(
        self, theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `CentredBrdf`."""
        cosine = np.cos(np.broadcast_arrays(theta_i, theta_o, phi)[0])
        lobe = np.where(cosine > 0.0, np.maximum(cosine, 0.0) ** self.exponent, 0.0)  # 0^0 of s = 0 is none
        return ((self.exponent + 1.0) / (2.0 * np.pi) * lobe)[..., None]

    def to_config(self) -> dict[str, Any]:
        """See `CentredBrdf`."""
        return {"brdf": self.id, "exponent": float(self.exponent)}

    def factors(self, degree: int) -> NDArray[np.float64]:
        """Return `lobe_factors` of its exponent."""
        return lobe_factors(self.exponent, degree)

    @property
    def energy(self) -> float:
        """The integral of its square over light and view, ``2 (s + 1)^2 / (2 s + 1)``."""
        return (self.exponent + 1.0) * ((self.exponent + 1.0) / (self.exponent + 0.5))


@dataclass(frozen=True)
class Lambert(Phong):
    """``max(N . L, 0) / pi``: Phong's lobe of exponent 1, about the normal."""

    exponent: float = 1.0

    id: ClassVar[str] = "lambert"
    centre: ClassVar[str] = "normal"

    def __post_init__(self) -> None:
        if self.exponent != 1.0:
            check_positive(-1.0, "Lambert's reflectance has no exponent: what differs from 1")

    def to_config(self) -> dict[str, Any]:
        """See `CentredBrdf`."""
        return {"brdf": self.id}


@dataclass(frozen=True)
class Mirrored(CentredBrdf):
    """A lobe about the normal in angles from the mirrored view, as a set of reflectances shares one central direction.

    Attributes
    ----------
    lobe : Phong
        About the normal.
    """

    lobe: Phong = field(default_factory=Lambert)

    id: ClassVar[str] = "mirrored"

    def evaluate(
        self, theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `CentredBrdf`."""
        angle = np.arccos(np.clip(reflection_cosines(theta_i, theta_o, phi).light_normal, -1.0, 1.0))
        return self.lobe.evaluate(angle, np.zeros(1), np.zeros(1))

    def to_config(self) -> dict[str, Any]:
        """See `CentredBrdf`."""
        return self.lobe.to_config()
