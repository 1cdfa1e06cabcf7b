"""Records whose config names a basis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.bases.registry import SH, basis_of


class OfBasis:
    """What has a `degree`, and a `config` that names the basis, or none where it is spherical harmonics."""

    degree: int
    config: Mapping[str, Any]
    directions_i3: NDArray[np.float64]
    surface: Any

    @property
    def basis(self) -> str:
        """Id of the basis, see `clrelight.bases`."""
        return str(self.config.get("basis", SH))

    @property
    def fitted_lights(self) -> NDArray[np.float64] | None:
        """Directions (n_light, 3) that the functions were fitted at; None of a surface's, which may be of no lights."""
        return None if self.surface is not None else self.directions_i3

    def functions_at(self, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what each coefficient counts for under distant lights, (n_light, n_coeff) float64."""
        return basis_of(self.basis).evaluate(directions_i3, self.degree)

    def check_basis(self) -> None:
        """Raise InputError where the basis is not known, or has no such degree."""
        basis_of(self.basis).check(self.degree)
