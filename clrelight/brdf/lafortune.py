"""Lafortune's sums of stretched cosine lobes (Lafortune et al. 1997)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf, reflection_cosines
from clrelight.errors import InputError


@dataclass(frozen=True)
class Lafortune(CentredBrdf):
    """``(kd / pi + sum max(C_xy (l_x v_x + l_y v_y) + C_z l_z v_z, 0)^n) max(l_z, 0)``, in the normal's frame.

    Attributes
    ----------
    diffuse_c : sequence of float
        kd of each of 1 or 3 channels, at least 0.
    lobes_j3c : sequence
        C_xy, C_z and n of each lobe, each with one number a channel; n is at least 0.
    """

    diffuse_c: Sequence[float]
    lobes_j3c: Sequence[Sequence[Sequence[float]]]

    id: ClassVar[str] = "lafortune"

    def __post_init__(self) -> None:
        try:
            diffuse = np.asarray(self.diffuse_c, np.float64)
            lobes = np.asarray(self.lobes_j3c, np.float64).reshape(-1, 3, len(diffuse))
        except (TypeError, ValueError):
            raise InputError("a Lafortune lobe is C_xy, C_z and n, each of as many channels as kd") from None
        if diffuse.ndim != 1 or len(diffuse) not in (1, 3):
            raise InputError(f"kd has 1 or 3 channels, got shape {diffuse.shape}")
        if not (np.isfinite(diffuse).all() and np.isfinite(lobes).all()) or min(diffuse.min(), 0.0) < 0.0:
            raise InputError("numbers of a Lafortune reflectance must be finite, and kd at least 0")
        if (lobes[:, 2] < 0.0).any():
            raise InputError(f"exponents of Lafortune lobes must be at least 0, got {lobes[:, 2].min():g}")
        object.__setattr__(self, "diffuse_c", tuple(diffuse.tolist()))
        object.__setattr__(self, "lobes_j3c", tuple(tuple(map(tuple, lobe)) for lobe in lobes.tolist()))

    @property
    def channels(self) -> int:
        """1 or 3."""
        return len(self.diffuse_c)

    def evaluate(
        self, theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `CentredBrdf`."""
        cosines = reflection_cosines(theta_i, theta_o, phi)
        along = cosines.light_normal * cosines.view_normal
        across = cosines.light_view - along
        total = np.empty((*along.shape, self.channels))
        total[...] = np.asarray(self.diffuse_c) / np.pi
        for flat, upright, exponent in np.asarray(self.lobes_j3c):
            base = flat * across[..., None] + upright * along[..., None]
            total += np.maximum(base, 0.0) ** exponent  # clamped before its power: a negative base has none
        return total * np.maximum(cosines.light_normal, 0.0)[..., None]

    def to_config(self) -> dict[str, Any]:
        """See `CentredBrdf`."""
        lobes = [[list(row) for row in lobe] for lobe in self.lobes_j3c]
        return {"brdf": self.id, "diffuse": list(self.diffuse_c), "lobes": lobes}


SKIN = Lafortune(
    (0.428425, 0.301341, 0.331054),
    (
        ((-1.131747, -1.016939, -0.966018), (-1.209182, -1.462488, -1.222419), (6.421658, 3.699932, 3.524889)),
        ((-0.546570, -0.643533, -0.638934), (0.380123, 0.410559, 0.437367), (3.685044, 4.266495, 4.539742)),
        ((-0.998888, -1.020153, -1.027479), (0.857998, 0.703913, 0.573625), (64.208486, 63.919687, 43.809866)),
    ),
)
"""Skin as Marschner et al. (2000) measured it: red, green, blue."""
