"""Reflectances by formula: microfacets about the reflection vector, Kajiya and Kay's fibres about the tangent."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf, check_positive, reflection_cosines


@dataclass(frozen=True)
class Microfacet(CentredBrdf):
    """``exp(-(theta_h / sigma)^2) / (4 pi sigma^2)`` where N . L > 0 (frequency-space-environment-maps, eq. 11).

    The paper's simplification of Torrance and Sparrow: no cosine of the light's angle, shadowing or Fresnel factor.

    Attributes
    ----------
    sigma : float
        Roughness, above 0.
    """

    sigma: float = 0.2

    id: ClassVar[str] = "microfacet"

    def __post_init__(self) -> None:
        check_positive(self.sigma, "the roughness sigma of microfacets")

    @property
    def least_angles(self) -> int:
        """See `CentredBrdf`: steps next to 0, where the lobe is, fall with the square of the angles' number."""
        return math.ceil(8.0 / math.sqrt(self.sigma))

    def evaluate(
        self, theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `CentredBrdf`."""
        cosines = reflection_cosines(theta_i, theta_o, phi)
        facet = np.arccos(cosines.half_normal) / self.sigma
        lobe = np.exp(-facet * facet) / (4.0 * np.pi * self.sigma**2)
        return np.where(cosines.light_normal > 0.0, lobe, 0.0)[..., None]

    def to_config(self) -> dict[str, Any]:
        """See `CentredBrdf`."""
        return {"brdf": self.id, "sigma": float(self.sigma)}


@dataclass(frozen=True)
class KajiyaKay(CentredBrdf):
    """``max(cos(theta_i - theta_o), 0)^s`` in angles from the tangent (frequency-space-environment-maps, 3.1 and 7.1).

    Fibres reflect into a cone about their tangent; the azimuth counts for nothing, so only q = 0 is needed.

    Attributes
    ----------
    exponent : float
        s, at least 0.
    """

    exponent: float = 32.0

    id: ClassVar[str] = "kajiya-kay"
    centre: ClassVar[str] = "tangent"
    has_azimuth: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_positive(self.exponent, "the exponent of Kajiya and Kay's fibres", zero=True)

    @property
    def least_angles(self) -> int:
        """See `CentredBrdf`: a ridge of ``1 / sqrt(s)`` radians at any angle."""
        return math.ceil(4.5 * math.sqrt(self.exponent))

    def evaluate(
        self, theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `CentredBrdf`."""
        light, view, _ = np.broadcast_arrays(theta_i, theta_o, phi)
        return (np.maximum(np.cos(light - view), 0.0) ** self.exponent)[..., None]

    def to_config(self) -> dict[str, Any]:
        """See `CentredBrdf`."""
        return {"brdf": self.id, "exponent": float(self.exponent)}
